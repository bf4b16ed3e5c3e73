// Limits of the stamps of each kind of stream.
#include "sync/timestamp_filter.hpp"

namespace gyro_deblur {

StampLimits imu_stamps(TimeNs max_gap_ns, TimeNs time_jump_ns) {
  StampLimits limits;
  // Samples come without holes; across a longer one nothing is integrated.
  limits.ahead_ns = limits.step_ns = max_gap_ns;
  limits.back_ns = time_jump_ns;
  // An IMU that was silent, or whose clock was set. Fewer are wrong stamps, which must not empty the buffer.
  limits.ahead_needed = limits.back_needed = 5;
  // A bag shorter than time_jump_ns that loops. Jitter of a driver does not deliver that many in order. Less far back,
  // they follow stamps that were ahead, or a clock that was set a little: they catch up before the hole is too long.
  limits.late_needed = 10;
  limits.late_reset_ns = max_gap_ns;
  // Samples come in order. After one whose stamp is ahead by a step or more, the next one's is not after it: half a
  // step from either, to know it from one that is late itself. At once: at 4 kHz hundreds may follow before its stamp.
  limits.ahead_steps = 1.5;
  return limits;
}

StampLimits watched_stamps(TimeNs time_jump_ns) {
  StampLimits limits;
  limits.ahead_ns = limits.back_ns = time_jump_ns;
  // Images may come seldom, and a clock is read more than once at a time.
  limits.repeats_agree = true;
  // One stamp far ahead would make the next right one look like a reset.
  limits.ahead_needed = 2;
  // At once: frames wait for what is not going to come, and in each stream new messages have to be separated from old
  // ones.
  limits.back_needed = 1;
  return limits;
}

}  // namespace gyro_deblur
