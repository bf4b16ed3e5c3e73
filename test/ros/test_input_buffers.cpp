#include "ros/input_buffers.hpp"

#include <functional>
#include <limits>

#include <gtest/gtest.h>

#include "gyro_deblur/frame_blur.hpp"
#include "processor_test.hpp"

namespace gyro_deblur::input_buffers_test {
namespace {

using namespace test;

class InputBuffersTest : public ProcessorTest {};

TEST_F(InputBuffersTest, SimulatedTimeThatStopsDoesNotKeepFrames) {
  add_frame(kStart);
  steady_ns_ = 10 * config_.input_timeout_ns - 1;
  advance();
  EXPECT_TRUE(outputs_.empty());
  steady_ns_ += 1;
  advance();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "");
}

TEST_F(InputBuffersTest, WaitingStartsWithTheFirstSimulatedTime) {
  now_ns_ = 0;
  add_frame(kStart);
  advance();
  now_ns_ = kStart;
  advance();
  EXPECT_TRUE(outputs_.empty()) << "the clock started, no time passed";
  time_out();
  EXPECT_EQ(outputs_.size(), 1u);
}

TEST_F(InputBuffersTest, FullQueuePassesTheOldestThroughAndLosesNothing) {
  constexpr TimeNs kPeriod = 33 * kMs;
  config_.frame_queue_size = 3;
  configure();
  for (int i = 0; i < 5; ++i) add_frame(kStart + i * kPeriod);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::OVERLOAD, "frame_queue_size = 3");
  expect_passed_through(1, PassThroughReason::OVERLOAD, "frame_queue_size = 3");
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(to_time_ns(outputs_[i].input->header.stamp), kStart + static_cast<TimeNs>(i) * kPeriod);
  }
  expect_deblurred(4);
  EXPECT_EQ(processor_.statistics().passed_through.at(PassThroughReason::OVERLOAD), 2u);
}

TEST_F(InputBuffersTest, UnusableImagesPassAtOnceInOrder) {
  constexpr TimeNs kPeriod = 33 * kMs;
  add_imu(kStart - 50 * kMs, kStart + 10 * kMs);
  add_frame(kStart);
  auto empty = boost::make_shared<sensor_msgs::Image>();
  empty->header.stamp = to_ros_time(kStart + kPeriod);
  empty->encoding = "mono8";
  processor_.add_image(empty);
  auto floats = image_message(kStart + 2 * kPeriod);
  floats->encoding = "32FC1";
  processor_.add_image(floats);
  auto cut = image_message(kStart + 3 * kPeriod);
  cut->data.resize(10);
  processor_.add_image(cut);
  advance();
  EXPECT_TRUE(outputs_.empty()) << "the first frame waits, and the others behind it";
  add_imu(kStart + 15 * kMs, kStart + 100 * kMs);
  advance();
  expect_deblurred(0);
  expect_passed_through(1, PassThroughReason::BAD_IMAGE, "0x0");
  expect_passed_through(2, PassThroughReason::UNSUPPORTED_ENCODING, "32FC1");
  expect_passed_through(3, PassThroughReason::BAD_IMAGE, "10 bytes");
  EXPECT_EQ(outputs_[3].image, cut);
}

