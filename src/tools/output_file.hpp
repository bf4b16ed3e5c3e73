// Files that the tools write.
#pragma once

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

}  // namespace gyro_deblur
