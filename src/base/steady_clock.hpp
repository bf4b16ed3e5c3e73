// The machine's clock that no simulated time stops.
#pragma once

#include <chrono>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

inline TimeNs steady_now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

}  // namespace gyro_deblur
