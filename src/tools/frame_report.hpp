// Report on each frame of a recording, as JSON.
#pragma once

#include <fstream>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "tools/output_file.hpp"

namespace gyro_deblur {

/// A JSON object with one line for each of its `frames`, which are written as they come: a recording of hours has
/// hundreds of thousands. The file has its name when finish() has returned.
class FrameReport {
 public:
  /// An empty path: nothing is wanted. Throws std::runtime_error that names the file when it cannot be written.
  explicit FrameReport(const std::string& path);

  bool wanted() const { return file_.has_value(); }

  /// Appends a frame. Precondition: wanted().
  void add(const nlohmann::json& frame);

  /// Adds what holds for all frames, an object with other members than `frames`. Throws as the constructor; nothing
  /// where no report is wanted.
  void finish(const nlohmann::json& whole);

 private:
  void require_written();

  std::optional<PartialFile> file_;
  std::ofstream stream_;
  bool has_frames_ = false;
};

}  // namespace gyro_deblur
