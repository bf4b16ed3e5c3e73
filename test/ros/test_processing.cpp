#include "ros/processing.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <initializer_list>
#include <string>
#include <utility>

#include <gtest/gtest.h>
#include <sensor_msgs/image_encodings.h>

#include "axial_difference.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "processor_test.hpp"

namespace gyro_deblur::processing_test {
namespace {

using namespace test;

class ProcessingTest : public ProcessorTest {};

class RefusedFrameTest : public ProcessorTest {
 protected:
  RefusedFrameTest() : ProcessorTest(true) {}
};

TEST_F(RefusedFrameTest, LeavesAsItCameAndIsStillTracked) {
  request_.tracks = true;
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance_refused(kStart);
  expect_passed_through(0, PassThroughReason::STEREO_PARTNER, "/cam1 passes this image through: NO_CALIBRATION");
  EXPECT_EQ(outputs_[0].quality->rejected, 1) << "every block could have been deblurred";
  ASSERT_NE(outputs_[0].tracks, nullptr);
  EXPECT_FALSE(outputs_[0].keypoints->keypoints.empty());
  for (const Keypoint& keypoint : outputs_[0].keypoints->keypoints) {
    EXPECT_FALSE(keypoint.deblurred || keypoint.rectified);
  }
  add_imu(kStart + 105 * kMs, kStart + 200 * kMs);
  add_frame(kStart + 100 * kMs);
  advance();
  expect_deblurred(1);
}

/// A frame that can be deblurred, next to a stereo partner that is not decided on yet.
class WaitingFrameTest : public ProcessorTest {
 protected:
  WaitingFrameTest() : ProcessorTest(true) { partner_.set_timeout(kSecond); }
  void add_pairs(TimeNs timeout_ns, std::initializer_list<TimeNs> stamps) {
    config_.stereo_sync_timeout_ns = timeout_ns;
    configure();
    add_imu(kStart - 50 * kMs, kStart + 300 * kMs);
    for (const TimeNs stamp_ns : stamps) {
      partner_.announce(stamp_ns);
      add_frame(stamp_ns);
    }
  }
  StereoCamera partner_{rig_, "/cam1"};
};

TEST_F(WaitingFrameTest, WaitsInTheQueueAndIsDeblurredOnceItsPartnerIsDecidedOn) {
  const TimeNs second_ns = kStart + 100 * kMs;
  add_pairs(10 * kSecond, {kStart, second_ns});
  for (int asked = 0; asked < 3; ++asked) {
    advance();
    EXPECT_TRUE(outputs_.empty());
    EXPECT_EQ(processor_.waiting(), 2u);
    EXPECT_EQ(processor_.awaited(), Awaited::STEREO_PARTNER);
    steady_ns_ += 15 * kMs;
  }
  FrameBlur sharp;
  sharp.blocks.emplace_back();
  sharp.blocks.back().status = BlockStatus::SHARP;
  ASSERT_TRUE(partner_.decide(kStart, sharp));
  EXPECT_TRUE(processor_.wait(std::chrono::hours(1))) << "it is woken";
  advance();
  ASSERT_EQ(outputs_.size(), 1u) << "the second waits for its own partner";
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].waiting_ms, 45);
  partner_.pass_through(second_ns, PassThroughReason::NO_CALIBRATION);
  advance();
  expect_passed_through(1, PassThroughReason::STEREO_PARTNER, "/cam1 passes this image through: NO_CALIBRATION");
  EXPECT_EQ(processor_.awaited(), Awaited::NOTHING);
}

TEST_F(WaitingFrameTest, ResetPassesOnlyThoseBehindItThrough) {
  const TimeNs second_ns = kStart + 100 * kMs;
  add_pairs(10 * kSecond, {kStart, second_ns});
  advance();
  processor_.reset();
  partner_.pass_through(kStart, PassThroughReason::OVERLOAD);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::STEREO_PARTNER, "/cam1 passes this image through: OVERLOAD");
  expect_passed_through(1, PassThroughReason::TIME_JUMP, "reset");
}

