// Rotations out of tf.
#pragma once

#include <optional>
#include <string>

#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>
#include <Eigen/Geometry>

namespace gyro_deblur {

/// Adds transforms such that the newest to arrive counts, whatever its stamp: an extrinsic is wanted as it is now, and
/// a clock that was set back must not make tf refuse what comes. (tf2_ros::TransformListener goes by stamps, and a bag
/// has no topics to listen to.)
void add_transforms(const tf2_msgs::TFMessage& message, tf2::BufferCore* buffer);

/// Rotation that takes IMU coordinates to camera coordinates, the newest that tf has; nothing when it has none.
std::optional<Eigen::Matrix3d> lookup_R_cam_imu(const tf2::BufferCore& buffer, const std::string& camera_frame,
                                                const std::string& imu_frame);

}  // namespace gyro_deblur
