// Plays deliveries into a processor in real time, as a camera and a nodelet would.
#pragma once

#include <chrono>
#include <functional>
#include <vector>

#include "recording.hpp"
#include "ros/processor.hpp"

namespace gyro_deblur::test {

/// The clock of a node whose camera starts now: shows `begin_ns` at first and goes on with the steady clock.
class LiveClock {
 public:
  explicit LiveClock(TimeNs begin_ns) : begin_ns_(begin_ns) {}
  TimeNs now() const { return begin_ns_ + steady(start_, std::chrono::steady_clock::now()); }
  /// When the clock shows `t_ns`.
  std::chrono::steady_clock::time_point when(TimeNs t_ns) const {
    return start_ + std::chrono::nanoseconds(t_ns - begin_ns_);
  }

 private:
  static TimeNs steady(std::chrono::steady_clock::time_point from, std::chrono::steady_clock::time_point to) {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(to - from).count();
  }
  TimeNs begin_ns_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

/// Plays `deliveries` again and again, a round every `round_ns`, until `clock` shows `end_ns`. A thread of its own
/// calls `deliver` at each message's time with what its stamps have to be shifted by; the calling thread takes frames
/// out, as a nodelet's worker does. Returns when all frames have left.
void play_live(const std::vector<Delivery>& deliveries, TimeNs round_ns, TimeNs end_ns, const LiveClock& clock,
               const std::function<void(const Delivery&, TimeNs shift_ns)>& deliver, Processor* processor,
               const Processor::Sink& sink);

}  // namespace gyro_deblur::test