TEST_F(WaitingFrameTest, WaitsNoLongerThanItsTimeoutWhenEverythingFinishes) {
  add_pairs(kMs, {kStart});
  advance();
  processor_.stop();
  processor_.finish([this](FrameOutput&& output) {
    outputs_.push_back(std::move(output));
    return true;
  });
  expect_passed_through(0, PassThroughReason::STEREO_PARTNER, "/cam1 has not decided on its image of ");
}

/// Three frames 200 ms apart. Within the second the camera rotates, 24 px there and back, so that all show the same.
class DropPoorTest : public ProcessingTest {
 protected:
  void run() {
    config_.pipeline.blur_field.max_extent_px = 5;  // nothing is undone
    configure();
    request_.overlay = request_.markers = request_.tracks = request_.global_shutter = request_.trust_mask = true;
    for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= kStart + 500 * kMs; t_ns += kImuPeriod) {
      const TimeNs since_ns = t_ns - kSecondFrame;
      const bool rotates = since_ns > 0 && since_ns <= 50 * kMs;
      processor_.add_imu(imu_message(t_ns, !rotates ? 0 : since_ns <= 25 * kMs ? 5 : -5));
    }
    for (const TimeNs stamp_ns : {kStart, kSecondFrame, kStart + 400 * kMs}) add_frame(stamp_ns);
    advance();
    ASSERT_EQ(outputs_.size(), 3u);
    EXPECT_EQ(outputs_[1].quality->grade, ImageQuality::POOR) << outputs_[1].quality->score;
    for (const std::size_t i : {0u, 2u}) {
      EXPECT_EQ(outputs_[i].image, outputs_[i].input);
      EXPECT_EQ(outputs_[i].quality->grade, ImageQuality::SHARP);
    }
  }
  static constexpr TimeNs kSecondFrame = kStart + 200 * kMs;
};

TEST_F(DropPoorTest, PoorFrameIsNotPublishedButCounted) {
  config_.drop_poor = true;
  ASSERT_NO_FATAL_FAILURE(run());
  const FrameOutput& poor = outputs_[1];
  EXPECT_TRUE(poor.dropped && !outputs_[0].dropped && !outputs_[2].dropped);
  EXPECT_EQ(poor.image, nullptr);
  EXPECT_EQ(poor.camera_info, nullptr);
  EXPECT_EQ(poor.keypoints, nullptr);
  EXPECT_EQ(poor.tracks, nullptr);
  EXPECT_EQ(poor.global_shutter, nullptr);
  EXPECT_EQ(poor.global_shutter_info, nullptr);
  EXPECT_STREQ(to_string(poor.reason), "NONE");
  EXPECT_EQ(poor.blur_field->status, std::vector<std::uint8_t>(poor.field->blocks.size(), BlurField::TOO_LARGE));
  EXPECT_EQ(poor.blur_field->reason_text.rfind("drop_poor: POOR, with a score of 0.", 0), 0u) << poor.reason_text;
  EXPECT_EQ(poor.quality->header.stamp, poor.input->header.stamp);
  EXPECT_NE(poor.trust_mask, nullptr);
  EXPECT_NE(poor.overlay, nullptr);
  EXPECT_NE(poor.markers, nullptr);
  EXPECT_EQ(processor_.statistics().dropped_poor, 1u);
  EXPECT_EQ(processor_.statistics().frames_out, 2u);
  EXPECT_EQ(processor_.statistics().frames_in, 3u);
  EXPECT_TRUE(processor_.statistics().passed_through.empty());
  EXPECT_EQ(logged("is not published: drop_poor: POOR"), 1u);
  // Only corners that have been seen before have a point: the third frame's are those of the first.
  EXPECT_TRUE(outputs_[0].tracks->points.empty());
  ASSERT_NE(outputs_[2].tracks, nullptr);
  EXPECT_FALSE(outputs_[2].tracks->points.empty());
}

