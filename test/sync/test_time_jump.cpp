#include "sync/time_jump.hpp"

#include <gtest/gtest.h>

namespace gyro_deblur::time_jump_test {
namespace {

using Result = TimeJumpDetector::Result;
constexpr TimeNs kThreshold = 500;

TEST(TimeJumpDetector, SmallStepsBackAreNotAReset) {
  TimeJumpDetector detector(kThreshold);
  EXPECT_EQ(detector.update(Stream::IMU, 10'000), Result::FORWARD);
  EXPECT_EQ(detector.update(Stream::IMU, 9'500), Result::FORWARD);
  EXPECT_EQ(detector.newest_ns(Stream::IMU), 10'000);
  EXPECT_EQ(detector.update(Stream::IMU, 9'499), Result::JUMP);
  EXPECT_EQ(detector.newest_ns(Stream::IMU), 9'499);
}

TEST(TimeJumpDetector, OtherStreamsFollowWithoutTellingAgain) {
  TimeJumpDetector detector(kThreshold);
  detector.update(Stream::IMU, 10'000);
  detector.update(Stream::IMAGE, 10'000);
  EXPECT_EQ(detector.update(Stream::IMU, 0), Result::JUMP);
  EXPECT_TRUE(detector.is_stale(Stream::IMAGE));
  EXPECT_EQ(detector.update(Stream::IMAGE, 10'100), Result::FORWARD) << "still on its way from before";
  EXPECT_EQ(detector.update(Stream::IMAGE, 0), Result::FOLLOWS);
  EXPECT_FALSE(detector.is_stale(Stream::IMAGE));
  EXPECT_EQ(detector.update(Stream::IMAGE, 10'000), Result::FORWARD);
  EXPECT_EQ(detector.update(Stream::IMAGE, 10'030), Result::FORWARD);
  EXPECT_EQ(detector.update(Stream::IMAGE, 0), Result::JUMP) << "the second reset is news again";
}

TEST(TimeJumpDetector, LateCameraInfoAndExposureAreNoReset) {
  TimeJumpDetector detector(kThreshold);
  for (const Stream stream : {Stream::CAMERA_INFO, Stream::EXPOSURE}) {
    detector.update(stream, 10'000);
    EXPECT_EQ(detector.update(stream, 0), Result::FORWARD);
    EXPECT_EQ(detector.update(stream, 10'030), Result::FORWARD);
  }
}

TEST(TimeJumpDetector, StreamThatStartsLaterIsNotExpectedToFollow) {
  TimeJumpDetector detector(kThreshold);
  detector.update(Stream::IMU, 10'000);
  EXPECT_EQ(detector.update(Stream::IMU, 0), Result::JUMP);
  EXPECT_FALSE(detector.is_stale(Stream::IMAGE));
}

TEST(TimeJumpDetector, StreamThatGoesOnIsNotExpectedToFollowForever) {
  TimeJumpDetector detector(kThreshold);
  detector.update(Stream::IMAGE, 10'000);
  detector.update(Stream::IMU, 10'000);
  EXPECT_EQ(detector.update(Stream::IMU, 0), Result::JUMP);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(detector.update(Stream::IMAGE, 10'000 + i), Result::FORWARD);
  EXPECT_FALSE(detector.is_stale(Stream::IMAGE));
  EXPECT_EQ(detector.update(Stream::IMAGE, 0), Result::JUMP);
}

TEST(TimeJumpDetector, OwnerCanReportAReset) {
  TimeJumpDetector detector(kThreshold);
  detector.update(Stream::IMU, 400);
  EXPECT_EQ(detector.went_back(Stream::IMU, 100), Result::JUMP);
  EXPECT_EQ(detector.newest_ns(Stream::IMU), 100);
}

TEST(TimeJumpDetector, OneStampFarAheadIsNotBelieved) {
  TimeJumpDetector detector(kThreshold);
  detector.update(Stream::IMAGE, 10'000);
  EXPECT_EQ(detector.update(Stream::IMAGE, 90'000), Result::FORWARD);
  EXPECT_EQ(detector.update(Stream::IMAGE, 10'030), Result::FORWARD) << "the stamp before was wrong, nothing was reset";
  EXPECT_EQ(detector.newest_ns(Stream::IMAGE), 10'030);
  EXPECT_EQ(detector.update(Stream::IMAGE, 9'000), Result::JUMP);
}

TEST(TimeJumpDetector, StreamThatWentAheadCanGoBack) {
  TimeJumpDetector detector(kThreshold);
  detector.update(Stream::IMAGE, 10'000);
  EXPECT_EQ(detector.update(Stream::IMAGE, 90'000), Result::FORWARD);
  EXPECT_EQ(detector.update(Stream::IMAGE, 90'030), Result::FORWARD);
  EXPECT_EQ(detector.newest_ns(Stream::IMAGE), 90'030);
  EXPECT_EQ(detector.update(Stream::IMAGE, 10'000), Result::JUMP);
}

TEST(TimeJumpDetector, SlowStreamIsFollowed) {
  TimeJumpDetector detector(kThreshold);
  for (TimeNs t_ns = 0; t_ns <= 100'000; t_ns += 10'000) {
    EXPECT_EQ(detector.update(Stream::IMAGE, t_ns), Result::FORWARD);
  }
  EXPECT_EQ(detector.update(Stream::IMAGE, 0), Result::JUMP);
}

TEST(EpochCounter, StepBackThatWasMadeUpForIsForgotten) {
  EpochCounter counter;
  EXPECT_EQ(counter.next(100), 0);
  EXPECT_EQ(counter.next(200), 0);
  EXPECT_EQ(counter.next(150), 1) << "out of order";
  EXPECT_EQ(counter.next(300), 1);
  EXPECT_EQ(counter.reset(ShownBy::OTHER), 2) << "nothing that has come is of the new epoch";
}

TEST(EpochCounter, ResetKeepsWhatCameAfterAStepBack) {
  EpochCounter counter;
  EXPECT_EQ(counter.next(100), 0);
  EXPECT_EQ(counter.next(200), 0);
  EXPECT_EQ(counter.next(100), 1);
  EXPECT_EQ(counter.reset(ShownBy::OTHER), 1);
  EXPECT_EQ(counter.next(200), 1);
  EXPECT_EQ(counter.next(50), 2);
  EXPECT_EQ(counter.reset(ShownBy::OTHER), 2);
}

TEST(EpochCounter, ResetWithoutAStepBackKeepsNothing) {
  EpochCounter counter;
  EXPECT_EQ(counter.next(100), 0);
  EXPECT_EQ(counter.reset(ShownBy::OTHER), 1);
  EXPECT_EQ(counter.next(50), 1) << "the step belongs to that reset";
  EXPECT_EQ(counter.reset(ShownBy::OTHER), 2) << "and does not speak for the next one";
}

TEST(EpochCounter, OwnMessageBeginsTheNewEpoch) {
  EpochCounter counter;
  EXPECT_EQ(counter.next(100), 0);
  EXPECT_EQ(counter.next(90), 1);
  EXPECT_EQ(counter.reset(ShownBy::ITSELF), 2);
  EXPECT_EQ(counter.next(0), 2);
}

}  // namespace
}  // namespace gyro_deblur::time_jump_test
