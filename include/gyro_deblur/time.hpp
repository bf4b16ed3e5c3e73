// Time, and stretches of it.
#pragma once

#include <cstdint>

namespace gyro_deblur {

/// Time in integer nanoseconds. Which clock (camera or IMU) is part of the variable's documentation.
using TimeNs = std::int64_t;

/// Seconds to nanoseconds, rounded to nearest. Precondition: |seconds| < 9.2e9.
TimeNs to_ns(double seconds);
/// Nanoseconds to seconds (exact to about 1e-16 relative).
double to_seconds(TimeNs ns);

/// Closed interval [begin_ns, end_ns] of one clock; empty when begin_ns > end_ns.
struct TimeRange {
  TimeNs begin_ns = 0;
  TimeNs end_ns = -1;

  bool empty() const { return begin_ns > end_ns; }
  bool contains(TimeNs t_ns) const { return begin_ns <= t_ns && t_ns <= end_ns; }
  bool contains(const TimeRange& other) const {
    return !other.empty() && contains(other.begin_ns) && contains(other.end_ns);
  }
};

}  // namespace gyro_deblur
