// Looks up rotations in tf.
#include "ros/tf_conversion.hpp"

#include <tf2/exceptions.h>

namespace gyro_deblur {
namespace {

/// Old drivers write a leading slash, which tf2 does not take.
std::string tf2_name(const std::string& frame_id) {
  return !frame_id.empty() && frame_id.front() == '/' ? frame_id.substr(1) : frame_id;
}

void add_to(const tf2_msgs::TFMessage& message, tf2::BufferCore* buffer) {
  constexpr bool kStatic = true;  // tf keeps one transform then, and looks at no stamps
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    buffer->setTransform(transform, "gyro_deblur", kStatic);
  }
}

std::optional<Eigen::Matrix3d> rotation_between(const tf2::BufferCore& buffer, const std::string& camera_frame,
                                                const std::string& imu_frame) {
  try {
    if (!buffer.canTransform(camera_frame, imu_frame, ros::Time(0))) return std::nullopt;
    const auto q = buffer.lookupTransform(camera_frame, imu_frame, ros::Time(0)).transform.rotation;
    return Eigen::Quaterniond(q.w, q.x, q.y, q.z).normalized().toRotationMatrix();
  } catch (const tf2::TransformException&) {
    return std::nullopt;  // went away between the two calls, or a frame name that tf refuses
  }
}

}  // namespace

void Transforms::add(const tf2_msgs::TFMessage& message, Topic topic) {
  add_to(message, &all_);
  if (topic == Topic::TF_STATIC) add_to(message, &static_);
}

std::optional<Eigen::Matrix3d> Transforms::R_cam_imu(const std::string& camera_frame_id,
                                                     const std::string& imu_frame_id) const {
  const std::string camera_frame = tf2_name(camera_frame_id);
  const std::string imu_frame = tf2_name(imu_frame_id);
  if (camera_frame.empty() || imu_frame.empty()) return std::nullopt;
  const auto fixed = rotation_between(static_, camera_frame, imu_frame);
  return fixed ? fixed : rotation_between(all_, camera_frame, imu_frame);
}

}  // namespace gyro_deblur
