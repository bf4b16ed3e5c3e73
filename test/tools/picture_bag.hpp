// A bag of a simulated camera that publishes as a test says.
#pragma once

#include <string>
#include <vector>

#include <rosbag/bag.h>

#include "message_builders.hpp"
#include "repeated_pictures.hpp"

namespace gyro_deblur::test {

/// Topics: /imu, /cam/image_raw, /cam/camera_info.
inline void write_bag(const std::string& path, const HandheldCamera& camera, const std::vector<Shot>& shots) {
  rosbag::Bag bag(path, rosbag::bagmode::Write);
  for (const sim::ImuSample& sample : camera.simulator().imu()) {
    sensor_msgs::Imu imu = imu_message(sample.t_ns, sample.rate_rad_s.y());
    imu.angular_velocity.x = sample.rate_rad_s.x();
    imu.angular_velocity.z = sample.rate_rad_s.z();
    bag.write("/imu", to_ros_time(sample.t_ns), imu);
  }
  const CameraCalibration& calibration = camera.simulator().camera().calibration();
  for (const Shot& shot : shots) {
    sensor_msgs::CameraInfoPtr info = camera_info(shot.stamp_ns, calibration.width_px, calibration.height_px);
    info->K = {calibration.fx_px, 0, calibration.cx_px, 0, calibration.fy_px, calibration.cy_px, 0, 0, 1};
    sensor_msgs::Image like;
    like.header = info->header;
    like.encoding = "mono8";
    bag.write("/cam/image_raw", info->header.stamp, *to_image(shot.pixels, like));
    bag.write("/cam/camera_info", info->header.stamp, *info);
  }
}

}  // namespace gyro_deblur::test
