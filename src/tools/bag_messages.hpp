// Messages of a camera and an IMU, as the tools write them into bags.
#pragma once

#include <optional>
#include <string>

#include <ros/duration.h>
#include <ros/time.h>
#include <rosbag/bag.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <std_msgs/Header.h>
#include <tf2_msgs/TFMessage.h>
#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/time.hpp"
#include "ros/messages.hpp"

namespace gyro_deblur {

/// Throws std::runtime_error that begins with `what` outside (0, 4294967295] s, the times that a bag can hold.
ros::Time bag_time(TimeNs t_ns, const std::string& what);
ros::Duration bag_duration(TimeNs t_ns);

std_msgs::Header make_header(ros::Time stamp, const std::string& frame_id);

/// Little-endian, rows without padding.
sensor_msgs::Image image_message(const std_msgs::Header& header, const cv::Mat& image, const std::string& encoding);

/// Orientation, and acceleration when absent, are marked as not measured (covariance[0] = -1, REP 145).
sensor_msgs::Imu imu_message(const std_msgs::Header& header, const Eigen::Vector3d& rate_rad_s,
                             const std::optional<Eigen::Vector3d>& specific_force_m_s2);

Exposure exposure_message(const std_msgs::Header& header, TimeNs exposure_ns, TimeNs readout_ns);

/// Transform from `imu_frame` (parent) to `camera_frame` (child).
/// @param p_imu_cam_m  origin of the camera in IMU coordinates
tf2_msgs::TFMessage extrinsic_message(const Eigen::Matrix3d& R_cam_imu, const Eigen::Vector3d& p_imu_cam_m,
                                      const std::string& imu_frame, const std::string& camera_frame, ros::Time stamp);

/// Writes to /tf_static such that players latch it.
void write_tf_static(rosbag::Bag& bag, ros::Time time, const tf2_msgs::TFMessage& message);

}  // namespace gyro_deblur
