// Overload: which frames are passed through because processing is slower than the camera.
#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <string>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The newest frames matter to SLAM: when processing is slower than the camera, frames that are ready wait in a queue
/// of two. When it is fast, more that are ready at once (the IMU's samples come in batches, a network that stalled) are
/// a burst, which it works off. Times are of a steady clock; without one nothing is overload.
/// Not thread-safe.
class OverloadRule {
 public:
  /// Frames that are ready behind the foremost one before that can be passed through.
  static constexpr std::size_t kReadyQueue = 2;

  /// Processing of a frame begins. How long it takes counts when it is behind the camera's rate, or takes less than
  /// those that were: what has time may take it.
  void begin(TimeNs steady_ns, bool behind_camera_rate) {
    begun_ns_ = steady_ns;
    behind_camera_rate_ = behind_camera_rate;
  }
  /// The frame has to wait for its stereo partners, which is no processing.
  void pause(TimeNs steady_ns) { paused_ns_ = steady_ns; }
  void resume(TimeNs steady_ns) {
    if (begun_ns_) *begun_ns_ += steady_ns - paused_ns_;
  }
  /// The next frame is asked for: what was begun has ended, its publishing included.
  void end(TimeNs steady_ns);

  /// Why the foremost frame, which is ready since `ready_ns`, is passed through; empty when it is processed.
  /// @param ready_behind     frames behind it that are ready, too
  /// @param frame_period_ns  of the camera, > 0; absent while it is not known
  std::string pass_through_text(TimeNs now_ns, TimeNs ready_ns, std::size_t ready_behind,
                                std::optional<TimeNs> frame_period_ns) const;

  /// Whether the foremost frame has waited for so long that it should take as little time as it can, so that none has
  /// to be passed through. Arguments as above.
  static bool is_behind_camera_rate(TimeNs now_ns, TimeNs ready_ns, std::size_t ready_behind,
                                    std::optional<TimeNs> frame_period_ns);

 private:
  TimeNs usual_ns() const;  // precondition: some are kept

  std::optional<TimeNs> begun_ns_;
  TimeNs paused_ns_ = 0;
  bool behind_camera_rate_ = false;  // of the frame that has begun
  std::deque<TimeNs> durations_ns_;  // of the last frames that count
};

}  // namespace gyro_deblur
