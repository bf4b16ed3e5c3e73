// Converts and writes times, vectors and samples.
#include "ros/value_conversion.hpp"

#include <algorithm>
#include <cinttypes>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <sstream>

namespace gyro_deblur {
namespace {

constexpr TimeNs kNsPerSecond = 1'000'000'000;

}  // namespace

TimeNs to_time_ns(const ros::Time& time) { return static_cast<TimeNs>(time.toNSec()); }

ros::Time to_ros_time(TimeNs time_ns) {
  const TimeNs latest_ns = std::numeric_limits<std::uint32_t>::max() * kNsPerSecond;
  ros::Time time;
  time.fromNSec(static_cast<std::uint64_t>(std::clamp<TimeNs>(time_ns, 0, latest_ns)));
  return time;
}

std::string seconds_text(TimeNs time_ns) {
  char text[40];
  const std::uint64_t magnitude =
      time_ns < 0 ? std::uint64_t{0} - static_cast<std::uint64_t>(time_ns) : static_cast<std::uint64_t>(time_ns);
  std::snprintf(text, sizeof(text), "%s%" PRIu64 ".%09" PRIu64, time_ns < 0 ? "-" : "", magnitude / kNsPerSecond,
                magnitude % kNsPerSecond);
  return text;
}

std::string vector_text(const Eigen::Vector3d& v) {
  char text[80];
  std::snprintf(text, sizeof(text), "[%.6f, %.6f, %.6f]", v.x(), v.y(), v.z());
  return text;
}

std::string size_text(double width, double height) {
  std::ostringstream text;
  text << width << "x" << height;
  return text.str();
}

std::optional<GyroSample> to_gyro_sample(const sensor_msgs::Imu& imu) {
  if (imu.angular_velocity_covariance[0] == -1) return std::nullopt;
  const auto to_eigen = [](const auto& v) { return Eigen::Vector3d(v.x, v.y, v.z); };
  GyroSample sample{to_time_ns(imu.header.stamp), to_eigen(imu.angular_velocity)};
  if (imu.linear_acceleration_covariance[0] != -1) sample.specific_force_m_s2 = to_eigen(imu.linear_acceleration);
  return sample;
}

}  // namespace gyro_deblur
