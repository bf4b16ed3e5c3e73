// Time, and stretches of it.
#pragma once

#include <cmath>
#include <cstdint>

namespace gyro_deblur {

/// Time in integer nanoseconds. Which clock (camera or IMU) is part of the variable's documentation.
using TimeNs = std::int64_t;

/// Seconds to nanoseconds, rounded to nearest. Precondition: |seconds| < 9.2e9.
inline TimeNs to_ns(double seconds) {
  // Whole seconds apart: for stamps since 1970 the product seconds * 1e9 alone would lose up to 128 ns.
  const double whole = std::floor(seconds);
  return static_cast<TimeNs>(whole) * 1'000'000'000 + std::llround((seconds - whole) * 1e9);
}

/// Nanoseconds to seconds (exact to about 1e-16 relative).
inline double to_seconds(TimeNs ns) { return static_cast<double>(ns) / 1e9; }

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
