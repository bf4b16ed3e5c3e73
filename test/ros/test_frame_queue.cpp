#include "ros/frame_queue.hpp"

#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::frame_queue_test {
namespace {

PendingFrame frame(TimeNs stamp_ns) {
  PendingFrame frame;
  frame.stamp_ns = stamp_ns;
  return frame;
}

TEST(FrameQueue, FirstInFirstOut) {
  FrameQueue queue(3);
  for (const TimeNs stamp_ns : {5, 3, 9}) queue.push(frame(stamp_ns));
  for (const TimeNs stamp_ns : {5, 3, 9}) {
    const PendingFrame out = queue.pop();
    EXPECT_EQ(out.stamp_ns, stamp_ns);
    EXPECT_EQ(out.pass_through_reason, PassThroughReason::NONE);
  }
  EXPECT_TRUE(queue.empty());
}

TEST(FrameQueue, OldestBeyondTheCapacityAreSettledAndStillLeave) {
  FrameQueue queue(2);
  for (TimeNs stamp_ns = 1; stamp_ns <= 4; ++stamp_ns) queue.push(frame(stamp_ns));
  ASSERT_EQ(queue.size(), 4u);
  for (TimeNs stamp_ns = 1; stamp_ns <= 4; ++stamp_ns) {
    const PendingFrame out = queue.pop();
    EXPECT_EQ(out.stamp_ns, stamp_ns);
    EXPECT_EQ(out.pass_through_reason, stamp_ns <= 2 ? PassThroughReason::OVERLOAD : PassThroughReason::NONE);
    EXPECT_EQ(out.pass_through_text.find("frame_queue_size = 2") != std::string::npos, stamp_ns <= 2);
  }
}

TEST(FrameQueue, PassingThroughKeepsEarlierReasons) {
  FrameQueue queue(2);
  PendingFrame bad = frame(1);
  bad.pass_through(PassThroughReason::BAD_IMAGE, "empty");
  queue.push(bad);
  queue.push(frame(2));
  queue.pass_through_old(ShownBy::ITSELF, PassThroughReason::TIME_JUMP, "back");
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::BAD_IMAGE);
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::TIME_JUMP);
}

TEST(FrameQueue, FramePutBackIsTheForemostAgain) {
  FrameQueue queue(2);
  queue.push(frame(1));
  queue.push(frame(2));
  queue.put_back(queue.pop());
  EXPECT_EQ(queue.pop().stamp_ns, 1);
  EXPECT_EQ(queue.pop().stamp_ns, 2);
}

TEST(FrameQueue, FrameThatIsInWorkIsNotPassedThrough) {
  FrameQueue queue(1);
  queue.push(frame(1));
  PendingFrame begun = queue.pop();
  begun.in_work = std::shared_ptr<FrameInWork>(std::shared_ptr<void>(), reinterpret_cast<FrameInWork*>(&begun));
  queue.put_back(begun);
  queue.push(frame(2));
  EXPECT_EQ(queue.front().pass_through_reason, PassThroughReason::NONE);
  queue.push(frame(3));
  queue.pass_through_old(ShownBy::ITSELF, PassThroughReason::TIME_JUMP, "back");
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::NONE);
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::OVERLOAD);
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::TIME_JUMP);
}

TEST(FrameQueue, PassedThroughFramesNeedNoMemory) {
  FrameQueue queue(1);
  PendingFrame bad = frame(1);
  bad.pass_through(PassThroughReason::BAD_IMAGE, "empty");
  queue.push(bad);
  queue.push(frame(2));
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::BAD_IMAGE);
  EXPECT_EQ(queue.pop().pass_through_reason, PassThroughReason::NONE);
}

}  // namespace
}  // namespace gyro_deblur::frame_queue_test