TEST_F(DropPoorTest, PoorFrameIsPublishedByDefault) {
  ASSERT_NO_FATAL_FAILURE(run());
  EXPECT_FALSE(outputs_[1].dropped);
  EXPECT_EQ(outputs_[1].image, outputs_[1].input);
  EXPECT_NE(outputs_[1].camera_info, nullptr);
  EXPECT_NE(outputs_[1].tracks, nullptr);
  EXPECT_EQ(processor_.statistics().dropped_poor, 0u);
  EXPECT_EQ(processor_.statistics().frames_out, 3u);
}

TEST_F(DropPoorTest, PoorFrameIsDroppedBeforeWorkIsLostOnIt) {
  config_.drop_poor = true;
  config_.pipeline.blur_field.max_extent_px = 500;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs, 22);
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_TRUE(outputs_[0].dropped) << outputs_[0].quality->score;
  EXPECT_EQ(outputs_[0].field->count(BlockStatus::DEBLURRED), outputs_[0].field->blocks.size());
  EXPECT_EQ(outputs_[0].times.deconvolution_ms, 0);
  EXPECT_EQ(outputs_[0].times.keypoints_ms, 0);
}

TEST_F(DropPoorTest, WhatIsNotKnownToBePoorIsPublished) {
  config_.drop_poor = true;
  configure();
  add_frame(kStart);  // without a gyroscope
  time_out();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "");
  add_imu(kStart + 150 * kMs, kStart + 300 * kMs);
  add_frame(kStart + 200 * kMs);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(processor_.statistics().dropped_poor, 0u);
}

TEST_F(ProcessingTest, SharpFrameLeavesAsTheVeryMessage) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs, 0.0);
  const auto image = add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].image, image);
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NONE);
  EXPECT_EQ(outputs_[0].field->count(BlockStatus::SHARP), outputs_[0].field->blocks.size());
  EXPECT_FALSE(outputs_[0].keypoints->keypoints.empty());
  EXPECT_TRUE(log_.empty());
}

TEST_F(ProcessingTest, ExtentIsThatOfTheRotation) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  const FrameBlur& field = *outputs_[0].field;
  const BlockBlur& center = field.blocks[static_cast<std::size_t>(field.grid.index_at(kWidth / 2, kHeight / 2))];
  // A rotation of w t about y moves the centre by about f w t along x.
  EXPECT_NEAR(center.extent_px, kFocalPx * kFastRadS * to_seconds(kExposure), 0.25);
  EXPECT_LT(axial_difference(center.angle_rad, 0), 0.02);
}

TEST_F(ProcessingTest, BufferThatLostTheFrameIsSaidAtOnceWithBothRanges) {
  add_imu(kStart + 200 * kMs, kStart + 300 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "100.200000000");
  EXPECT_FALSE(outputs_[0].keypoints->keypoints.empty()) << "the image is as good as ever for raw keypoints";
  for (const Keypoint& keypoint : outputs_[0].keypoints->keypoints) {
    EXPECT_FALSE(keypoint.rectified);
    EXPECT_TRUE(std::isinf(keypoint.covariance_xx) && std::isinf(keypoint.covariance_yy)) << "how blurred is unknown";
  }
}

TEST_F(ProcessingTest, PartlyCoveredFrameIsProcessedWhereCovered) {
  add_imu(kStart - 50 * kMs, kStart + 40 * kMs);  // the last rows end at 50 ms
  add_frame(kStart);
  time_out();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NONE);
  EXPECT_GT(outputs_[0].field->count(BlockStatus::DEBLURRED), 0u);
  EXPECT_GT(outputs_[0].field->count(BlockStatus::NO_GYRO), 0u);
  EXPECT_EQ(outputs_[0].field->blocks.front().status, BlockStatus::DEBLURRED);
  EXPECT_EQ(outputs_[0].field->blocks.back().status, BlockStatus::NO_GYRO);
  EXPECT_NE(outputs_[0].blur_field->reason_text.find("frame needs gyroscope samples"), std::string::npos);
  const std::size_t bottom = static_cast<std::size_t>(kHeight - 32) * kWidth;
  EXPECT_TRUE(std::equal(outputs_[0].image->data.begin() + static_cast<std::ptrdiff_t>(bottom),
                         outputs_[0].image->data.end(),
                         outputs_[0].input->data.begin() + static_cast<std::ptrdiff_t>(bottom)));
}

