// Keeps frames in the order of their arrival.
#include "ros/frame_queue.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "ros/value_conversion.hpp"

namespace gyro_deblur {

void FrameQueue::push(PendingFrame frame) {
  frame.epoch = is_unset(frame.stamp_ns) ? epochs_.current() : epochs_.next(frame.stamp_ns);
  frames_.push_back(std::move(frame));
  auto waiting = static_cast<std::size_t>(
      std::count_if(frames_.begin(), frames_.end(), [](const PendingFrame& each) { return each.is_undecided(); }));
  for (auto old = frames_.begin(); waiting > capacity_; ++old) {
    if (!old->is_undecided()) continue;
    old->pass_through(PassThroughReason::OVERLOAD,
                      "more than frame_queue_size = " + std::to_string(capacity_) + " frames were waiting");
    --waiting;
  }
}

void FrameQueue::pass_through_old(ShownBy shown_by, PassThroughReason reason, const std::string& text) {
  const int epoch = epochs_.reset(shown_by);
  for (PendingFrame& frame : frames_) {
    if (frame.epoch < epoch && frame.is_undecided()) frame.pass_through(reason, text);
  }
}

std::size_t FrameQueue::ready_behind_front() const {
  if (frames_.empty()) return 0;
  return static_cast<std::size_t>(
      std::count_if(std::next(frames_.begin()), frames_.end(), [](const PendingFrame& frame) {
        return frame.ready_steady_ns && frame.pass_through_reason == PassThroughReason::NONE;
      }));
}

PendingFrame FrameQueue::pop() {
  PendingFrame frame = std::move(frames_.front());
  frames_.pop_front();
  return frame;
}

}  // namespace gyro_deblur
