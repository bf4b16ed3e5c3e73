// Times and samples of messages.
#pragma once

#include <optional>

#include <ros/time.h>
#include <sensor_msgs/Imu.h>

#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Nanoseconds of a stamp; to_ros_time clamps to what ros::Time can hold (0 to 2^32 - 1 s).
TimeNs to_time_ns(const ros::Time& time);
ros::Time to_ros_time(TimeNs time_ns);

/// A stamp of 0 has not been set: it is not used as a time. (At the start of a simulation it may be right. What such
/// an image loses there is one frame.)
constexpr bool is_unset(TimeNs stamp_ns) { return stamp_ns == 0; }

/// Body rate, specific force and stamp of an IMU message; nothing when its covariance says that it has no gyroscope
/// (sensor_msgs/Imu: first element -1). The same of the acceleration leaves that one out.
std::optional<GyroSample> to_gyro_sample(const sensor_msgs::Imu& imu);

}  // namespace gyro_deblur