TEST_F(ProcessingTest, FrameWithSaturatedSamplesAloneHasAReasonOfItsOwn) {
  config_.gyro.range_rad_s = kFastRadS;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::GYRO_SATURATED, "reach gyro_range = 1.5 rad/s, the first is [0.0");
  EXPECT_EQ(processor_.statistics().imu_saturated, 31u);
  EXPECT_EQ(processor_.statistics().imu_accepted, 31u);
  EXPECT_EQ(logged("GYRO_SATURATED"), 1u);

  config_.gyro.range_rad_s = 1.01 * kFastRadS;
  configure();
  add_imu(kStart + 105 * kMs, kStart + 200 * kMs);
  add_frame(kStart + 100 * kMs);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessingTest, RowsWithASaturatedSamplePassThrough) {
  config_.gyro.range_rad_s = 10;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 35 * kMs);
  processor_.add_imu(imu_message(kStart + 40 * kMs, -10));  // rows of the lower part are exposed then
  add_imu(kStart + 45 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NONE);
  const FrameBlur& field = *outputs_[0].field;
  for (int i = 0; i < field.grid.size(); ++i) {
    // Row y is exposed from 20 ms * y / 128 on for 30 ms; nothing is known from 35 to 45 ms.
    const double end_ms = 20 * field.grid.center(i).y() / kHeight + 30;
    EXPECT_EQ(field.blocks[static_cast<std::size_t>(i)].status,
              end_ms > 35 ? BlockStatus::NO_GYRO : BlockStatus::DEBLURRED)
        << i;
  }
  EXPECT_GT(field.count(BlockStatus::DEBLURRED), 0u);
  EXPECT_GT(field.count(BlockStatus::NO_GYRO), 0u);
  EXPECT_NE(outputs_[0].blur_field->reason_text.find("1 of the "), std::string::npos) << outputs_[0].reason_text;
  EXPECT_NE(outputs_[0].blur_field->reason_text.find("[0.000000, -10.000000, 0.000000] rad/s at 100.040000000 s"),
            std::string::npos)
      << outputs_[0].reason_text;
}

TEST_F(ProcessingTest, WithoutGyroRangeNothingIsSaturated) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs, 5 * kFastRadS);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(processor_.statistics().imu_saturated, 0u);
}

TEST_F(ProcessingTest, OnePixelIsAnImage) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_image(image_message(kStart, "mono8", 1, 1));
  processor_.add_camera_info(camera_info(kStart, 1, 1));
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NONE) << outputs_[0].reason_text;
  EXPECT_EQ(outputs_[0].image->data.size(), 1u);
}

