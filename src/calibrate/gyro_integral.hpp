// Mean rates of the gyroscope over any stretch of the last seconds, in bounded memory.
#pragma once

#include <deque>

#include <Eigen/Core>

#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The integral of the rates. Axes and clock of the IMU. Not thread-safe.
class GyroIntegral {
 public:
  /// @param kept_ns  length of the integral's past [ns], > 0
  explicit GyroIntegral(TimeNs kept_ns) : kept_ns_(kept_ns) {}

  /// Samples that are not finite, or not newer than the newest, are left out; begins anew where time goes back by more
  /// than a second.
  void add(const GyroSample& sample);
  void clear() { knots_.clear(); }

  /// From the oldest to the newest sample; empty() when there is none.
  TimeRange available() const;
  /// True when there are samples everywhere in `range`: no two neighbours are more than 50 ms apart.
  bool covers(const TimeRange& range) const;
  /// Precondition: covers(range), and the range is longer than 0.
  Eigen::Vector3d mean_rate(const TimeRange& range) const;

 private:
  struct Knot {
    TimeNs t_ns;
    Eigen::Vector3d integral_rad, rate_rad_s;
    TimeNs whole_since_ns;  // there are no holes since then
  };
  Eigen::Vector3d integral_at(TimeNs t_ns) const;
  std::deque<Knot>::const_iterator first_from(TimeNs t_ns) const;

  TimeNs kept_ns_;
  std::deque<Knot> knots_;
  Knot newest_{};  // of samples; those that follow the last knot too closely make none
};

}  // namespace gyro_deblur
