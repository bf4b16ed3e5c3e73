// Messages of a simulated camera that is rotated about all axes before a wall, with an IMU of which nothing is known.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>

#include "gyro_deblur/rotation_track.hpp"
#include "message_builders.hpp"
#include "sim/motion.hpp"
#include "sim/simulator.hpp"
#include "sim/texture.hpp"

namespace gyro_deblur::test {

/// Renders each image once.
class RotatingCamera {
 public:
  static constexpr TimeNs kTimeOffset = 37 * kMs, kShownFor = 10 * kMs;
  static constexpr int kFrames = 150;
  static constexpr double kFramesPerS = 20;

  explicit RotatingCamera(TimeNs readout_ns = 0) : simulator_(scene(readout_ns)), imu_(simulator_.imu()) {}

  static Eigen::Matrix3d R_cam_imu() { return so3_exp({1.1, -0.4, 2.0}).toRotationMatrix(); }
  static Eigen::Vector3d bias_rad_s() { return {0.01, -0.03, 0.02}; }

  const sim::Simulator& truth() const { return simulator_; }
  TimeNs stamp(int frame) const { return simulator_.stamp(frame); }

  sensor_msgs::ImageConstPtr image(int frame) {
    sensor_msgs::ImageConstPtr& image = images_[frame];
    if (!image) {
      sensor_msgs::Image like;
      like.header.stamp = to_ros_time(stamp(frame));
      like.header.frame_id = kCameraFrame;
      like.encoding = "mono8";
      image = to_image(simulator_.frame(frame).image, like);
    }
    return image;
  }

  sensor_msgs::CameraInfoPtr info(int frame) const {
    const CameraCalibration& c = simulator_.camera().calibration();
    const sensor_msgs::CameraInfoPtr info = camera_info(stamp(frame), c.width_px, c.height_px);
    info->K = {c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1};
    info->P = {c.fx_px, 0, c.cx_px, 0, 0, c.fy_px, c.cy_px, 0, 0, 0, 1, 0};
    return info;
  }

  /// Those that are due before an image is: what a late image needs, whatever the offset.
  std::vector<sensor_msgs::Imu> samples_before(int frame) {
    constexpr TimeNs kAhead = 200 * kMs;
    std::vector<sensor_msgs::Imu> messages;
    for (; next_ < imu_.size() && imu_[next_].t_ns <= stamp(frame) + kAhead; ++next_) {
      sensor_msgs::Imu message = imu_message(imu_[next_].t_ns, imu_[next_].rate_rad_s.y());
      message.angular_velocity.x = imu_[next_].rate_rad_s.x();
      message.angular_velocity.z = imu_[next_].rate_rad_s.z();
      messages.push_back(message);
    }
    return messages;
  }
  /// The samples come again.
  void rewind() { next_ = 0; }

 private:
  static sim::Scene scene(TimeNs readout_ns) {
    sim::Scene scene;
    CameraCalibration& calibration = scene.camera.calibration;
    calibration.width_px = 256;
    calibration.height_px = 192;
    calibration.fx_px = calibration.fy_px = 200;
    calibration.cx_px = 127.5;
    calibration.cy_px = 95.5;
    scene.camera.fps = kFramesPerS;
    scene.camera.exposures_ns = {kShownFor};
    scene.camera.readout_ns = readout_ns;
    scene.camera.noise = 1;
    scene.imu.gyro_bias_rad_s = bias_rad_s();
    scene.imu.gyro_noise_rad_s = 0.003;
    scene.imu.time_offset_ns = kTimeOffset;
    scene.imu.R_cam_imu = R_cam_imu();
    sim::Plane wall;
    wall.texture = sim::procedural_texture(1400, 1000, 11);
    wall.width_m = 8.4;
    wall.height_m = 6;
    wall.center_m = {0, 0, 2};
    scene.planes = {wall};
    scene.frames = kFrames;
    scene.lead_ns = 700 * kMs;
    constexpr double kDegree = M_PI / 180;
    sim::VectorCurve rotation, position;
    rotation.sines = {{kDegree * Eigen::Vector3d(4, 7, 2), 1.1, 0.2, {}},
                      {kDegree * Eigen::Vector3d(-3, 2, 5), 1.7, 1, {}},
                      {kDegree * Eigen::Vector3d(3, 8, 2), 0.35, 0.5, {}}};
    position.sines = {{{0.05, 0.02, 0.03}, 0.6, 0.3, {}}};
    scene.motion = sim::make_curve_motion(rotation, position);
    return scene;
  }

  sim::Simulator simulator_;
  const std::vector<sim::ImuSample> imu_;
  std::map<int, sensor_msgs::ImageConstPtr> images_;
  std::size_t next_ = 0;
};

}  // namespace gyro_deblur::test