TEST_F(ProcessingTest, FramesThatPassThroughHaveRawKeypoints) {
  const auto expect_raw_keypoints = [this](std::size_t index, bool normalized) {
    ASSERT_GT(outputs_.size(), index);
    const KeypointArray& keypoints = *outputs_[index].keypoints;
    EXPECT_FALSE(keypoints.keypoints.empty());
    EXPECT_EQ(keypoints.detector, "FAST");
    EXPECT_EQ(keypoints.descriptors.size(), keypoints.keypoints.size() * keypoints.descriptor_length);
    EXPECT_EQ(keypoints.reference_time, outputs_[index].input->header.stamp);
    for (const Keypoint& keypoint : keypoints.keypoints) {
      EXPECT_FALSE(keypoint.deblurred);
      EXPECT_FALSE(keypoint.rectified);
      EXPECT_EQ(keypoint.rectified_x, keypoint.x);
      EXPECT_EQ(std::isfinite(keypoint.normalized_x), normalized);
      if (normalized) {
        EXPECT_NEAR(keypoint.normalized_x, (keypoint.x - (kWidth - 1) / 2.0) / kFocalPx, 1e-5);
      }
    }
  };
  add_frame(kStart);
  time_out();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "there are none");
  expect_raw_keypoints(0, true);
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  // Of another size than the only camera_info describes.
  processor_.add_image(image_message(kStart + kMs, "mono8", kWidth / 2));
  time_out();
  expect_passed_through(1, PassThroughReason::NO_CALIBRATION, "");
  expect_raw_keypoints(1, false);
  processor_.add_exposure([] {
    Exposure exposure;
    exposure.header.stamp = to_ros_time(kStart + 2 * kMs);
    exposure.exposure_time.fromNSec(-kMs);
    return exposure;
  }());
  add_frame(kStart + 2 * kMs);
  advance();
  expect_passed_through(2, PassThroughReason::NO_EXPOSURE_TIME, "");
  expect_raw_keypoints(2, true);
  add_frame(kStart + 90 * kMs);
  processor_.reset();
  advance();
  expect_passed_through(3, PassThroughReason::TIME_JUMP, "");
  expect_raw_keypoints(3, true);  // a reset takes from no frame what has come for it
}

// camera_info's R rotates the camera's frame into the rectified image's.
TEST_F(ProcessingTest, RectifiedFramesThatPassThroughHaveNormalizedKeypointsOfTheirOwn) {
  config_.rectified_input = true;
  configure();
  const auto info = camera_info(kStart);
  const double angle_rad = 3.3 * M_PI / 180;
  info->R = {std::cos(angle_rad), 0, std::sin(angle_rad), 0, 1, 0, -std::sin(angle_rad), 0, std::cos(angle_rad)};
  processor_.add_image(image_message(kStart));
  processor_.add_camera_info(info);
  time_out();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "");
  ASSERT_FALSE(outputs_[0].keypoints->keypoints.empty());
  for (const Keypoint& keypoint : outputs_[0].keypoints->keypoints) {
    EXPECT_NEAR(keypoint.normalized_x, (keypoint.x - (kWidth - 1) / 2.0) / kFocalPx, 1e-5);
    EXPECT_NEAR(keypoint.normalized_y, (keypoint.y - (kHeight - 1) / 2.0) / kFocalPx, 1e-5);
  }
}

TEST_F(ProcessingTest, OnlyWhatIsAskedForIsMade) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  request_.image = request_.keypoints = false;
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].image, outputs_[0].input);
  EXPECT_EQ(outputs_[0].times.deconvolution_ms, 0);
  EXPECT_EQ(outputs_[0].keypoints, nullptr);
  EXPECT_EQ(outputs_[0].overlay, nullptr);
  EXPECT_EQ(outputs_[0].markers, nullptr);
  EXPECT_EQ(outputs_[0].trust_mask, nullptr);
  EXPECT_FALSE(outputs_[0].blur_field->status.empty());
  request_.image = request_.keypoints = request_.overlay = request_.markers = true;
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
  ASSERT_NE(outputs_[1].overlay, nullptr);
  EXPECT_EQ(outputs_[1].overlay->encoding, "bgr8");
  EXPECT_EQ(outputs_[1].overlay->width, static_cast<unsigned>(kWidth));
  ASSERT_NE(outputs_[1].markers, nullptr);
  EXPECT_EQ(outputs_[1].markers->markers[0].points.size(), 2 * outputs_[1].field->blocks.size());
  ASSERT_NE(outputs_[1].keypoints, nullptr);
  EXPECT_EQ(outputs_[1].keypoints->descriptor, "ORB");
  for (const Keypoint& keypoint : outputs_[1].keypoints->keypoints) {
    EXPECT_GT(keypoint.covariance_xx, 0);
    EXPECT_LT(keypoint.covariance_xx + keypoint.covariance_yy, 100) << "[px^2] of a corner";
    EXPECT_GT(keypoint.covariance_xx * keypoint.covariance_yy, keypoint.covariance_xy * keypoint.covariance_xy);
  }
}

