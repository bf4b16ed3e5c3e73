// Messages of a camera and an IMU, as the tools write them into bags.
#pragma once

#include <optional>
#include <string>

#include <ros/time.h>
#include <rosbag/bag.h>
#include <sensor_msgs/Imu.h>
#include <std_msgs/Header.h>
#include <Eigen/Core>

#include "gyro_deblur/time.hpp"
#include "ros/messages.hpp"

namespace gyro_deblur {

/// Throws std::runtime_error that begins with `what` outside (0, 4294967295] s, the times that a bag can hold.
ros::Time bag_time(TimeNs t_ns, const std::string& what);

std_msgs::Header make_header(ros::Time stamp, const std::string& frame_id);

/// Orientation, and acceleration when absent, are marked as not measured (covariance[0] = -1, REP 145).
sensor_msgs::Imu imu_message(const std_msgs::Header& header, const Eigen::Vector3d& rate_rad_s,
                             const std::optional<Eigen::Vector3d>& specific_force_m_s2);

Exposure exposure_message(const std_msgs::Header& header, TimeNs exposure_ns, TimeNs readout_ns);

/// Writes the transform from `imu_frame` (parent) to `camera_frame` (child) to /tf_static, such that players latch it.
/// @param p_imu_cam_m  origin of the camera in IMU coordinates
void write_extrinsic(rosbag::Bag& bag, ros::Time time, const Eigen::Matrix3d& R_cam_imu,
                     const Eigen::Vector3d& p_imu_cam_m, const std::string& imu_frame, const std::string& camera_frame);

}  // namespace gyro_deblur
