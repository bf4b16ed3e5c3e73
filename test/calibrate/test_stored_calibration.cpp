// The estimated calibration on disk.
#include "calibrate/stored_calibration.hpp"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

namespace gyro_deblur::stored_calibration_test {
namespace {

/// Of the environment; as it was when this ends.
class SavedVariable {
 public:
  explicit SavedVariable(const char* name) : name_(name) {
    if (const char* value = std::getenv(name)) value_ = value;
  }
  ~SavedVariable() { value_ ? setenv(name_, value_->c_str(), 1) : unsetenv(name_); }
  SavedVariable(const SavedVariable&) = delete;
  SavedVariable& operator=(const SavedVariable&) = delete;

 private:
  const char* name_;
  std::optional<std::string> value_;
};

class StoredCalibration : public testing::Test {
 protected:
  StoredCalibration() {
    std::string pattern = testing::TempDir() + "gyro_deblur_XXXXXX";
    folder_ = mkdtemp(pattern.data());
    known_.R_cam_imu = {Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix(), 0.003, 12.5,
                        true, ""};
    known_.bias_rad_s = {{0.1, -0.2, 0.3}, 0.004, 7, true, ""};
  }
  ~StoredCalibration() override { std::filesystem::remove_all(folder_); }

  std::string problem(const std::string& path) const {
    try {
      load_stored_calibration(path);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "";
  }

  std::string folder_;
  LearnedCalibration known_;
};

TEST_F(StoredCalibration, ComesBackAsItWas) {
  const std::string path = folder_ + "/below/camera.json";
  EXPECT_FALSE(load_stored_calibration(path)) << "there is none yet";
  save_stored_calibration(path, known_);
  const auto loaded = load_stored_calibration(path);
  ASSERT_TRUE(loaded);
  EXPECT_TRUE(loaded->R_cam_imu.known);
  EXPECT_LT((loaded->R_cam_imu.value - known_.R_cam_imu.value).norm(), 1e-12);
  EXPECT_EQ(loaded->R_cam_imu.stddev, 0.003);
  EXPECT_EQ(loaded->R_cam_imu.seconds, 12.5);
  EXPECT_EQ(loaded->bias_rad_s.value, known_.bias_rad_s.value);
  EXPECT_FALSE(loaded->time_offset_s.known);
  EXPECT_FALSE(loaded->readout_s.known);
  remove_stored_calibration(path);
  EXPECT_FALSE(load_stored_calibration(path));
  EXPECT_NO_THROW(remove_stored_calibration(path));
}

TEST_F(StoredCalibration, ThatCannotBeUsedIsRefusedWithItsPath) {
  const std::string path = folder_ + "/camera.json";
  for (const char* text :
       {"", "{", "[1]", R"({"R_cam_imu": 3})", R"({"time_offset": {"value": [1, 2], "stddev": 1, "seconds": 1}})",
        R"({"gyro_bias": {"value": [1, 2, 300], "stddev": 1, "seconds": 1}})",
        R"({"time_offset": {"value": [0.1], "stddev": 0, "seconds": 1}})",
        R"({"R_cam_imu": {"value": [1, 0, 0, 0, 1, 0, 0, 0, -1], "stddev": 1, "seconds": 1}})"}) {
    std::ofstream(path) << text;
    EXPECT_NE(problem(path).find("stored calibration " + path + " cannot be used: "), std::string::npos) << text;
  }
  EXPECT_THROW(save_stored_calibration(path + "/below.json", known_), std::runtime_error) << "a file is no folder";
}

TEST_F(StoredCalibration, HasAFileForEachNodeAndImageSize) {
  const SavedVariable ros_home("ROS_HOME"), home("HOME");
  setenv("ROS_HOME", folder_.c_str(), 1);
  EXPECT_EQ(stored_calibration_path("/camera/gyro_deblur", 752, 480),
            folder_ + "/gyro_deblur/camera.gyro_deblur.752x480.json");
  EXPECT_NE(stored_calibration_path("/a/b", 752, 480), stored_calibration_path("/a_b", 752, 480));
  unsetenv("ROS_HOME");
  setenv("HOME", "/home/somebody", 1);
  EXPECT_EQ(stored_calibration_path("/a", 1, 2), "/home/somebody/.ros/gyro_deblur/a.1x2.json");
}

}  // namespace
}  // namespace gyro_deblur::stored_calibration_test