// The tracker needs gyroscope samples from the image before on; the frame itself is none the different for it.
TEST_F(ProcessingTest, FrameIsTheSameBitByBitWithTracks) {
  for (const bool tracks : {false, true}) {
    processor_.reset();
    request_.tracks = tracks;
    for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= kStart + 300 * kMs; t_ns += kImuPeriod) {
      processor_.add_imu(imu_message(t_ns, kFastRadS * (1 + 0.1 * std::sin(to_seconds(t_ns - kStart) * 40))));
    }
    for (int i = 0; i < 3; ++i) add_frame(kStart + i * 80 * kMs);
    advance();
  }
  ASSERT_EQ(outputs_.size(), 6u);
  for (std::size_t i = 0; i < 3; ++i) {
    const FrameOutput &without = outputs_[i], &with = outputs_[3 + i];
    EXPECT_EQ(without.tracks, nullptr);
    ASSERT_NE(with.tracks, nullptr);
    EXPECT_EQ(without.image->data, with.image->data);
    EXPECT_EQ(without.blur_field->angle, with.blur_field->angle);
    EXPECT_EQ(without.blur_field->extent, with.blur_field->extent);
  }
}

TEST_F(ProcessingTest, NothingOfAFrameThatPassesThroughIsTrusted) {
  request_.trust_mask = true;
  add_frame(kStart);  // without a gyroscope
  time_out();
  auto cut_off = image_message(kStart + kMs);
  cut_off->data.resize(cut_off->data.size() / 2);
  processor_.add_image(cut_off);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::NO_GYRO, "");
  const sensor_msgs::Image& mask = *outputs_[0].trust_mask;
  EXPECT_EQ(mask.width, outputs_[0].input->width);
  EXPECT_EQ(mask.height, outputs_[0].input->height);
  EXPECT_EQ(mask.data, std::vector<std::uint8_t>(mask.data.size(), 0));
  expect_passed_through(1, PassThroughReason::BAD_IMAGE, "");
  EXPECT_TRUE(outputs_[1].trust_mask->data.empty()) << "nobody knows how large the image is";
}

TEST_F(ProcessingTest, MarkersOfTheFrameBeforeAreTakenAway) {
  request_.markers = true;
  auto floats = image_message(kStart);
  floats->encoding = "32FC1";
  processor_.add_image(floats);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  ASSERT_NE(outputs_[0].markers, nullptr);
  EXPECT_EQ(outputs_[0].markers->markers[0].action, visualization_msgs::Marker::DELETE);
}

class EncodingTest : public ProcessorTest, public testing::WithParamInterface<const char*> {};