TEST_F(InputBuffersTest, ImuSamplesThatCannotBeUsedAreCountedAndDropped) {
  add_imu(kStart - 50 * kMs, kStart + 20 * kMs);
  for (int i = 0; i < 3; ++i) {
    processor_.add_imu(imu_message(kStart + 21 * kMs, std::numeric_limits<double>::quiet_NaN()));
    processor_.add_imu(imu_message(kStart + 21 * kMs, std::numeric_limits<double>::infinity()));
  }
  for (int i = 0; i < 4; ++i) processor_.add_imu(imu_message(kStart + 20 * kMs, 100));
  for (int i = 0; i < 5; ++i) processor_.add_imu(imu_message(kStart + 10 * kMs, 100));
  sensor_msgs::Imu without = imu_message(kStart + 22 * kMs, 100);
  without.angular_velocity_covariance[0] = -1;
  processor_.add_imu(without);
  add_imu(kStart + 25 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  const FrameBlur& field = *outputs_[0].field;
  EXPECT_NEAR(field.blocks[static_cast<std::size_t>(field.grid.index_at(kWidth / 2, kHeight / 2))].extent_px,
              kFocalPx * kFastRadS * to_seconds(kExposure), 0.25);
  const ProcessorStatistics statistics = processor_.statistics();
  EXPECT_EQ(statistics.imu_not_finite, 6u);
  EXPECT_EQ(statistics.imu_duplicate, 4u);
  EXPECT_EQ(statistics.imu_out_of_order, 5u);
  EXPECT_EQ(statistics.imu_without_gyroscope, 1u);
  EXPECT_EQ(statistics.time_jumps, 0u);
  EXPECT_EQ(log_.size(), 4u) << "one line of each kind";
}

TEST_F(InputBuffersTest, StrayImuStampsAreDroppedAndChangeNothing) {
  add_imu(kStart - 50 * kMs, kStart + 20 * kMs);
  for (const TimeNs stray_ns : {kStart + 1000 * kSecond, kStart + kSecond, kStart - 50 * kSecond, TimeNs{0}}) {
    processor_.add_imu(imu_message(stray_ns, 100));
  }
  add_imu(kStart + 25 * kMs, kStart + 30 * kMs);
  processor_.add_imu(imu_message(kStart + 100 * kMs, 100));  // further than max_gyro_gap, nearer than a time jump
  add_imu(kStart + 35 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  const FrameBlur& field = *outputs_[0].field;
  EXPECT_NEAR(field.blocks[static_cast<std::size_t>(field.grid.index_at(kWidth / 2, kHeight / 2))].extent_px,
              kFocalPx * kFastRadS * to_seconds(kExposure), 0.25);
  EXPECT_EQ(processor_.statistics().imu_stray, 5u);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u);
  EXPECT_EQ(logged("far from those of the samples around it"), 1u) << "throttled";
}

TEST_F(InputBuffersTest, AStampAheadOfAFastImuIsDroppedAndChangesNothing) {
  constexpr TimeNs kFastPeriod = 2'500'000;
  for (TimeNs t_ns = kStart - 2 * kSecond; t_ns <= kStart + 100 * kMs; t_ns += kFastPeriod) {
    const bool wrong = t_ns == kStart - 100 * kMs;
    processor_.add_imu(imu_message(t_ns + (wrong ? 40 * kMs : 0), wrong ? 100 : kFastRadS));
  }
  EXPECT_EQ(processor_.statistics().time_jumps, 0u);
  EXPECT_EQ(processor_.statistics().imu_stray, 1u);
  EXPECT_EQ(processor_.statistics().imu_out_of_order, 0u);
  add_frame(kStart - kSecond);  // by samples from before it
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  expect_deblurred(1);
}

TEST_F(InputBuffersTest, ImuThatWasSilentIsTakenAgain) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  add_frame(kStart + 5 * kSecond);
  add_imu(kStart + 5 * kSecond - 10 * kMs, kStart + 5 * kSecond + 100 * kMs);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u);
  EXPECT_EQ(processor_.statistics().imu_stray, 0u);
}

TEST_F(InputBuffersTest, StrayImageStampIsNoJump) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  add_frame(kStart + 1000 * kSecond);
  add_frame(kStart + 33 * kMs);
  advance();
  time_out();
  ASSERT_EQ(outputs_.size(), 3u);
  expect_deblurred(0);
  expect_passed_through(1, PassThroughReason::NO_GYRO, "");
  expect_deblurred(2);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u);
}

TEST_F(InputBuffersTest, ImageWithoutAStampPassesInOrderAndChangesNothing) {
  constexpr int kFrames = 40;
  constexpr TimeNs kPeriod = 50 * kMs;
  config_.pipeline.optical_flow = true;
  configure();
  request_.tracks = request_.global_shutter = true;
  // With every tenth image's stamp missing, then with these images left out.
  std::vector<FrameOutput> with, without;
  std::vector<TimeNs> frame_periods_ns;
  for (std::vector<FrameOutput>* result : {&with, &without}) {
    now_ns_ = kStart;
    Processor fresh(environment());
    fresh.set_config(config_);
    outputs_.clear();
    TimeNs imu_ns = kStart - 50 * kMs;
    for (int i = 0; i < kFrames; ++i) {
      now_ns_ = kStart + i * kPeriod;
      for (; imu_ns <= now_ns_; imu_ns += kImuPeriod) fresh.add_imu(imu_message(imu_ns, kFastRadS));
      const bool unset = i % 10 == 4;
      if (!unset || result == &with) {
        fresh.add_image(image_message(unset ? 0 : now_ns_));
        fresh.add_camera_info(camera_info(unset ? 0 : now_ns_));
      }
      fresh.advance([this](FrameOutput&& output) {
        outputs_.push_back(std::move(output));
        return true;
      });
    }
    fresh.finish([this](FrameOutput&& output) {
      outputs_.push_back(std::move(output));
      return true;
    });
    *result = std::move(outputs_);
    const ProcessorStatistics statistics = fresh.statistics();
    EXPECT_EQ(statistics.time_jumps, 0u);
    ASSERT_TRUE(statistics.frame_period_ns);
    frame_periods_ns.push_back(*statistics.frame_period_ns);
  }
  EXPECT_EQ(frame_periods_ns.at(0), frame_periods_ns.at(1));
  ASSERT_EQ(with.size(), static_cast<std::size_t>(kFrames));
  outputs_ = std::move(with);
  std::size_t other = 0;
  for (std::size_t i = 0; i < kFrames; ++i) {
    if (i % 10 == 4) {
      expect_passed_through(i, PassThroughReason::NO_STAMP, "stamp is 0");
      EXPECT_EQ(outputs_[i].camera_info->K[0], kFocalPx) << "as those before";
      EXPECT_EQ(outputs_[i].global_shutter, outputs_[i].input);
      continue;
    }
    const FrameOutput& expected = without.at(other++);
    EXPECT_EQ(outputs_[i].reason, expected.reason) << i << ": " << outputs_[i].reason_text;
    EXPECT_EQ(outputs_[i].image->data, expected.image->data) << i;
    EXPECT_EQ(*outputs_[i].camera_info, *expected.camera_info) << i;
    EXPECT_EQ(outputs_[i].global_shutter->data, expected.global_shutter->data) << i;
    ASSERT_NE(outputs_[i].tracks, nullptr);
    EXPECT_EQ(outputs_[i].tracks->channels[0].values, expected.tracks->channels[0].values) << i;
  }
}

