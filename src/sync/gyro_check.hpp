// What the samples of an IMU show by themselves to be wrong with it.
#pragma once

#include <cstddef>
#include <deque>
#include <optional>

#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// Reports samples that come too seldom, and rates that no gyroscope measures. Not thread-safe.
class GyroCheck {
 public:
  /// @param problems  has to outlive this
  explicit GyroCheck(InputProblems* problems) : problems_(*problems) {}

  /// A message has come, whatever its stamp. Precondition: its rate is finite.
  void add(const GyroSample& sample, const GyroOptions& options);
  /// A message has come that says it has no angular rates.
  void add_without_rates();

  /// The longest step between samples that may be the sensor's own: max_gap_ns, or more where samples come more seldom.
  TimeNs longest_step_ns(const GyroOptions& options) const;
  /// Rates that no gyroscope measures have come in the last seconds.
  bool unit_is_wrong() const { return is_beyond_; }
  /// All rates of the last second or more are exactly 0.
  bool rates_are_zero() const { return zero_since_ns_ && last_ns_ - *zero_since_ns_ >= 1'000'000'000; }

 private:
  void check_rate(TimeNs stamp_ns, const GyroOptions& options);
  void check_unit(const GyroSample& sample, const GyroOptions& options);

  struct Beyond {
    TimeNs t_ns;
    double rate_rad_s;
  };
  InputProblems& problems_;
  std::deque<TimeNs> stamps_;   // of the newest messages, in order of arrival
  TimeNs typical_step_ns_ = 0;  // median between them; 0: not known
  bool is_slow_ = false;
  std::deque<Beyond> beyond_;  // the sensor's range, of the last seconds
  bool is_beyond_ = false;
  std::size_t with_rates_ = 0;  // messages in a row
  std::optional<TimeNs> zero_since_ns_;
  TimeNs last_ns_ = 0;
};

}  // namespace gyro_deblur
