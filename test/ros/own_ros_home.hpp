// A folder for what nodelets store, in place of the user's.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>

namespace gyro_deblur::test {

/// ROS_HOME of this process while it exists: a new folder, so that nothing is there that an earlier run has stored.
class OwnRosHome {
 public:
  OwnRosHome() {
    if (mkdtemp(path_.data()) == nullptr || setenv("ROS_HOME", path_.c_str(), 1) != 0) {
      throw std::runtime_error("there can be no folder " + path_);
    }
  }
  ~OwnRosHome() { std::filesystem::remove_all(path_); }
  OwnRosHome(const OwnRosHome&) = delete;
  OwnRosHome& operator=(const OwnRosHome&) = delete;

 private:
  std::string path_ = (std::filesystem::temp_directory_path() / "gyro_deblur_home_XXXXXX").string();
};

}  // namespace gyro_deblur::test