TEST_F(InputBuffersTest, MessagesWithoutAStampAreNoResetOfTime) {
  add_imu(kStart - 50 * kMs, kStart + 20 * kMs);
  for (int i = 0; i < 3; ++i) {
    processor_.add_imu(imu_message(0, 100));
    processor_.add_image(image_message(0));
    processor_.add_camera_info(camera_info(0));
    processor_.add_exposure(Exposure());
  }
  add_frame(kStart);
  add_imu(kStart + 25 * kMs, kStart + 100 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 4u);
  expect_deblurred(3);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u);
}

TEST_F(InputBuffersTest, AJumpBehindAnImageWithoutAStampStillShows) {
  add_imu(kStart + 900 * kMs, kStart + kSecond);
  add_frame(kStart + 970 * kMs);  // lacks samples
  processor_.add_image(image_message(0));
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart + 33 * kMs);
  advance();
  EXPECT_EQ(processor_.statistics().time_jumps, 1u);
  ASSERT_EQ(outputs_.size(), 3u);
  expect_passed_through(0, PassThroughReason::TIME_JUMP, "backwards");
  expect_passed_through(1, PassThroughReason::NO_STAMP, "stamp is 0");
  expect_deblurred(2);
}

TEST_F(InputBuffersTest, OldImageOutOfOrderDoesNotHideALaterJump) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart + 10 * kMs);
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  add_imu(kStart + 105 * kMs, kStart + kSecond);
  add_frame(kStart + kSecond);  // waits for samples that never come
  add_imu(kStart, kStart + 100 * kMs);
  advance();
  EXPECT_EQ(processor_.statistics().time_jumps, 1u);
  expect_passed_through(2, PassThroughReason::TIME_JUMP, "backwards");
}

/// One pass of a bag: IMU from 0 to length, a frame every 100 ms, interleaved by time.
void play(Processor* processor, TimeNs begin_ns, TimeNs length_ns, const std::function<void()>& after_each) {
  for (TimeNs t_ns = begin_ns; t_ns <= begin_ns + length_ns; t_ns += kImuPeriod) {
    if ((t_ns - begin_ns) % (100 * kMs) == 0) {
      processor->add_camera_info(camera_info(t_ns));
      processor->add_image(image_message(t_ns));
    }
    processor->add_imu(imu_message(t_ns, kFastRadS));
    after_each();
  }
}

TEST_F(InputBuffersTest, LoopingBagResetsWithOneMessageALoop) {
  for (int loop = 0; loop < 3; ++loop) {
    play(&processor_, kStart, kSecond, [this] { advance(); });
  }
  EXPECT_EQ(processor_.statistics().time_jumps, 2u);
  EXPECT_EQ(logged("time went backwards"), 2u);
  EXPECT_EQ(log_.size(), 2u) << log_.back();
  // Eleven frames a loop; the last of a loop waits for samples that never come.
  ASSERT_EQ(outputs_.size() + processor_.waiting(), 33u);
  for (std::size_t i = 0; i < outputs_.size(); ++i) {
    const bool last_of_loop = i % 11 == 10;
    EXPECT_STREQ(to_string(outputs_[i].reason), last_of_loop ? "TIME_JUMP" : "NONE") << i;
  }
}

