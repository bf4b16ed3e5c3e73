#include "tools/output_file.hpp"

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <system_error>

namespace gyro_deblur {

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

void write_json(const std::string& path, const nlohmann::json& report, int indent) {
  if (!path.empty()) write_text(path, report.dump(indent) + "\n");
}

PartialFile::~PartialFile() {
  std::error_code ignored;
  if (!finished_) std::filesystem::remove(path_, ignored);
}

void PartialFile::finish() {
  std::filesystem::rename(path_, target_);
  finished_ = true;
}

}  // namespace gyro_deblur
