// Writes the report on each frame.
#include "tools/frame_report.hpp"

#include <stdexcept>

namespace gyro_deblur {

FrameReport::FrameReport(const std::string& path) {
  if (path.empty()) return;
  file_.emplace(path);
  stream_.open(file_->path());
  stream_ << "{\n  \"frames\": [";
  require_written();
}

void FrameReport::add(const nlohmann::json& frame) {
  stream_ << (has_frames_ ? ",\n    " : "\n    ") << frame.dump();
  has_frames_ = true;
}

void FrameReport::finish(const nlohmann::json& whole) {
  if (!wanted()) return;
  // The brace that opens `whole` is the one that the file begins with.
  stream_ << "\n  ]," << whole.dump(2).substr(1) << '\n';
  require_written();
  stream_.close();
  file_->finish();
}

void FrameReport::require_written() {
  if (!stream_.flush())
    throw std::runtime_error(file_->target() + ": cannot be written: check folder, permissions and free space");
}

}  // namespace gyro_deblur
