// Time that passes.
#pragma once

#include <chrono>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The machine's clock that no simulated time stops.
inline TimeNs steady_now_ns() {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Milliseconds since construction, or since the latest lap().
class Stopwatch {
 public:
  double ms() const { return std::chrono::duration<double, std::milli>(Clock::now() - start_).count(); }

  /// ms(), and starts again.
  double lap() {
    const double passed_ms = ms();
    start_ = Clock::now();
    return passed_ms;
  }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point start_ = Clock::now();
};

/// Adds the milliseconds of its life to a sum.
class StageTimer {
 public:
  /// @param sum_ms  outlives the timer
  explicit StageTimer(double* sum_ms) : sum_ms_(sum_ms) {}
  ~StageTimer() { *sum_ms_ += watch_.ms(); }
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  double* sum_ms_;
  Stopwatch watch_;
};

}  // namespace gyro_deblur
