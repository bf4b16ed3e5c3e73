// Reports a camera that sends pictures again.
#pragma once

#include <cstddef>
#include <deque>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"
#include "ros/frame_queue.hpp"
#include "sync/gyro_source.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// A picture that repeats while the camera is at rest may be a new one without noise (a simulated or compressed image).
/// While the gyroscope rotates it cannot. Not thread-safe.
class RepetitionWatch {
 public:
  /// @param problems  has to outlive this
  explicit RepetitionWatch(InputProblems* problems) : problems_(*problems) {}

  /// An image is published with all that belongs to it.
  /// @param gyro  that is mounted on the camera, with `options`
  /// @param repeated, images  counts since the start
  void add(const PendingFrame& frame, const GyroReader& gyro, const GyroOptions& options, std::size_t repeated,
           std::size_t images);
  void clear() { proven_ns_.clear(); }

 private:
  InputProblems& problems_;
  std::deque<TimeNs> proven_ns_;  // stamps of images that cannot show what their picture does
};

}  // namespace gyro_deblur
