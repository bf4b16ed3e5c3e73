// Rotations out of tf.
#pragma once

#include <optional>
#include <string>

#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>
#include <Eigen/Geometry>

namespace gyro_deblur {

/// Transforms of /tf_static and /tf. On each topic the newest to arrive counts, whatever its stamp: an extrinsic is
/// wanted as it is now, and a clock that was set back must not make tf refuse what comes. (tf2_ros::TransformListener
/// goes by stamps, and a bag has no topics to listen to.) Thread-safe.
class Transforms {
 public:
  enum class Topic { TF, TF_STATIC };

  void add(const tf2_msgs::TFMessage& message, Topic topic);

  /// Rotation that takes IMU coordinates to camera coordinates; nothing when there is none. /tf_static alone decides
  /// where it connects the frames: VINS-Mono and VINS-Fusion publish the pose of "camera" in "body" on /tf, which would
  /// replace the camera's parent.
  std::optional<Eigen::Matrix3d> R_cam_imu(const std::string& camera_frame, const std::string& imu_frame) const;

 private:
  tf2::BufferCore static_, all_;
};

}  // namespace gyro_deblur
