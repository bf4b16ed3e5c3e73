// A processor with a good configuration, and messages of a good small camera to be spoilt.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <string>

#include <boost/make_shared.hpp>

#include "gyro_deblur/config.hpp"
#include "ros/conversions.hpp"
#include "ros/processor.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur::fuzz {

constexpr TimeNs kMs = 1'000'000;
constexpr TimeNs kStart = 100'000 * kMs;
constexpr int kWidth = 48, kHeight = 32;

inline Config good_config() {
  Config config;
  // Every input has a processor of its own, which prepares for all extents: up to 500 px takes more than a second under
  // AddressSanitizer.
  config.pipeline.blur_field.max_extent_px = 20;
  config.shutter.exposure_ns = 20 * kMs;
  config.shutter.readout_ns = 10 * kMs;
  config.R_cam_imu = Eigen::Matrix3d::Identity();
  config.pipeline.blur_field.block_size_px = 16;
  config.pipeline.engine = "cpu";
  config.pipeline.threads = 1;
  config.pipeline.keypoints.detector = "FAST";
  config.pipeline.keypoints.descriptor = "ORB";
  return config;
}

inline sensor_msgs::CameraInfoPtr good_camera_info() {
  auto info = boost::make_shared<sensor_msgs::CameraInfo>();
  info->header.stamp = to_ros_time(kStart);
  info->width = kWidth;
  info->height = kHeight;
  info->distortion_model = "plumb_bob";
  info->D.assign(5, 0.0);
  info->K = {50, 0, 23.5, 0, 50, 15.5, 0, 0, 1};
  info->R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info->P = {50, 0, 23.5, 0, 0, 50, 15.5, 0, 0, 0, 1, 0};
  return info;
}

inline sensor_msgs::ImagePtr good_image() {
  auto image = boost::make_shared<sensor_msgs::Image>();
  image->header.stamp = to_ros_time(kStart);
  image->width = image->step = kWidth;
  image->height = kHeight;
  image->encoding = "mono8";
  for (int i = 0; i < kWidth * kHeight; ++i) image->data.push_back(static_cast<std::uint8_t>(i * i / 7));
  return image;
}

/// Counts what goes in and out, and ends the process when a frame is lost.
class OneCamera {
 public:
  OneCamera() : processor_(environment()) { processor_.set_config(good_config()); }

  Processor& processor() { return processor_; }

  /// A gyroscope that rotates, from before the frame at kStart until after it.
  void add_motion() {
    for (TimeNs t_ns = kStart - 100 * kMs; t_ns <= kStart + 200 * kMs; t_ns += 5 * kMs) {
      sensor_msgs::Imu imu;
      imu.header.stamp = to_ros_time(t_ns);
      imu.angular_velocity.y = 5;
      processor_.add_imu(imu);
    }
  }
  void add_image(const sensor_msgs::ImageConstPtr& image) {
    ++frames_in_;
    processor_.add_image(image);
  }
  void advance() { processor_.advance(sink()); }
  void finish() {
    processor_.finish(sink());
    if (frames_in_ != frames_out_) std::abort();
  }

 private:
  static Processor::Environment environment() {
    Processor::Environment environment;
    environment.clock = [] { return kStart; };
    environment.log = [](LogLevel, const std::string&) {};
    environment.request = [] {
      FrameRequest request;
      request.overlay = request.markers = true;
      return request;
    };
    return environment;
  }
  Processor::Sink sink() {
    return [this](FrameOutput&& output) {
      ++frames_out_;
      if (!output.image || !output.camera_info || !output.blur_field || !output.keypoints) std::abort();
      if (output.reason != PassThroughReason::NONE && output.image != output.input) std::abort();
      return true;
    };
  }

  std::size_t frames_in_ = 0, frames_out_ = 0;
  Processor processor_;
};

}  // namespace gyro_deblur::fuzz
