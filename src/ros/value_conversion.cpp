// Converts times and samples.
#include "ros/value_conversion.hpp"

#include <algorithm>
#include <cstdint>
#include <limits>

#include <Eigen/Core>

namespace gyro_deblur {

TimeNs to_time_ns(const ros::Time& time) { return static_cast<TimeNs>(time.toNSec()); }

ros::Time to_ros_time(TimeNs time_ns) {
  constexpr TimeNs kNsPerSecond = 1'000'000'000;
  const TimeNs latest_ns = std::numeric_limits<std::uint32_t>::max() * kNsPerSecond;
  ros::Time time;
  time.fromNSec(static_cast<std::uint64_t>(std::clamp<TimeNs>(time_ns, 0, latest_ns)));
  return time;
}

std::optional<GyroSample> to_gyro_sample(const sensor_msgs::Imu& imu) {
  if (imu.angular_velocity_covariance[0] == -1) return std::nullopt;
  const auto to_eigen = [](const auto& v) { return Eigen::Vector3d(v.x, v.y, v.z); };
  GyroSample sample{to_time_ns(imu.header.stamp), to_eigen(imu.angular_velocity)};
  if (imu.linear_acceleration_covariance[0] != -1) sample.specific_force_m_s2 = to_eigen(imu.linear_acceleration);
  return sample;
}

}  // namespace gyro_deblur