TEST_P(EncodingTest, IsDeblurredAndKept) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_image(image_message(kStart, GetParam()));
  processor_.add_camera_info(camera_info(kStart));
  advance();
  expect_deblurred(0);
  EXPECT_FALSE(outputs_[0].keypoints->keypoints.empty());
  if (sensor_msgs::image_encodings::hasAlpha(GetParam())) {
    for (std::size_t i = 3; i < outputs_[0].image->data.size(); i += 4) {
      ASSERT_EQ(outputs_[0].image->data[i], outputs_[0].input->data[i]) << "alpha";
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Encodings, EncodingTest,
                         testing::Values("mono8", "mono16", "8UC1", "16UC1", "bgr8", "rgb8", "bgra8", "rgba8", "bgr16",
                                         "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8", "bayer_rggb16"));

TEST_F(ProcessingTest, BlocksThatLeaveTheFastPathAreCountedByReason) {
  config_.pipeline.engine = "cpu";
  configure();
  constexpr double kSlowRadS = 0.5;  // 3 px
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs, kSlowRadS);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  EXPECT_TRUE(outputs_[0].fallback_counts.empty());
  EXPECT_TRUE(processor_.statistics().fallback_counts.empty());
  for (int i = 1; i <= 2; ++i) {
    processor_.add_image(image_message(kStart + i * 80 * kMs, "mono16"));
    processor_.add_camera_info(camera_info(kStart + i * 80 * kMs));
  }
  advance();
  expect_deblurred(2);
  const std::size_t blocks = outputs_[2].field->blocks.size();
  ASSERT_EQ(outputs_[2].fallback_counts.size(), 1u);
  const auto& [reason, count] = *outputs_[2].fallback_counts.begin();
  EXPECT_EQ(reason.rfind("16 bit and blur below", 0), 0u) << reason;
  EXPECT_EQ(count, blocks);
  EXPECT_EQ(processor_.statistics().fallback_counts, (FallbackCounts{{reason, 2 * blocks}})) << "since the start";
}

TEST_F(ProcessingTest, TwelveBitsOfSixteenAreSaidOnceAndKept) {
  add_imu(kStart - 50 * kMs, kStart + 400 * kMs);
  request_.overlay = true;
  for (int i = 0; i < 3; ++i) {
    const TimeNs stamp_ns = kStart + i * 80 * kMs;
    const auto image = image_message(stamp_ns, "mono16");
    for (std::size_t at = 0; at < image->data.size(); at += 2) {
      const int value = (image->data[at] | image->data[at + 1] << 8) >> 4;
      image->data[at] = static_cast<std::uint8_t>(value);
      image->data[at + 1] = static_cast<std::uint8_t>(value >> 8);
    }
    processor_.add_image(image);
    processor_.add_camera_info(camera_info(stamp_ns));
  }
  add_imu(kStart + 405 * kMs, kStart + 600 * kMs);
  add_frame(kStart + 240 * kMs);  // the same in 8 bit
  advance();
  ASSERT_EQ(outputs_.size(), 4u);
  const std::size_t expected = outputs_[3].keypoints->keypoints.size();
  const auto grey_levels = [](const FrameOutput& output) {
    return cv::mean(view_image(*output.overlay).image)[0];  // of the picture that the lines are drawn on
  };
  for (std::size_t i = 0; i < 3; ++i) {
    expect_deblurred(i);
    const cv::Mat image = view_image(*outputs_[i].image).image;
    double greatest = 0;
    cv::minMaxLoc(image, nullptr, &greatest);
    EXPECT_LE(greatest, 4095);
    EXPECT_GT(greatest, 3000);
    EXPECT_NEAR(grey_levels(outputs_[i]), grey_levels(outputs_[3]), 2);
    EXPECT_NEAR(static_cast<double>(outputs_[i].keypoints->keypoints.size()), static_cast<double>(expected),
                0.05 * static_cast<double>(expected));
  }
  EXPECT_EQ(logged("12 significant bits"), 1u);
}

TEST_F(ProcessingTest, ByteOrderMakesNoDifference) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  const auto little = image_message(kStart, "mono16");
  auto big = boost::make_shared<sensor_msgs::Image>(*little);
  for (std::size_t i = 0; i + 1 < big->data.size(); i += 2) std::swap(big->data[i], big->data[i + 1]);
  big->is_bigendian = !little->is_bigendian;
  processor_.add_camera_info(camera_info(kStart));
  processor_.add_image(little);
  processor_.add_image(big);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_deblurred(1);
  EXPECT_EQ(outputs_[0].image->data, outputs_[1].image->data);
  EXPECT_EQ(outputs_[0].image->is_bigendian, outputs_[1].image->is_bigendian);
}

}  // namespace
}  // namespace gyro_deblur::processing_test
