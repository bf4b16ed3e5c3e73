// Writes text and JSON, and replaces a file only once it is complete.
#include "tools/output_file.hpp"

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace gyro_deblur {

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written: check folder, permissions and free space");
}

void write_json(const std::string& path, const nlohmann::json& report, int indent) {
  if (!path.empty()) write_text(path, report.dump(indent) + "\n");
}

namespace {

std::string part_of(const std::string& target) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  const bool replaceable = !fs::exists(target, ignored) || fs::is_regular_file(target, ignored);
  return replaceable ? target + ".part" : target;
}

}  // namespace

PartialFile::PartialFile(std::string target) : target_(std::move(target)), path_(part_of(target_)) {}

PartialFile::~PartialFile() {
  std::error_code ignored;
  if (!finished_ && path_ != target_) std::filesystem::remove(path_, ignored);
}

void PartialFile::finish() {
  if (path_ != target_) std::filesystem::rename(path_, target_);
  finished_ = true;
}

}  // namespace gyro_deblur
