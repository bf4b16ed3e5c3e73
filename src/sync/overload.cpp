// Decides which frames are passed through under overload.
#include "sync/overload.hpp"

#include <vector>

#include "base/format.hpp"
#include "base/median.hpp"

namespace gyro_deblur {

void OverloadRule::end(TimeNs steady_ns) {
  constexpr std::size_t kKept = 5;
  if (!begun_ns_) return;
  const TimeNs takes_ns = steady_ns - *begun_ns_;
  begun_ns_.reset();
  if (!behind_camera_rate_ && (durations_ns_.empty() || takes_ns >= usual_ns())) return;
  durations_ns_.push_back(takes_ns);
  if (durations_ns_.size() > kKept) durations_ns_.pop_front();
}

TimeNs OverloadRule::usual_ns() const {
  return median(std::vector<TimeNs>(durations_ns_.begin(), durations_ns_.end()));
}

std::string OverloadRule::pass_through_text(TimeNs now_ns, TimeNs ready_ns, std::size_t ready_behind,
                                            std::optional<TimeNs> frame_period_ns) const {
  // One slow frame (the first, or the first with a longer blur) is no overload: the median of three is another's.
  constexpr std::size_t kEnough = 3;
  if (ready_behind < kReadyQueue || !frame_period_ns || durations_ns_.size() < kEnough) return {};
  const TimeNs waited_ns = now_ns - ready_ns;
  if (waited_ns <= static_cast<TimeNs>(kReadyQueue) * *frame_period_ns) return {};
  // Twice as fast as the camera: a burst of n frames is worked off within n periods.
  const TimeNs takes_ns = usual_ns();
  if (2 * takes_ns <= *frame_period_ns) return {};
  return "processing (" + seconds_text(takes_ns) + " s a frame) is slower than the camera (" +
         seconds_text(*frame_period_ns) + " s a frame): this frame was ready for " + seconds_text(waited_ns) +
         " s, with " + std::to_string(ready_behind) + " newer frames behind it";
}

bool OverloadRule::is_behind_camera_rate(TimeNs now_ns, TimeNs ready_ns, std::size_t ready_behind,
                                         std::optional<TimeNs> frame_period_ns) {
  return ready_behind > 0 && frame_period_ns && now_ns - ready_ns > *frame_period_ns;
}

}  // namespace gyro_deblur
