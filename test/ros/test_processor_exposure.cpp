// Where the exposure time comes from, from messages to messages: messages, the parameter, the images.
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "gyro_deblur/frame_blur.hpp"
#include "processor_test.hpp"
#include "repeated_pictures.hpp"

namespace gyro_deblur::processor_exposure_test {
namespace {

using namespace test;

constexpr TimeNs kTrueExposure = 20 * kMs;
constexpr int kPictures = 70;  // 3.5 s
constexpr double kSpeed = 2;   // blur of 10 to 20 px

const HandheldCamera& camera() {
  static const HandheldCamera kCamera(kPictures, kSpeed);
  return kCamera;
}

Exposure exposure_message(TimeNs stamp_ns, TimeNs exposure_ns) {
  Exposure exposure;
  exposure.header.stamp = to_ros_time(stamp_ns);
  exposure.exposure_time.fromNSec(exposure_ns);
  return exposure;
}

class ProcessorExposureTest : public ProcessorTest {
 protected:
  ProcessorExposureTest() {
    now_ns_ = camera().simulator().scene().start_ns;
    config_.shutter = camera().simulator().scene().timing(0);
    config_.shutter.exposure_ns = 0;
    config_.pipeline.optical_flow = true;
    config_.pipeline.validation.rule = ValidationRule::LIKELIHOOD;
    configure();
  }

  /// Pictures `begin` to `end` with all samples up to them.
  /// @param told_ns  by an exposure message of each; 0: none comes
  void play(int begin, int end, TimeNs told_ns = 0) {
    for (int i = begin; i < end; ++i) {
      const TimeNs stamp_ns = camera().simulator().stamp(i);
      now_ns_ = stamp_ns + 100 * kMs;
      for (; sample_ < imu_.size() && imu_[sample_].t_ns <= now_ns_; ++sample_) {
        sensor_msgs::Imu imu = imu_message(imu_[sample_].t_ns, imu_[sample_].rate_rad_s.y());
        imu.angular_velocity.x = imu_[sample_].rate_rad_s.x();
        imu.angular_velocity.z = imu_[sample_].rate_rad_s.z();
        processor_.add_imu(imu);
      }
      if (told_ns > 0) processor_.add_exposure(exposure_message(stamp_ns, told_ns));
      add_picture(i, stamp_ns);
    }
  }
  void add_picture(int i, TimeNs stamp_ns) {
    const CameraCalibration& calibration = camera().simulator().camera().calibration();
    const sensor_msgs::CameraInfoPtr info = test::camera_info(stamp_ns, calibration.width_px, calibration.height_px);
    info->K = {calibration.fx_px, 0, calibration.cx_px, 0, calibration.fy_px, calibration.cy_px, 0, 0, 1};
    sensor_msgs::Image like;
    like.header = info->header;
    like.encoding = "mono8";
    processor_.add_image(to_image(camera().picture(i), like));
    processor_.add_camera_info(info);
    advance();
  }
  std::string problem(const std::string& kind) const {
    const auto problems = processor_.statistics().input_problems;
    const auto found = problems.find(kind);
    return found == problems.end() || !found->second.active ? "" : found->second.text;
  }
  void expect_exposure(std::size_t index, double expected_s, double tolerance) const {
    ASSERT_LT(index, outputs_.size());
    EXPECT_STREQ(to_string(outputs_[index].reason), "NONE") << outputs_[index].reason_text;
    EXPECT_NEAR(outputs_[index].blur_field->exposure_time.toSec(), expected_s, tolerance * expected_s) << index;
  }

