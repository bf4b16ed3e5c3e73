// The one rule for stamps that do not fit: a message whose stamp does not fit is held back until those after it show
// which was wrong.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "base/median.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// What fits a stream, and how many messages in a row have to agree with each other before they count against
/// those that came before. Times > 0.
struct StampLimits {
  static constexpr TimeNs kAnyTime = std::numeric_limits<TimeNs>::max();
  static constexpr std::size_t kNever = std::numeric_limits<std::size_t>::max();

  TimeNs ahead_ns = kAnyTime;  ///< a stamp farther ahead of the newest does not fit
  TimeNs back_ns = kAnyTime;   ///< up to this before the newest one is late; farther back it is far
  TimeNs step_ns = kAnyTime;   ///< farther off, a message agrees with the one before when it is up to this after it...
  bool repeats_agree = false;  ///< ... or not more than back_ns before it, whether or not it fits as well
  std::size_t ahead_needed = kNever;  ///< >= 2; so many in a row that are ahead: the stream was silent
  std::size_t back_needed = kNever;   ///< >= 1; so many in a row that are farther back: time was reset
  std::size_t late_needed = 2;        ///< >= 2; so many in a row that are late, and the first of them farther
  TimeNs late_reset_ns = kAnyTime;    ///< back than this (>= 0): time was set back
  /// Where one comes that is not after the newest: the newest was ahead if it is farther from the one before than so
  /// many typical steps; 0: it never was.
  double ahead_steps = 0;
};

/// The limits of each stream; the reasons stand with the values.
StampLimits imu_stamps(TimeNs max_gap_ns, TimeNs time_jump_ns);
StampLimits watched_stamps(TimeNs time_jump_ns);  ///< of what TimeJumpDetector watches

/// What is wrong with a stamp.
enum class RejectReason {
  REPEATED,  ///< that of another message
  LATE,      ///< before the newest
  FAR,       ///< far from those around it
  AHEAD,     ///< ahead of those that came after it
};

/// What a message that has come decides; to be applied in this order.
template <typename Message>
struct TimestampFilterResult {
  struct Refused {
    Message message;
    RejectReason why;
  };
  struct Reset {
    TimeNs from_ns, to_ns;
  };
  bool late = false;             ///< this message came after a newer one that is not refused by it
  bool newest_refused = false;   ///< the newest that was taken is among `refused`: its owner gives it back
  std::optional<Reset> reset;    ///< time was set back: all that was taken before is of another epoch
  std::vector<Message> taken;    ///< in order, and after all that was taken since the reset
  std::vector<Refused> refused;  ///< this message, or ones that were held back
};

/// Decides over the stamps of one stream. Not thread-safe.
/// @tparam Message  has a member t_ns
template <typename Message>
class TimestampFilter {
 public:
  using Result = TimestampFilterResult<Message>;

  /// Takes, refuses, or holds a message back, and decides over those that were held back before it.
  Result add(const Message& message, const StampLimits& limits) {
    Result result;
    check(message, limits, &result);
    return result;
  }

  /// Newest stamp of the messages that were taken; nothing before the first.
  std::optional<TimeNs> newest_ns() const {
    return newest_ ? std::optional<TimeNs>(newest_->t_ns) : std::optional<TimeNs>();
  }

  /// The owner knows by other means that this one is the newest, whatever came before.
  void restart(const Message& message) {
    *this = {};
    newest_ = message;
  }

 private:
  enum class Order { NEXT, REPEATED, LATE, BACK, AHEAD };

  Order order_of(TimeNs stamp_ns, const StampLimits& limits) const {
    if (!newest_) return Order::NEXT;
    const TimeNs step_ns = stamp_ns - newest_->t_ns;
    if (step_ns > 0) return step_ns <= limits.ahead_ns ? Order::NEXT : Order::AHEAD;
    if (step_ns == 0) return Order::REPEATED;
    return step_ns >= -limits.back_ns ? Order::LATE : Order::BACK;
  }

  /// Whether a message goes on where the far ones are.
  bool agrees_with_far(TimeNs stamp_ns, Order order, const StampLimits& limits) const {
    if (far_.empty()) return false;
    const TimeNs step_ns = stamp_ns - far_.back().t_ns;
    if (limits.repeats_agree) return step_ns >= -limits.back_ns;
    return (order == Order::BACK || order == Order::AHEAD) && step_ns > 0 && step_ns <= limits.step_ns;
  }

