// Messages of a small camera and an IMU that rotates at a constant rate.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <boost/make_shared.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/config.hpp"
#include "ros/conversions.hpp"

namespace gyro_deblur::test {

constexpr TimeNs kMs = 1'000'000;
constexpr TimeNs kSecond = 1'000'000'000;
constexpr int kWidth = 192, kHeight = 128;
constexpr double kFocalPx = 200;
constexpr TimeNs kExposure = 30 * kMs;
constexpr TimeNs kReadout = 20 * kMs;
/// Rotates fast enough for a blur of about 9 px.
constexpr double kFastRadS = 1.5;
constexpr char kCameraFrame[] = "camera", kImuFrame[] = "imu";

/// Smooth random texture, the same every time.
inline cv::Mat texture(int type = CV_8UC1, int width = kWidth, int height = kHeight) {
  cv::Mat noise(height, width, CV_32FC(CV_MAT_CN(type)));
  cv::RNG rng(7);
  rng.fill(noise, cv::RNG::UNIFORM, 0, 1);
  cv::GaussianBlur(noise, noise, {}, 2);
  cv::normalize(noise, noise, 0, CV_MAT_DEPTH(type) == CV_16U ? 65535 : 255, cv::NORM_MINMAX);
  cv::Mat image;
  noise.convertTo(image, type);
  return image;
}

/// The noise of a sensor: no two pictures are equal, although they show the same. One grey level, in the first row.
inline void add_sensor_noise(TimeNs stamp_ns, cv::Mat* image) {
  cv::RNG rng(static_cast<std::uint64_t>(stamp_ns));
  cv::Mat noise(1, image->cols, image->type());
  rng.fill(noise, cv::RNG::UNIFORM, 0, 2);
  cv::bitwise_xor(image->row(0), noise, image->row(0));
}

/// A new picture for every stamp.
inline sensor_msgs::ImagePtr image_message(TimeNs stamp_ns, const std::string& encoding = "mono8", int width = kWidth,
                                           int height = kHeight) {
  sensor_msgs::Image like;
  like.header.stamp = to_ros_time(stamp_ns);
  like.header.frame_id = kCameraFrame;
  like.encoding = encoding;
  cv::Mat pixels = texture(type_of_encoding(encoding).value(), width, height);
  add_sensor_noise(stamp_ns, &pixels);
  return to_image(pixels, like);
}

inline sensor_msgs::CameraInfoPtr camera_info(TimeNs stamp_ns, int width = kWidth, int height = kHeight) {
  auto info = boost::make_shared<sensor_msgs::CameraInfo>();
  info->header.stamp = to_ros_time(stamp_ns);
  info->header.frame_id = kCameraFrame;
  info->width = static_cast<std::uint32_t>(width);
  info->height = static_cast<std::uint32_t>(height);
  info->distortion_model = "plumb_bob";
  info->D.assign(5, 0.0);
  const double cx = (width - 1) / 2.0, cy = (height - 1) / 2.0;
  info->K = {kFocalPx, 0, cx, 0, kFocalPx, cy, 0, 0, 1};
  info->R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info->P = {kFocalPx, 0, cx, 0, 0, kFocalPx, cy, 0, 0, 0, 1, 0};
  return info;
}

inline sensor_msgs::Imu imu_message(TimeNs stamp_ns, double rate_y_rad_s) {
  sensor_msgs::Imu imu;
  imu.header.stamp = to_ros_time(stamp_ns);
  imu.header.frame_id = kImuFrame;
  imu.angular_velocity.y = rate_y_rad_s;
  return imu;
}

/// What the tests start from: IMU and camera axes agree. Nothing is rejected, and images are not asked for their
/// motion: the texture is neither blurred nor moved as the gyroscope says.
inline Config test_config() {
  Config config;
  config.shutter.exposure_ns = kExposure;
  config.shutter.readout_ns = kReadout;
  config.R_cam_imu = Eigen::Matrix3d::Identity();
  config.pipeline.blur_field.block_size_px = 32;
  config.pipeline.validation.rule = ValidationRule::NONE;
  config.pipeline.optical_flow = false;
  config.pipeline.keypoints.detector = "FAST";
  config.pipeline.keypoints.descriptor = "ORB";
  return config;
}

}  // namespace gyro_deblur::test