  const std::vector<sim::ImuSample> imu_ = camera().simulator().imu();
  std::size_t sample_ = 0;
};

TEST_F(ProcessorExposureTest, WithNothingGivenItIsEstimated) {
  play(0, 30);
  ASSERT_EQ(outputs_.size(), 30u) << "none waits";
  std::size_t first = 0;
  while (first < outputs_.size() && outputs_[first].reason != PassThroughReason::NONE) ++first;
  EXPECT_LE(first, 5u);
  for (std::size_t i = 0; i < first; ++i) {
    expect_passed_through(i, PassThroughReason::NO_EXPOSURE_TIME, "the exposure time is not known yet");
  }
  std::size_t deblurred = 0;
  for (std::size_t i = first; i < outputs_.size(); ++i) {
    expect_exposure(i, 0.02, i < first + 5 ? 0.05 : 0.03);
    deblurred += outputs_[i].image != outputs_[i].input;
  }
  EXPECT_GE(deblurred, outputs_.size() - first - 2) << "it is nearly at rest where it reverses";
  ASSERT_TRUE(outputs_.back().exposure);
  EXPECT_EQ(outputs_.back().exposure->origin, ExposureOrigin::IMAGES);
  EXPECT_EQ(logged("estimated from the blur of the images"), 1u);
  EXPECT_EQ(problem("exposure contradicted"), "");

  // An image that shows the picture again is what that was.
  const TimeNs again_ns = camera().simulator().stamp(29) + 10 * kMs;
  add_picture(29, again_ns);
  ASSERT_EQ(outputs_.size(), 31u);
  EXPECT_EQ(outputs_[30].blur_field->exposure_time, outputs_[29].blur_field->exposure_time);
  EXPECT_EQ(outputs_[30].image->data, outputs_[29].image->data);
}

TEST_F(ProcessorExposureTest, AContradictedParameterIsNamedWithBothValuesAndReplaced) {
  config_.shutter.exposure_ns = kTrueExposure * 6 / 10;
  configure();
  play(0, kPictures);
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kPictures));
  expect_exposure(10, 0.012, 1e-6);
  expect_exposure(kPictures - 1, 0.02, 0.03);
  const std::string text = problem("exposure contradicted");
  EXPECT_EQ(text.rfind("blur is 1.6", 0), 0u) << text;
  EXPECT_NE(text.find("times what exposure_time says: 0.012 s by exposure_time, 0.0"), std::string::npos) << text;
  EXPECT_NE(text.find("The images' value is used"), std::string::npos) << text;
  EXPECT_EQ(logged("times what exposure_time says"), 1u);
}

TEST_F(ProcessorExposureTest, ConfiguredKeepsWhatTheImagesContradict) {
  config_.shutter.exposure_ns = kTrueExposure * 6 / 10;
  config_.on_exposure_conflict = OnExposureConflict::CONFIGURED;
  configure();
  play(0, kPictures);
  expect_exposure(kPictures - 1, 0.012, 1e-6);
  EXPECT_NE(problem("exposure contradicted").find("on_exposure_conflict: configured"), std::string::npos);
}

TEST_F(ProcessorExposureTest, AContradictedMessageIsNamedAndKept) {
  play(0, kPictures, kTrueExposure * 8 / 5);
  expect_exposure(kPictures - 1, 0.032, 1e-6);
  const std::string text = problem("exposure contradicted");
  EXPECT_NE(text.find("times what the exposure message says: 0.032 s"), std::string::npos) << text;
  EXPECT_NE(text.find("exposure_source"), std::string::npos) << text;
}

TEST_F(ProcessorExposureTest, WhatAgreesIsNotMentioned) {
  play(0, kPictures, kTrueExposure);
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.blur_field->exposure_time.toNSec(), kTrueExposure);
  EXPECT_TRUE(processor_.statistics().input_problems.empty());
}

TEST_F(ProcessorExposureTest, AParameterAboveTheFramePeriodIsReplaced) {
  config_.shutter.exposure_ns = 200 * kMs;
  configure();
  play(0, 30);
  EXPECT_NE(problem("exposure_time").find("It is not used"), std::string::npos);
  expect_exposure(29, 0.02, 0.03);
}

// Whatever its exposure is: nothing has to be known of an image that is sharp.
TEST_F(ProcessorTest, ACameraAtRestNeedsNoExposureTime) {
  config_.shutter.exposure_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs, 0);
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NONE) << outputs_[0].reason_text;
  EXPECT_EQ(outputs_[0].image, outputs_[0].input);
  EXPECT_EQ(outputs_[0].field->count(BlockStatus::SHARP), outputs_[0].field->blocks.size());
}

}  // namespace
}  // namespace gyro_deblur::processor_exposure_test
