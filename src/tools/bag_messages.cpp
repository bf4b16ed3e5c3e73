// Makes the messages of a camera and an IMU.
#include "tools/bag_messages.hpp"

#include <stdexcept>

#include <geometry_msgs/TransformStamped.h>
#include <tf2_msgs/TFMessage.h>
#include <Eigen/Geometry>

#include "ros/value_conversion.hpp"

namespace gyro_deblur {

ros::Time bag_time(TimeNs t_ns, const std::string& what) {
  // to_ros_time clamps what ros::Time cannot hold, and rosbag refuses 0.
  const ros::Time time = to_ros_time(t_ns);
  if (time.isZero() || to_time_ns(time) != t_ns) {
    throw std::runtime_error(what + " at " + std::to_string(t_ns) + " ns: a bag holds times in (0, 4294967295] s");
  }
  return time;
}

std_msgs::Header make_header(ros::Time stamp, const std::string& frame_id) {
  std_msgs::Header header;
  header.stamp = stamp;
  header.frame_id = frame_id;
  return header;
}

sensor_msgs::Imu imu_message(const std_msgs::Header& header, const Eigen::Vector3d& rate_rad_s,
                             const std::optional<Eigen::Vector3d>& specific_force_m_s2) {
  sensor_msgs::Imu message;
  message.header = header;
  message.orientation_covariance[0] = -1;
  message.angular_velocity.x = rate_rad_s.x();
  message.angular_velocity.y = rate_rad_s.y();
  message.angular_velocity.z = rate_rad_s.z();
  if (specific_force_m_s2) {
    message.linear_acceleration.x = specific_force_m_s2->x();
    message.linear_acceleration.y = specific_force_m_s2->y();
    message.linear_acceleration.z = specific_force_m_s2->z();
  } else {
    message.linear_acceleration_covariance[0] = -1;
  }
  return message;
}

Exposure exposure_message(const std_msgs::Header& header, TimeNs exposure_ns, TimeNs readout_ns) {
  Exposure message;
  message.header = header;
  message.exposure_time.fromNSec(exposure_ns);
  message.readout_time.fromNSec(readout_ns);
  return message;
}

void write_extrinsic(rosbag::Bag& bag, ros::Time time, const Eigen::Matrix3d& R_cam_imu,
                     const Eigen::Vector3d& p_imu_cam_m, const std::string& imu_frame,
                     const std::string& camera_frame) {
  geometry_msgs::TransformStamped transform;
  transform.header = make_header(time, imu_frame);
  transform.child_frame_id = camera_frame;
  // tf takes child coordinates to parent coordinates.
  const Eigen::Quaterniond R_imu_cam(Eigen::Matrix3d(R_cam_imu.transpose()));
  transform.transform.rotation.w = R_imu_cam.w();
  transform.transform.rotation.x = R_imu_cam.x();
  transform.transform.rotation.y = R_imu_cam.y();
  transform.transform.rotation.z = R_imu_cam.z();
  transform.transform.translation.x = p_imu_cam_m.x();
  transform.transform.translation.y = p_imu_cam_m.y();
  transform.transform.translation.z = p_imu_cam_m.z();
  tf2_msgs::TFMessage message;
  message.transforms.push_back(transform);
  auto latched = boost::make_shared<ros::M_string>();
  (*latched)["latching"] = "1";
  (*latched)["type"] = ros::message_traits::datatype<tf2_msgs::TFMessage>();
  (*latched)["md5sum"] = ros::message_traits::md5sum<tf2_msgs::TFMessage>();
  (*latched)["message_definition"] = ros::message_traits::definition<tf2_msgs::TFMessage>();
  bag.write("/tf_static", time, message, latched);
}

}  // namespace gyro_deblur
