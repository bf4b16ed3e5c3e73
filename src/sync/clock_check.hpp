// Whether images and IMU samples are stamped by the same clock.
#pragma once

#include <cstddef>
#include <optional>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/time.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// Compares the newest stamps of both streams, while both come. Reports that they do not overlap, by how much, and the
/// time_offset that would bring them together. Not thread-safe.
class ClockCheck {
 public:
  /// @param problems  has to outlive this
  explicit ClockCheck(InputProblems* problems) : problems_(*problems) {}

  void add_image(TimeNs stamp_ns) {
    newest_image_ns_ = stamp_ns;
    ++images_;
  }
  /// @param newest_ns  IMU clock
  void add_samples(TimeNs newest_ns, std::size_t count) {
    newest_imu_ns_ = newest_ns;
    samples_ += count;
  }
  /// To be called as time passes.
  /// @param now_ns   of a clock that goes on
  /// @param is_live  messages come when they are sent: those of a recording may have been recorded late
  void check(const Config& config, TimeNs now_ns, bool is_live);
  /// A clock was set, or as after the start.
  void clear();

 private:
  enum class Side { TOGETHER, IMAGES_AHEAD, IMAGES_BEHIND };
  Side side(const Config& config, bool is_live) const;
  void report(const Config& config) const;

  InputProblems& problems_;
  std::optional<TimeNs> newest_image_ns_, newest_imu_ns_;
  std::size_t images_ = 0, samples_ = 0;
  Side side_ = Side::TOGETHER;
  TimeNs since_ns_ = 0;                                 // it is on that side
  std::size_t images_before_ = 0, samples_before_ = 0;  // that
  bool reported_ = false;
};

}  // namespace gyro_deblur
