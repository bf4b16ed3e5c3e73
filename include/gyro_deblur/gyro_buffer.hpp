// Bounded, ordered store of gyroscope samples in the IMU clock.
#pragma once

#include <deque>
#include <limits>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// One reading of the IMU at an instant of its clock, in its axes.
struct GyroSample {
  TimeNs t_ns = 0;
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();  ///< body rate
  /// Acceleration minus gravity: 9.8 m/s^2 upwards at rest. Not finite: there is no accelerometer.
  Eigen::Vector3d specific_force_m_s2 = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
};

/// Keeps the newest samples, strictly increasing in time, no older than `capacity_ns` before the newest.
/// Not thread-safe: its owner serialises access.
class GyroBuffer {
 public:
  /// Precondition: capacity_ns > 0.
  explicit GyroBuffer(TimeNs capacity_ns);

  /// Adds a sample. False, and the buffer as it was, for a sample whose rate is not finite or that is not newer than
  /// the newest.
  bool add(const GyroSample& sample);

  /// Forgets the newest sample and returns it. Precondition: not empty.
  GyroSample drop_newest();

  /// Forgets everything.
  void clear() { samples_.clear(); }

  bool empty() const { return samples_.empty(); }
  std::size_t size() const { return samples_.size(); }

  /// From the oldest to the newest sample (IMU clock); empty() when there is none.
  TimeRange available() const;

  /// The samples needed to know the rate anywhere in `requested` (IMU clock): all inside, and one neighbour on each
  /// side where there is one. Never extrapolates: what is missing at the ends is missing in the answer.
  std::vector<GyroSample> window(const TimeRange& requested) const;

 private:
  TimeNs capacity_ns_;
  std::deque<GyroSample> samples_;
};

}  // namespace gyro_deblur
