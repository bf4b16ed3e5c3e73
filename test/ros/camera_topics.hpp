// What tests of the nodelet have in common: a camera's topics in a namespace of their own, and ways to wait. With a
// deadline; time never decides.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <boost/make_shared.hpp>

#include "message_builders.hpp"

namespace gyro_deblur::test {

constexpr std::chrono::seconds kDeadline{60};
constexpr TimeNs kStart = 100 * kSecond;
constexpr TimeNs kImuPeriod = 5 * kMs;
/// Long enough that a frame that leaves did not leave for it.
constexpr double kLongTimeoutS = 10;

/// What has arrived, and a way to wait for more.
class Mailbox {
 public:
  template <typename Function>
  void put(Function function) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      function();
    }
    changed_.notify_all();
  }
  /// False when the deadline passes first.
  bool wait(const std::function<bool()>& condition) {
    std::unique_lock<std::mutex> lock(mutex_);
    return changed_.wait_for(lock, kDeadline, condition);
  }
  template <typename Function>
  auto look(Function function) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return function();
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
};

/// For conditions of ROS's graph, which notifies nobody when it changes.
inline bool poll_until(const std::function<bool()>& condition) {
  const auto deadline = std::chrono::steady_clock::now() + kDeadline;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline || !ros::ok()) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

/// Publishes what a camera and its IMU do, for a nodelet called deblur.
class CameraTopicsTest : public testing::Test {
 protected:
  /// @param prefix      of the namespace; each test has its own
  /// @param queue_size  of the publishers
  CameraTopicsTest(const std::string& prefix, std::uint32_t queue_size) {
    static int count = 0;
    ns_ = prefix + std::to_string(++count);
    name_ = ns_ + "/deblur";
    image_publisher_ = nh_.advertise<sensor_msgs::Image>(ns_ + "/image_raw", queue_size);
    info_publisher_ = nh_.advertise<sensor_msgs::CameraInfo>(ns_ + "/camera_info", queue_size);
    imu_publisher_ = nh_.advertise<sensor_msgs::Imu>(ns_ + "/imu", queue_size);
    set_camera_parameters();
  }

  /// Those of test_config(), for the nodelet `name_`.
  void set_camera_parameters() {
    // As the launch files do: the parameters are there before the nodelet.
    set("exposure_time", to_seconds(kExposure));
    set("readout_time", to_seconds(kReadout));
    set("R_cam_imu", std::vector<double>{1, 0, 0, 0, 1, 0, 0, 0, 1});
    set("block_size", 32);
    set("validation", std::string("none"));
    set("optical_flow", false);
    set("keypoint_detector", std::string("FAST"));
    set("keypoint_descriptor", std::string("ORB"));
    set("input_timeout", kLongTimeoutS);
    set("frame_queue_size", 100);
  }

  template <typename T>
  void set(const std::string& parameter, const T& value) {
    nh_.setParam(name_ + "/" + parameter, value);
  }

  /// Somebody listens to all that is published here.
  bool inputs_connected() const {
    return image_publisher_.getNumSubscribers() > 0 && info_publisher_.getNumSubscribers() > 0 &&
           imu_publisher_.getNumSubscribers() > 0;
  }

  void publish_imu(TimeNs from_ns, TimeNs to_ns, double rate_rad_s = kFastRadS) {
    for (TimeNs t_ns = from_ns; t_ns <= to_ns; t_ns += kImuPeriod) {
      imu_publisher_.publish(boost::make_shared<sensor_msgs::Imu>(imu_message(t_ns, rate_rad_s)));
    }
  }
  sensor_msgs::ImagePtr publish_frame(TimeNs stamp_ns, const std::string& encoding = "mono8") {
    const sensor_msgs::ImagePtr image = image_message(stamp_ns, encoding);
    info_publisher_.publish(camera_info(stamp_ns));
    image_publisher_.publish(image);
    return image;
  }

  ros::NodeHandle nh_;
  std::string ns_, name_;
  ros::Publisher image_publisher_, info_publisher_, imu_publisher_;
};

}  // namespace gyro_deblur::test