  void check(const Message& message, const StampLimits& limits, Result* result) {
    const Order order = order_of(message.t_ns, limits);
    if (agrees_with_far(message.t_ns, order, limits)) return hold_far(message, limits, result);
    switch (order) {
      case Order::NEXT:
        refuse(&far_, RejectReason::FAR, result);
        refuse(&late_, RejectReason::LATE, result);
        return take(message, result);
      case Order::REPEATED:
        refuse(&far_, RejectReason::FAR, result);
        if (newest_is_ahead(message.t_ns, limits)) {
          give_newest_back(RejectReason::REPEATED, result);
          return take(message, result);
        }
        result->refused.push_back({message, RejectReason::REPEATED});
        return;
      case Order::LATE:
        refuse(&far_, RejectReason::FAR, result);
        return hold_late(message, limits, result);
      case Order::BACK:
      case Order::AHEAD:
        break;
    }
    const TimeNs step_ns = far_.empty() ? 0 : message.t_ns - far_.back().t_ns;
    if (!far_.empty() && step_ns <= 0 && step_ns >= -limits.back_ns) {  // late among the far ones
      result->late = step_ns < 0;
      result->refused.push_back({message, step_ns == 0 ? RejectReason::REPEATED : RejectReason::LATE});
      return;
    }
    refuse(&far_, RejectReason::FAR, result);
    hold_far(message, limits, result);
  }

  void hold_far(const Message& message, const StampLimits& limits, Result* result) {
    const TimeNs first_ns = far_.empty() ? message.t_ns : far_.front().t_ns;
    const bool ahead = first_ns > newest_->t_ns;
    if (far_.size() + 1 < (ahead ? limits.ahead_needed : limits.back_needed)) return far_.push_back(message);
    refuse(&late_, RejectReason::LATE, result);
    if (!ahead) reset(first_ns, result);
    take_held(&far_, result);
    check(message, limits, result);  // against them; it may repeat the last
  }

  void hold_late(const Message& message, const StampLimits& limits, Result* result) {
    result->late = true;
    if (!late_.empty() && message.t_ns <= late_.back().t_ns) refuse(&late_, RejectReason::LATE, result);
    if (newest_is_ahead(message.t_ns, limits)) {
      result->late = false;
      refuse(&late_, RejectReason::LATE, result);
      give_newest_back(RejectReason::AHEAD, result);
      return take(message, result);
    }
    late_.push_back(message);
    if (late_.size() >= limits.late_needed) {
      if (newest_->t_ns - late_.front().t_ns > limits.late_reset_ns) {
        reset(late_.front().t_ns, result);
        take_held(&late_, result);
      } else {
        result->refused.push_back({late_.front(), RejectReason::LATE});
        late_.erase(late_.begin());
      }
    }
  }

  /// Whether the newest came too early, when this one comes and is not after it.
  bool newest_is_ahead(TimeNs stamp_ns, const StampLimits& limits) const {
    if (limits.ahead_steps <= 0 || steps_ < kEnoughSteps) return false;
    if (!before_newest_ || stamp_ns <= before_newest_->t_ns) return false;
    const auto end = steps_ns_.begin() + static_cast<std::ptrdiff_t>(std::min(steps_, steps_ns_.size()));
    const double typical_ns = static_cast<double>(median(std::vector<TimeNs>(steps_ns_.begin(), end)));
    return static_cast<double>(newest_->t_ns - before_newest_->t_ns) > limits.ahead_steps * typical_ns;
  }

  void give_newest_back(RejectReason why, Result* result) {
    result->newest_refused = true;
    result->refused.push_back({*newest_, why});
    newest_ = std::exchange(before_newest_, std::nullopt);
    --steps_;
  }

  void reset(TimeNs to_ns, Result* result) {
    result->reset = typename Result::Reset{newest_->t_ns, to_ns};
    newest_.reset();
    before_newest_.reset();
  }

  void take_held(std::vector<Message>* held, Result* result) {
    for (const Message& each : std::exchange(*held, {})) take(each, result);
  }
  void take(const Message& message, Result* result) {
    if (newest_) steps_ns_[steps_++ % steps_ns_.size()] = message.t_ns - newest_->t_ns;
    before_newest_ = std::exchange(newest_, message);
    result->taken.push_back(message);
  }
  void refuse(std::vector<Message>* held, RejectReason why, Result* result) {
    for (Message& each : *held) result->refused.push_back({std::move(each), why});
    held->clear();
  }

  static constexpr std::size_t kEnoughSteps = 5;

  std::optional<Message> newest_, before_newest_;  // that were taken since the last reset
  std::array<TimeNs, 15> steps_ns_{};              // from each that was taken to the next; the last ones
  std::size_t steps_ = 0;                          // that have been; the next goes to this place, modulo the size
  std::vector<Message> far_;                       // held: in a row, agreeing with each other
  std::vector<Message> late_;                      // held: in order among themselves
};

}  // namespace gyro_deblur
