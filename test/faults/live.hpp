// Plays deliveries into a processor in real time, as a camera and a nodelet would.
#pragma once

#include <chrono>
#include <functional>
#include <vector>

#include "recording.hpp"
#include "ros/processor.hpp"

namespace gyro_deblur::test {

/// The clock of a node whose camera starts now: shows `begin_ns` at first and goes on with the steady clock, a little
/// faster than that, so that frames come at every phase of the kernel's ticks. A steady rate has one or a few of them,
/// and a run would measure those.
class LiveClock {
 public:
  /// @param length_s  within which it goes once through all phases of ticks of 4 ms (250 Hz)
  explicit LiveClock(TimeNs begin_ns, double length_s = 8) : rate_(1 + kTickS / length_s), begin_ns_(begin_ns) {}
  TimeNs now() const {
    const std::chrono::duration<double, std::nano> passed = std::chrono::steady_clock::now() - start_;
    return begin_ns_ + static_cast<TimeNs>(passed.count() * rate_);
  }
  /// When the clock shows `t_ns`.
  std::chrono::steady_clock::time_point when(TimeNs t_ns) const {
    return start_ + std::chrono::nanoseconds(static_cast<TimeNs>(static_cast<double>(t_ns - begin_ns_) / rate_));
  }

 private:
  static constexpr double kTickS = 0.004;
  double rate_;
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