TEST_F(InputBuffersTest, LoopWithSimulatedTimeIsOneJumpToo) {
  for (int loop = 0; loop < 3; ++loop) {
    now_ns_ = kStart;
    play(&processor_, kStart, kSecond, [this] {
      now_ns_ += kImuPeriod;
      advance();
    });
  }
  EXPECT_EQ(processor_.statistics().time_jumps, 2u);
  EXPECT_EQ(logged("time went backwards"), 2u);
  EXPECT_EQ(outputs_.size() + processor_.waiting(), 33u);
}

TEST_F(InputBuffersTest, BagShorterThanTheThresholdLoopsToo) {
  for (int loop = 0; loop < 3; ++loop) {
    play(&processor_, kStart, 300 * kMs, [this] { advance(); });
  }
  time_out();
  EXPECT_EQ(processor_.statistics().time_jumps, 2u);
  EXPECT_EQ(logged("time went backwards"), 2u);
  ASSERT_EQ(outputs_.size(), 12u);
  std::size_t processed = 0;
  for (const FrameOutput& output : outputs_) processed += output.reason == PassThroughReason::NONE;
  // Of four frames a loop the last lacks samples; the first of a loop comes before the reset is sure, and stays.
  EXPECT_EQ(processed, 9u);
}

TEST_F(InputBuffersTest, StragglersOfTheOldEpochDoNotDisturb) {
  add_imu(kStart + 900 * kMs, kStart + kSecond);
  add_frame(kStart + 900 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  add_imu(kStart, kStart + 20 * kMs);  // the IMU is back first
  add_frame(kStart + 990 * kMs);       // an old image is late
  EXPECT_EQ(processor_.statistics().time_jumps, 1u);
  add_frame(kStart + 5 * kMs);  // then the camera is back too
  add_imu(kStart + 25 * kMs, kStart + 100 * kMs);
  advance();
  EXPECT_EQ(processor_.statistics().time_jumps, 1u);
  ASSERT_EQ(outputs_.size(), 3u);
  expect_passed_through(1, PassThroughReason::TIME_JUMP, "backwards");
  expect_deblurred(2);
}

TEST_F(InputBuffersTest, LateSamplesOfTheOldEpochDoNotStandForTheNewOne) {
  add_imu(kStart + 900 * kMs, kStart + kSecond);
  add_frame(kStart + 900 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  add_frame(kStart);                                            // the camera is back first
  add_imu(kStart + kSecond + kImuPeriod, kStart + 1050 * kMs);  // old samples are late
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(processor_.statistics().time_jumps, 1u);
}

TEST_F(InputBuffersTest, ClockAloneGoingBackIsAJump) {
  add_frame(kStart);
  now_ns_ -= 10 * kSecond;
  advance();
  expect_passed_through(0, PassThroughReason::TIME_JUMP, "");
  EXPECT_EQ(logged("clock"), 1u);
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(processor_.statistics().time_jumps, 1u);
}

// A sensor at 20 Hz whose driver publishes at 40 Hz, one image in five repeated, and a message that comes twice.
TEST_F(InputBuffersTest, FramePeriodCountsNewPicturesOnly) {
  constexpr int kPictures = 40;
  constexpr TimeNs kPeriod = 50 * kMs;
  const auto period_with = [&](const std::function<void(int, const sensor_msgs::Image&)>& after_picture) {
    processor_.reset();
    for (int i = 0; i < kPictures; ++i) after_picture(i, *add_frame(kStart + i * kPeriod));
    return processor_.statistics().frame_period_ns;
  };
  EXPECT_EQ(period_with([](int, const sensor_msgs::Image&) {}), kPeriod);
  EXPECT_EQ(processor_.statistics().repeated_pictures, 0u);
  EXPECT_EQ(period_with([this](int i, const sensor_msgs::Image& image) {
              add_repetition(image, kStart + i * kPeriod + kPeriod / 2);
            }),
            kPeriod);
  EXPECT_EQ(processor_.statistics().repeated_pictures, std::size_t{kPictures});
  EXPECT_EQ(period_with([this](int i, const sensor_msgs::Image& image) {
              if (i % 5 == 4) add_repetition(image, kStart + i * kPeriod + kPeriod / 2);
            }),
            kPeriod);
  EXPECT_EQ(
      period_with([this](int i, const sensor_msgs::Image& image) { add_repetition(image, kStart + i * kPeriod); }),
      kPeriod);
}

}  // namespace
}  // namespace gyro_deblur::input_buffers_test
