// Whether a frame has what belongs to it.
#pragma once

#include <string>

#include "ros/frame_queue.hpp"

namespace gyro_deblur {

/// What a frame can do.
enum class Readiness {
  WAITS,         ///< for messages that may still come
  PASS_THROUGH,  ///< it is published unchanged, PendingFrame::pass_through_reason says why
  READY,         ///< it has what belongs to it
};

inline Readiness wait_for(Awaited awaited, PendingFrame* frame) {
  frame->awaits = awaited;
  return Readiness::WAITS;
}

inline Readiness pass_through(PendingFrame* frame, PassThroughReason reason, const std::string& text) {
  frame->pass_through(reason, text);
  return Readiness::PASS_THROUGH;
}

}  // namespace gyro_deblur
