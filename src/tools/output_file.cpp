// Writes text and JSON, and replaces a file only once it is complete.
#include "tools/output_file.hpp"

#include <filesystem>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace gyro_deblur {
namespace {

/// @param path  for the message
void require_written(std::ofstream& file, const std::string& path) {
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written: check folder, permissions and free space");
}

std::string part_of(const std::string& target) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  const bool replaceable = !fs::exists(target, ignored) || fs::is_regular_file(target, ignored);
  return replaceable ? target + ".part" : target;
}

}  // namespace

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  require_written(file, path);
}

void write_json(const std::string& path, const nlohmann::json& report, int indent) {
  if (!path.empty()) write_text(path, report.dump(indent) + "\n");
}

PartialFile::PartialFile(std::string target) : target_(std::move(target)), path_(part_of(target_)) {}

PartialFile::~PartialFile() {
  std::error_code ignored;
  if (!finished_ && path_ != target_) std::filesystem::remove(path_, ignored);
}

void PartialFile::finish() {
  if (path_ != target_) std::filesystem::rename(path_, target_);
  finished_ = true;
}

FrameReport::FrameReport(const std::string& path) {
  if (path.empty()) return;
  file_.emplace(path);
  stream_.open(file_->path());
  stream_ << "{\n  \"frames\": [";
  require_written(stream_, file_->target());
}

void FrameReport::add(const nlohmann::json& frame) {
  stream_ << (has_frames_ ? ",\n    " : "\n    ") << frame.dump();
  has_frames_ = true;
}

void FrameReport::finish(const nlohmann::json& whole) {
  if (!wanted()) return;
  // The brace that opens `whole` is the one that the file begins with.
  stream_ << "\n  ]," << whole.dump(2).substr(1) << '\n';
  require_written(stream_, file_->target());
  stream_.close();
  file_->finish();
}

}  // namespace gyro_deblur
