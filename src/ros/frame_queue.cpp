#include "ros/frame_queue.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "ros/value_conversion.hpp"

namespace gyro_deblur {

std::size_t FrameQueue::unsettled() const {
  return static_cast<std::size_t>(std::count_if(frames_.begin(), frames_.end(), [](const PendingFrame& frame) {
    return frame.verdict == PassThroughReason::NONE;
  }));
}

std::size_t FrameQueue::push(PendingFrame frame) {
  frame.epoch = is_unset(frame.stamp_ns) ? epochs_.current() : epochs_.next(frame.stamp_ns);
  frames_.push_back(std::move(frame));
  std::size_t settled = 0;
  std::size_t waiting = unsettled();
  for (PendingFrame& old : frames_) {
    if (waiting <= capacity_) break;
    if (old.verdict != PassThroughReason::NONE) continue;
    old.settle(PassThroughReason::OVERLOAD,
               "more than frame_queue_size = " + std::to_string(capacity_) + " frames were waiting");
    --waiting;
    ++settled;
  }
  return settled;
}

void FrameQueue::settle_before(int epoch, PassThroughReason reason, const std::string& text) {
  for (PendingFrame& frame : frames_) {
    if (frame.epoch < epoch && frame.verdict == PassThroughReason::NONE) frame.settle(reason, text);
  }
}

void FrameQueue::settle_all(PassThroughReason reason, const std::string& text) {
  settle_before(epochs_.begin(), reason, text);
}

void FrameQueue::settle_old_epoch(PassThroughReason reason, const std::string& text) {
  settle_before(epochs_.reset(), reason, text);
}

std::size_t FrameQueue::ready_behind_front() const {
  if (frames_.empty()) return 0;
  return static_cast<std::size_t>(std::count_if(
      std::next(frames_.begin()), frames_.end(),
      [](const PendingFrame& frame) { return frame.ready_steady_ns && frame.verdict == PassThroughReason::NONE; }));
}

PendingFrame FrameQueue::pop() {
  PendingFrame frame = std::move(frames_.front());
  frames_.pop_front();
  return frame;
}

}  // namespace gyro_deblur
