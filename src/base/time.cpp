// Conversion between seconds and nanoseconds.
#include "gyro_deblur/time.hpp"

#include <cmath>

namespace gyro_deblur {

TimeNs to_ns(double seconds) {
  // Whole seconds apart: for stamps since 1970 the product seconds * 1e9 alone would lose up to 128 ns.
  const double whole = std::floor(seconds);
  return static_cast<TimeNs>(whole) * 1'000'000'000 + std::llround((seconds - whole) * 1e9);
}

double to_seconds(TimeNs ns) { return static_cast<double>(ns) / 1e9; }

}  // namespace gyro_deblur
