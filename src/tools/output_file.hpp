// Files that the tools write.
#pragma once

#include <fstream>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

namespace gyro_deblur {

/// Throws std::runtime_error that names the file when it cannot be written.
void write_text(const std::string& path, const std::string& text);

/// A report for --json: nothing for an empty path. Throws as write_text.
void write_json(const std::string& path, const nlohmann::json& report, int indent = 2);

/// A file that gets its name when it is complete: written next to it as NAME.part, which is deleted if it does not
/// get complete. An existing path that is no file, such as /dev/null, is written directly.
class PartialFile {
 public:
  explicit PartialFile(std::string target);
  ~PartialFile();
  PartialFile(const PartialFile&) = delete;
  PartialFile& operator=(const PartialFile&) = delete;

  const std::string& target() const { return target_; }
  const std::string& path() const { return path_; }  ///< where to write

  /// The file is complete, and closed. Throws std::filesystem::filesystem_error.
  void finish();

 private:
  const std::string target_, path_;
  bool finished_ = false;
};

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
  std::optional<PartialFile> file_;
  std::ofstream stream_;
  bool has_frames_ = false;
};

}  // namespace gyro_deblur
