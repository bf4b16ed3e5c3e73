#include "ros/processor.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "message_builders.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

constexpr TimeNs kStart = 100 * kSecond;
constexpr TimeNs kImuPeriod = 5 * kMs;
/// From the stamp to the end of the last row's exposure; row 127 of 128 starts one row before the readout's end.
constexpr TimeNs kFrameDuration = kExposure + kReadout;

class ProcessorTest : public testing::Test {
 protected:
  ProcessorTest() : processor_(environment()) {
    processor_.set_config(config_);
    now_ns_ = kStart;
  }

  Processor::Environment environment() {
    Processor::Environment environment;
    environment.clock = [this] { return now_ns_; };
    environment.steady_clock = [this] { return steady_ns_; };
    environment.log = [this](LogLevel, const std::string& text) { log_.push_back(text); };
    environment.make_engine = [this](const std::string& engine, int threads) {
      ++engines_made_;
      return make_engine(engine, threads);
    };
    environment.extrinsic = [this](const std::string& camera_frame, const std::string& imu_frame) {
      if (extrinsic_fails_) throw std::runtime_error("the transforms are broken");
      EXPECT_EQ(camera_frame, kCameraFrame);
      EXPECT_EQ(imu_frame, kImuFrame);
      return extrinsic_;
    };
    environment.exposure_expected = [this] { return exposure_expected_; };
    environment.request = [this] {
      if (requests_to_fail_ > 0 && requests_to_fail_-- > 0) throw std::bad_alloc();
      return request_;
    };
    return environment;
  }

  void configure() { processor_.set_config(config_); }

  void add_imu(TimeNs from_ns, TimeNs to_ns, double rate_rad_s = kFastRadS) {
    for (TimeNs t_ns = from_ns; t_ns <= to_ns; t_ns += kImuPeriod) processor_.add_imu(imu_message(t_ns, rate_rad_s));
  }
  sensor_msgs::ImageConstPtr add_frame(TimeNs stamp_ns) {
    const sensor_msgs::ImageConstPtr image = image_message(stamp_ns);
    processor_.add_image(image);
    processor_.add_camera_info(camera_info(stamp_ns));
    return image;
  }
  void advance() {
    processor_.advance([this](FrameOutput&& output) {
      outputs_.push_back(std::move(output));
      return true;
    });
  }
  void time_out() {
    now_ns_ += config_.gyro_timeout_ns;
    advance();
  }
  std::size_t logged(const std::string& part) const {
    std::size_t count = 0;
    for (const std::string& line : log_) count += line.find(part) != std::string::npos;
    return count;
  }
  void expect_passed_through(std::size_t index, PassThroughReason reason, const std::string& text_part) const {
    ASSERT_GT(outputs_.size(), index);
    const FrameOutput& output = outputs_[index];
    EXPECT_STREQ(to_string(output.reason), to_string(reason));
    EXPECT_EQ(output.image, output.input) << "the very message that came in";
    EXPECT_EQ(output.blur_field->reason, static_cast<int>(reason));
    EXPECT_EQ(output.blur_field->header.stamp, output.input->header.stamp);
    EXPECT_NE(output.reason_text.find(text_part), std::string::npos) << output.reason_text;
    EXPECT_EQ(output.blur_field->reason_text, output.reason_text);
    EXPECT_TRUE(output.blur_field->status.empty());
    ASSERT_NE(output.camera_info, nullptr);
    EXPECT_EQ(output.camera_info->header.stamp, output.input->header.stamp);
    ASSERT_NE(output.keypoints, nullptr);
    EXPECT_EQ(output.keypoints->header.stamp, output.input->header.stamp);
  }
  void expect_deblurred(std::size_t index) const {
    ASSERT_GT(outputs_.size(), index);
    const FrameOutput& output = outputs_[index];
    EXPECT_STREQ(to_string(output.reason), "NONE") << output.reason_text;
    EXPECT_NE(output.image, output.input);
    EXPECT_NE(output.image->data, output.input->data);
    EXPECT_EQ(output.image->header.stamp, output.input->header.stamp);
    EXPECT_EQ(output.image->header.frame_id, output.input->header.frame_id);
    EXPECT_EQ(output.image->encoding, output.input->encoding);
    EXPECT_EQ(output.image->width, output.input->width);
    EXPECT_EQ(output.image->height, output.input->height);
    ASSERT_TRUE(output.field);
    EXPECT_EQ(output.field->count(BlockStatus::DEBLURRED), output.field->blocks.size());
  }

  TimeNs now_ns_ = 0, steady_ns_ = 0;
  bool exposure_expected_ = false;
  bool extrinsic_fails_ = false;
  int requests_to_fail_ = 0;
  int engines_made_ = 0;
  std::optional<Eigen::Matrix3d> extrinsic_;
  FrameRequest request_;
  Config config_ = test_config();
  std::vector<std::string> log_;
  std::vector<FrameOutput> outputs_;
  Processor processor_;
};

TEST_F(ProcessorTest, SharpFrameLeavesAsTheVeryMessage) {
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

TEST_F(ProcessorTest, FrameWaitsUntilTheGyroscopeCoversItsLastRow) {
  add_imu(kStart - 50 * kMs, kStart + kFrameDuration - kImuPeriod);
  add_frame(kStart);
  advance();
  EXPECT_TRUE(outputs_.empty());
  EXPECT_EQ(processor_.waiting(), 1u);
  add_imu(kStart + kFrameDuration, kStart + kFrameDuration);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(processor_.waiting(), 0u);
}

TEST_F(ProcessorTest, ExtentIsThatOfTheRotation) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  const FrameBlur& field = *outputs_[0].field;
  const BlockBlur& center = field.blocks[static_cast<std::size_t>(field.grid.index_at(kWidth / 2, kHeight / 2))];
  // A turn of w t about y moves the centre by about f w t along x.
  EXPECT_NEAR(center.extent_px, kFocalPx * kFastRadS * to_seconds(kExposure), 0.25);
  EXPECT_LT(axial_difference(center.angle_rad, 0), 0.02);
}

TEST_F(ProcessorTest, TimeOffsetMovesTheRangeThatIsNeeded) {
  for (const TimeNs offset_ns : {100 * kMs, -100 * kMs}) {
    outputs_.clear();
    processor_.reset();
    config_.gyro.time_offset_ns = offset_ns;
    configure();
    add_imu(kStart - 200 * kMs, kStart + kFrameDuration + offset_ns - kImuPeriod);
    add_frame(kStart);
    advance();
    EXPECT_TRUE(outputs_.empty());
    add_imu(kStart + kFrameDuration + offset_ns, kStart + kFrameDuration + offset_ns);
    advance();
    expect_deblurred(0);
  }
}

TEST_F(ProcessorTest, WithoutGyroscopeFramesPassThroughAfterTheTimeoutInOrder) {
  add_frame(kStart);
  now_ns_ += 33 * kMs;
  add_frame(kStart + 33 * kMs);
  now_ns_ = kStart + config_.gyro_timeout_ns - 1;
  advance();
  EXPECT_TRUE(outputs_.empty());
  now_ns_ += 1;
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  now_ns_ += 33 * kMs;
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::NO_GYRO, "there are none");
  expect_passed_through(1, PassThroughReason::NO_GYRO, "there are none");
  EXPECT_LT(outputs_[0].input->header.stamp, outputs_[1].input->header.stamp);
  EXPECT_EQ(logged("NO_GYRO"), 1u) << "throttled";
}

TEST_F(ProcessorTest, BufferThatLostTheFrameIsSaidAtOnceWithBothRanges) {
  add_imu(kStart + 200 * kMs, kStart + 300 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "100.200000000");
  EXPECT_FALSE(outputs_[0].keypoints->keypoints.empty()) << "the image is as good as ever for raw keypoints";
  for (const Keypoint& keypoint : outputs_[0].keypoints->keypoints) EXPECT_FALSE(keypoint.rectified);
}

TEST_F(ProcessorTest, PartlyCoveredFrameIsProcessedWhereCovered) {
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

TEST_F(ProcessorTest, FrameWithSaturatedSamplesAloneHasAReasonOfItsOwn) {
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

TEST_F(ProcessorTest, RowsWithASaturatedSamplePassThrough) {
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

TEST_F(ProcessorTest, WithoutGyroRangeNothingIsSaturated) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs, 5 * kFastRadS);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(processor_.statistics().imu_saturated, 0u);
}

TEST_F(ProcessorTest, SimulatedTimeThatStopsDoesNotKeepFrames) {
  add_frame(kStart);
  steady_ns_ = 10 * config_.gyro_timeout_ns - 1;
  advance();
  EXPECT_TRUE(outputs_.empty());
  steady_ns_ += 1;
  advance();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "");
}

TEST_F(ProcessorTest, WaitingStartsWithTheFirstSimulatedTime) {
  now_ns_ = 0;
  add_frame(kStart);
  advance();
  now_ns_ = kStart;
  advance();
  EXPECT_TRUE(outputs_.empty()) << "the clock started, no time passed";
  time_out();
  EXPECT_EQ(outputs_.size(), 1u);
}

TEST_F(ProcessorTest, FinishLetsEverythingOut) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  add_frame(kStart + 200 * kMs);
  processor_.finish([this](FrameOutput&& output) {
    outputs_.push_back(std::move(output));
    return true;
  });
  ASSERT_EQ(outputs_.size(), 2u);
  expect_deblurred(0);
  expect_passed_through(1, PassThroughReason::NO_GYRO, "");
}

TEST_F(ProcessorTest, SinkCanStop) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  add_frame(kStart + 33 * kMs);
  std::size_t taken = 0;
  processor_.advance([&taken](FrameOutput&&) {
    ++taken;
    return false;
  });
  EXPECT_EQ(taken, 1u);
  EXPECT_EQ(processor_.waiting(), 1u);
}

TEST_F(ProcessorTest, FullQueuePassesTheOldestThroughAndLosesNothing) {
  config_.frame_queue_size = 3;
  configure();
  for (int i = 0; i < 5; ++i) add_frame(kStart + i * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::OVERLOAD, "frame_queue_size = 3");
  expect_passed_through(1, PassThroughReason::OVERLOAD, "frame_queue_size = 3");
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(to_time_ns(outputs_[i].input->header.stamp), kStart + static_cast<TimeNs>(i) * kMs);
  }
  expect_deblurred(4);
  EXPECT_EQ(processor_.statistics().passed_through.at(PassThroughReason::OVERLOAD), 2u);
}

Exposure exposure_message(TimeNs stamp_ns, TimeNs exposure_ns, TimeNs readout_ns = 0) {
  Exposure exposure;
  exposure.header.stamp = to_ros_time(stamp_ns);
  exposure.exposure_time.fromNSec(exposure_ns);
  exposure.readout_time.fromNSec(readout_ns);
  return exposure;
}

TEST_F(ProcessorTest, ExposureOfTheMessageGoesBeforeTheParameter) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_exposure(exposure_message(kStart, 20 * kMs));
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].field->exposure_ns, 20 * kMs);
  EXPECT_EQ(outputs_[0].field->readout_ns, kReadout) << "0 in the message: as configured";
  processor_.add_exposure(exposure_message(kStart + kMs, 20 * kMs, -10 * kMs));
  add_frame(kStart + kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_EQ(outputs_[1].field->readout_ns, -10 * kMs);
}

TEST_F(ProcessorTest, ExpectedExposureIsWaitedFor) {
  exposure_expected_ = true;
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  EXPECT_TRUE(outputs_.empty());
  processor_.add_exposure(exposure_message(kStart, 25 * kMs));
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].field->exposure_ns, 25 * kMs);

  add_frame(kStart + kMs);
  processor_.add_exposure(exposure_message(kStart + 2 * kMs, 25 * kMs));  // another image's
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  time_out();
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_EQ(outputs_[1].field->exposure_ns, kExposure) << "the parameter, after the timeout";
  EXPECT_EQ(logged("no exposure message"), 1u);
}

TEST_F(ProcessorTest, NoExposureTimeAtAll) {
  config_.shutter.exposure_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  EXPECT_TRUE(outputs_.empty()) << "a message may still come";
  time_out();
  expect_passed_through(0, PassThroughReason::NO_EXPOSURE_TIME, "exposure_time = 0 is outside (0, 1] s");
}

TEST_F(ProcessorTest, ExposureMessageOutOfRangeIsNamed) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_exposure(exposure_message(kStart, -5 * kMs));
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_EXPOSURE_TIME, "-0.005");
}

TEST_F(ProcessorTest, LastExposureServesForAsLongAsItMay) {
  config_.shutter.exposure_ns = 0;
  config_.exposure_max_age_ns = 50 * kMs;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs);
  processor_.add_exposure(exposure_message(kStart, 10 * kMs));
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  add_frame(kStart + 50 * kMs);
  advance();
  EXPECT_EQ(outputs_.size(), 1u) << "its own may still come";
  time_out();
  expect_deblurred(1);
  EXPECT_EQ(outputs_[1].blur_field->exposure_time.toNSec(), 10 * kMs);
  add_frame(kStart + 51 * kMs);
  time_out();
  expect_passed_through(2, PassThroughReason::NO_EXPOSURE_TIME, "none within exposure_max_age = 0.050000000 s");
}

TEST_F(ProcessorTest, ExposureSettingHoldsUntilTheNext) {
  config_.shutter.exposure_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs);
  processor_.add_exposure_setting(15 * kMs);
  add_frame(kStart);
  advance();  // nothing to wait for
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].blur_field->exposure_time.toNSec(), 15 * kMs);
  processor_.add_exposure_setting(20 * kMs);
  add_frame(kStart + 50 * kMs);
  advance();
  EXPECT_EQ(outputs_[1].blur_field->exposure_time.toNSec(), 20 * kMs);
  processor_.add_exposure_setting(33000 * kMs);  // a wrong unit
  add_frame(kStart + 100 * kMs);
  advance();
  expect_passed_through(2, PassThroughReason::NO_EXPOSURE_TIME, "exposure_time = 33 is outside [1e-09, 1] s: is it in");
}

TEST_F(ProcessorTest, ExtrinsicMayComeLater) {
  config_.R_cam_imu.reset();
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  EXPECT_TRUE(outputs_.empty());
  extrinsic_ = Eigen::Matrix3d::Identity();
  advance();
  expect_deblurred(0);
  extrinsic_.reset();
  add_frame(kStart + kMs);
  time_out();
  expect_passed_through(1, PassThroughReason::NO_EXTRINSIC, "\"imu\"");
}

TEST_F(ProcessorTest, CameraInfoIsMatchedByStampInAnyOrder) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_camera_info(camera_info(kStart));
  processor_.add_image(image_message(kStart));
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  processor_.add_image(image_message(kStart + kMs));
  processor_.add_camera_info(camera_info(kStart + 2 * kMs));
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  const auto info = camera_info(kStart + kMs);
  processor_.add_camera_info(info);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(outputs_[1].camera_info, info);
}

TEST_F(ProcessorTest, WithoutCameraInfoImagesStillPass) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_image(image_message(kStart));
  time_out();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "100.000000000");
  EXPECT_EQ(outputs_[0].camera_info->width, static_cast<unsigned>(kWidth));
  EXPECT_EQ(outputs_[0].camera_info->K[0], 0) << "not calibrated";
  EXPECT_EQ(outputs_[0].camera_info->header.frame_id, kCameraFrame);
}

/// The file that describes the same camera as the tests' camera_info.
SensorCalibration calibration_file() {
  SensorCalibration calibration;
  calibration.origin = "file.yaml";
  calibration.camera = to_calibration(*camera_info(kStart), kWidth, kHeight, false);
  return calibration;
}

TEST_F(ProcessorTest, CalibrationFileServesWhereThereIsNoCameraInfo) {
  config_.calibration = calibration_file();
  configure();
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  processor_.add_image(image_message(kStart));
  advance();  // no waiting for what nobody sends
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].camera_info->K[0], kFocalPx);
  EXPECT_EQ(outputs_[0].camera_info->header.frame_id, kCameraFrame);

  // Somebody does: from now on each image waits for its own.
  add_frame(kStart + 50 * kMs);
  advance();
  expect_deblurred(1);
  processor_.add_image(image_message(kStart + 100 * kMs));
  advance();
  EXPECT_EQ(outputs_.size(), 2u);
  time_out();
  expect_deblurred(2);
}

TEST_F(ProcessorTest, FrameThatStillWaitsGoesByItsOwnCameraInfoThatComesAfterIt) {
  config_.calibration = calibration_file();
  config_.calibration->camera->fx_px *= 1.5;
  configure();
  processor_.add_image(image_message(kStart));
  advance();  // goes by the file, and waits for samples
  EXPECT_TRUE(outputs_.empty());
  processor_.add_camera_info(camera_info(kStart));
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  advance();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "fx 300");
  EXPECT_EQ(outputs_[0].camera_info->K[0], kFocalPx);
}

TEST_F(ProcessorTest, FrameWithoutCameraInfoGoesByTheFileThoughALaterOneHasIt) {
  config_.calibration = calibration_file();
  config_.calibration->camera->fx_px *= 1.5;
  configure();
  processor_.add_image(image_message(kStart));
  processor_.add_image(image_message(kStart + kMs));
  advance();  // both go by the file, and wait for samples
  EXPECT_TRUE(outputs_.empty());
  processor_.add_camera_info(camera_info(kStart + kMs));
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 2u) << "none waits for a camera_info from before there was any";
  expect_deblurred(0);
  const FrameBlur& field = *outputs_[0].field;
  const BlockBlur& center = field.blocks[static_cast<std::size_t>(field.grid.index_at(kWidth / 2, kHeight / 2))];
  EXPECT_NEAR(center.extent_px, 1.5 * kFocalPx * kFastRadS * to_seconds(kExposure), 0.4);
  EXPECT_EQ(outputs_[0].camera_info->K[0], 1.5 * kFocalPx);
  expect_passed_through(1, PassThroughReason::NO_CALIBRATION, "fx 300");
  EXPECT_EQ(outputs_[1].camera_info->K[0], kFocalPx);
}

TEST_F(ProcessorTest, ImageOfAnotherSizeThanTheFileWaitsForItsCameraInfo) {
  config_.calibration = calibration_file();
  configure();
  add_imu(kStart - 50 * kMs, kStart + 2 * kSecond);
  processor_.add_image(image_message(kStart, "mono8", kWidth, kHeight / 2));
  advance();
  EXPECT_TRUE(outputs_.empty());
  time_out();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, std::to_string(kHeight / 2));

  const TimeNs second_ns = kStart + 33 * kMs;
  processor_.add_image(image_message(second_ns, "mono8", kWidth, kHeight / 2));
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  const auto info = camera_info(second_ns);
  info->roi.y_offset = 30;
  info->roi.width = kWidth;
  info->roi.height = kHeight / 2;
  processor_.add_camera_info(info);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessorTest, UsableCameraInfoServesAfterUnusableOnes) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  const auto info = camera_info(kStart);
  info->K.fill(0);
  processor_.add_image(image_message(kStart));
  processor_.add_camera_info(info);
  advance();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "K");
  add_frame(kStart + 33 * kMs);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessorTest, CameraInfoThatContradictsTheFileIsPrintedWithIt) {
  config_.calibration = calibration_file();
  config_.calibration->camera->fx_px *= 1.5;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "fx 200");
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "fx 300");
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "file.yaml");

  config_.on_calibration_conflict = OnCalibrationConflict::CONFIGURED;
  configure();
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
  const FrameBlur& field = *outputs_[1].field;
  const BlockBlur& center = field.blocks[static_cast<std::size_t>(field.grid.index_at(kWidth / 2, kHeight / 2))];
  EXPECT_NEAR(center.extent_px, 1.5 * kFocalPx * kFastRadS * to_seconds(kExposure), 0.4) << "the file holds";
}

TEST_F(ProcessorTest, RegionOfInterestOfCameraInfoAppliesToTheFile) {
  config_.calibration = calibration_file();
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  const auto info = camera_info(kStart);
  info->roi.y_offset = 30;
  info->roi.width = kWidth;
  info->roi.height = kHeight / 2;
  processor_.add_camera_info(info);
  processor_.add_image(image_message(kStart, "mono8", kWidth, kHeight / 2));
  advance();
  expect_deblurred(0);
}

TEST_F(ProcessorTest, TransformThatContradictsTheParameterIsPrintedWithIt) {
  extrinsic_ = Eigen::Matrix3d(Eigen::AngleAxisd(0.01, Eigen::Vector3d::UnitZ()));
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_EXTRINSIC, "[1, 0, 0, 0, 1, 0, 0, 0, 1] in parameter R_cam_imu");
  expect_passed_through(0, PassThroughReason::NO_EXTRINSIC, "in tf");
  config_.on_calibration_conflict = OnCalibrationConflict::CONFIGURED;
  configure();
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessorTest, ReadoutLongerThanTheFramePeriodIsNamed) {
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs);
  constexpr TimeNs kPeriod = kReadout / 2;
  constexpr int kFrames = 10;
  for (int i = 0; i < kFrames; ++i) {
    add_frame(kStart + i * kPeriod);
    advance();
  }
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames));
  expect_deblurred(0);  // nobody can know yet
  expect_passed_through(kFrames - 1, PassThroughReason::BAD_CONFIGURATION,
                        "readout_time = 0.02 s is longer than the frame period 0.01 s");
}

TEST_F(ProcessorTest, UnusableCameraInfoIsNamedAtOnce) {
  const auto pass = [this](TimeNs stamp_ns, const sensor_msgs::CameraInfoPtr& info) {
    processor_.add_image(image_message(stamp_ns));
    processor_.add_camera_info(info);
    advance();
    ASSERT_FALSE(outputs_.empty());
    EXPECT_EQ(outputs_.back().camera_info, info);
  };
  auto info = camera_info(kStart);
  info->K.fill(0);
  pass(kStart, info);
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "not calibrated");
  info = camera_info(kStart + kMs);
  info->distortion_model = "fisheye62";
  pass(kStart + kMs, info);
  expect_passed_through(1, PassThroughReason::NO_CALIBRATION, "fisheye62");
  pass(kStart + 2 * kMs, camera_info(kStart + 2 * kMs, 640, 480));
  expect_passed_through(2, PassThroughReason::NO_CALIBRATION, "640x480");
  EXPECT_EQ(logged("NO_CALIBRATION"), 1u) << "throttled";
}

TEST_F(ProcessorTest, UnusableImagesPassAtOnceInTheirTurn) {
  add_imu(kStart - 50 * kMs, kStart + 10 * kMs);
  add_frame(kStart);
  auto empty = boost::make_shared<sensor_msgs::Image>();
  empty->header.stamp = to_ros_time(kStart + kMs);
  empty->encoding = "mono8";
  processor_.add_image(empty);
  auto floats = image_message(kStart + 2 * kMs);
  floats->encoding = "32FC1";
  processor_.add_image(floats);
  auto cut = image_message(kStart + 3 * kMs);
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

TEST_F(ProcessorTest, OnePixelIsAnImage) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_image(image_message(kStart, "mono8", 1, 1));
  processor_.add_camera_info(camera_info(kStart, 1, 1));
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NONE) << outputs_[0].reason_text;
  EXPECT_EQ(outputs_[0].image->data.size(), 1u);
}

TEST_F(ProcessorTest, RegionOfInterestShortensTheReadout) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  auto info = camera_info(kStart, kWidth, 2 * kHeight);
  info->roi.width = kWidth;
  info->roi.height = kHeight;
  info->roi.y_offset = 10;
  processor_.add_image(image_message(kStart));
  processor_.add_camera_info(info);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].field->readout_ns, kReadout / 2);
}

TEST_F(ProcessorTest, BadConfigurationPassesFramesThroughUntilItIsMended) {
  processor_.set_config_error("gamma = -1 is outside [1e-05, 1]");
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::BAD_CONFIGURATION, "gamma = -1");
  EXPECT_EQ(logged("gamma = -1"), 1u);
  EXPECT_EQ(processor_.statistics().configuration_error, "gamma = -1 is outside [1e-05, 1]");
  configure();
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessorTest, ConfigurationThatCannotBeUsedChangesNothing) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  Config bad = config_;
  bad.pipeline.kernel.gamma = 2;
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  bad = config_;
  bad.pipeline.keypoints.detector = "nonsense";
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  bad = config_;
  bad.R_cam_imu = -Eigen::Matrix3d::Identity();
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
}

TEST_F(ProcessorTest, AbsentDeviceIsSaidOnceAndReplaced) {
  config_.pipeline.engine = "opencl:no such device";
  configure();
  add_imu(kStart - kSecond, kStart + kSecond);
  for (int i = 0; i < 3; ++i) add_frame(kStart + i * 100 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 3u);
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NONE);
  EXPECT_EQ(logged("OpenCL failed"), 1u);
  EXPECT_EQ(processor_.statistics().engine.rfind("cpu-", 0), 0u) << processor_.statistics().engine;
}

TEST_F(ProcessorTest, ImuSamplesThatCannotBeUsedAreCountedAndDropped) {
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

TEST_F(ProcessorTest, StrayImuStampsAreDroppedAndChangeNothing) {
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
  EXPECT_EQ(logged("far from those around it"), 1u) << "throttled";
}

TEST_F(ProcessorTest, ImuThatWasSilentIsTakenAgain) {
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

TEST_F(ProcessorTest, StrayImageStampIsNoJump) {
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

TEST_F(ProcessorTest, FramesThatPassThroughHaveRawKeypoints) {
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
  processor_.add_image(image_message(kStart + kMs));
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
  expect_raw_keypoints(3, false);
}

TEST_F(ProcessorTest, ManyChangesOfParametersMakeNoNewEngine) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  for (int i = 0; i < 100; ++i) {
    config_.pipeline.kernel.gamma = 0.001 * (1 + i);
    config_.pipeline.keypoints.max_features = 100 + i % 7;
    configure();
  }
  config_.pipeline.blur_field.block_size_px = 64;
  config_.pipeline.keypoints.descriptor = "BRISK";
  configure();
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].field->grid.block_size_px(), 64) << "the last one counts";
  EXPECT_EQ(outputs_[0].keypoints->descriptor, "BRISK");
  EXPECT_EQ(engines_made_, 1);
  config_.pipeline.threads = 1;
  configure();
  EXPECT_EQ(engines_made_, 2);
}

TEST_F(ProcessorTest, FrameThatCannotBePreparedDoesNotHoldUpOthers) {
  config_.R_cam_imu.reset();
  configure();
  extrinsic_fails_ = true;
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::INTERNAL_ERROR, "the transforms are broken");
  extrinsic_fails_ = false;
  extrinsic_ = Eigen::Matrix3d::Identity();
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessorTest, FrameIsKeptWhenEvenPassingItThroughFails) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  const auto first = add_frame(kStart);
  add_frame(kStart + kMs);
  requests_to_fail_ = 1;
  EXPECT_THROW(advance(), std::bad_alloc);
  EXPECT_TRUE(outputs_.empty());
  EXPECT_EQ(processor_.waiting(), 2u);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::INTERNAL_ERROR, "");
  EXPECT_EQ(outputs_[0].image, first);
  expect_deblurred(1);
  EXPECT_EQ(processor_.waiting(), 0u);
}

// --- time going backwards ---

TEST_F(ProcessorTest, OldImageOutOfOrderDoesNotHideALaterJump) {
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

TEST_F(ProcessorTest, LoopingBagResetsWithOneMessageALoop) {
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

TEST_F(ProcessorTest, LoopWithSimulatedTimeIsOneJumpToo) {
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

TEST_F(ProcessorTest, BagShorterThanTheThresholdLoopsToo) {
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

TEST_F(ProcessorTest, StragglersOfTheOldEpochDoNotDisturb) {
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

TEST_F(ProcessorTest, LateSamplesOfTheOldEpochDoNotStandForTheNewOne) {
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

TEST_F(ProcessorTest, ClockAloneGoingBackIsAJump) {
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

// --- several cameras, one IMU ---

TEST_F(ProcessorTest, CamerasShareASourceAndKeepWhatIsTheirOwn) {
  const auto source = std::make_shared<GyroSource>(GyroSource::options_of(config_), [](LogLevel, const auto&) {});
  Processor::Environment environments[2] = {environment(), environment()};
  for (Processor::Environment& each : environments) each.gyro = source;
  Processor left(environments[0]), right(environments[1]);
  config_.R_cam_imu = Eigen::Matrix3d::Identity();
  left.set_config(config_);
  Config other = config_;
  other.gyro.time_offset_ns = 100 * kMs;
  other.R_cam_imu = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  right.set_config(other);
  const auto feed = [&](TimeNs from_ns, TimeNs to_ns) {
    for (TimeNs t_ns = from_ns; t_ns <= to_ns; t_ns += kImuPeriod) {
      const sensor_msgs::Imu imu = imu_message(t_ns, kFastRadS);
      if (!source->add(imu)) continue;  // nobody is told, as SharedImu does it
      for (Processor* camera : {&left, &right}) camera->notice_imu(imu);
    }
  };
  const auto show = [](Processor* camera, TimeNs stamp_ns) {
    camera->add_camera_info(camera_info(stamp_ns));
    camera->add_image(image_message(stamp_ns));
  };
  std::vector<FrameOutput> of_left, of_right;
  const auto advance_both = [&] {
    const auto into = [](std::vector<FrameOutput>* outputs) {
      return [outputs](FrameOutput&& output) {
        outputs->push_back(std::move(output));
        return true;
      };
    };
    left.advance(into(&of_left));
    right.advance(into(&of_right));
  };
  for (Processor* camera : {&left, &right}) show(camera, kStart);
  feed(kStart - 50 * kMs, kStart + kFrameDuration);
  advance_both();
  EXPECT_EQ(of_left.size(), 1u);
  EXPECT_EQ(of_right.size(), 0u) << "its offset asks for later samples";
  feed(kStart + kFrameDuration + kImuPeriod, kStart + kFrameDuration + 100 * kMs);
  advance_both();
  ASSERT_EQ(of_right.size(), 1u);
  const auto center = [](const FrameOutput& output) {
    return output.field->blocks[static_cast<std::size_t>(output.field->grid.size() / 2)];
  };
  EXPECT_NEAR(std::cos(2 * (center(of_left[0]).angle_rad - center(of_right[0]).angle_rad)), -1, 0.1)
      << "each has its own rotation: a quarter turn apart";

  // One camera is told to forget; the other has what it had.
  left.reset();
  EXPECT_FALSE(left.statistics().newest_imu_ns);
  EXPECT_TRUE(right.statistics().newest_imu_ns);

  // The IMU's clock is set back: each camera is told so once.
  feed(kStart + kFrameDuration + 105 * kMs, kStart + kSecond);
  for (Processor* camera : {&left, &right}) show(camera, kStart + kSecond);
  feed(kStart - 50 * kMs, kStart + kSecond);
  for (Processor* camera : {&left, &right}) show(camera, kStart);
  advance_both();
  EXPECT_EQ(left.statistics().time_jumps, 1u);
  EXPECT_EQ(right.statistics().time_jumps, 1u);
  ASSERT_EQ(of_left.size(), 3u);
  ASSERT_EQ(of_right.size(), 3u);
  for (const auto* outputs : {&of_left, &of_right}) {
    EXPECT_STREQ(to_string((*outputs)[1].reason), "TIME_JUMP");
    EXPECT_STREQ(to_string((*outputs)[2].reason), "NONE");
  }
}

// --- threads ---

TEST_F(ProcessorTest, ThreadsMayFeedItAtOnce) {
  constexpr int kFrames = 60;
  constexpr TimeNs kPeriod = kReadout;
  const TimeNs last_imu_ns = kStart + kFrames * kPeriod + kFrameDuration;
  config_.frame_queue_size = kFrames;
  config_.gyro_timeout_ns = 10 * kSecond;
  configure();
  std::thread imu([&] { add_imu(kStart - 50 * kMs, last_imu_ns); });
  std::thread infos([&] {
    for (int i = 0; i < kFrames; ++i) processor_.add_camera_info(camera_info(kStart + i * kPeriod));
  });
  std::thread images([&] {
    for (int i = 0; i < kFrames; ++i) processor_.add_image(image_message(kStart + i * kPeriod));
  });
  std::thread owner([&] {
    for (int i = 0; i < 20; ++i) {
      configure();
      processor_.statistics();
      std::string text;
      processor_.estimate_bias(&text);
    }
  });
  while (outputs_.size() < kFrames && processor_.statistics().time_jumps == 0) advance();
  for (std::thread* thread : {&imu, &infos, &images, &owner}) thread->join();
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames));
  for (std::size_t i = 0; i < outputs_.size(); ++i) {
    EXPECT_EQ(to_time_ns(outputs_[i].input->header.stamp), kStart + static_cast<TimeNs>(i) * kPeriod);
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << outputs_[i].reason_text;
  }
}

// --- services ---

TEST_F(ProcessorTest, BiasAtRestIsAveragedAndUsed) {
  add_imu(kStart - 1200 * kMs, kStart + 100 * kMs, 0.4);
  std::string text;
  ASSERT_TRUE(processor_.estimate_bias(&text)) << text;
  EXPECT_NEAR(processor_.bias_rad_s().y(), 0.4, 1e-12);
  EXPECT_NE(text.find("0.400000"), std::string::npos);
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].image, outputs_[0].input) << "without its bias the camera stands still";
  configure();
  EXPECT_NEAR(processor_.bias_rad_s().y(), 0.4, 1e-12) << "other parameters leave it";
  processor_.reset();
  EXPECT_EQ(processor_.bias_rad_s().y(), 0);
}

TEST_F(ProcessorTest, BiasOfAMovingSensorIsRefused) {
  for (TimeNs t_ns = 0; t_ns <= 1100 * kMs; t_ns += kImuPeriod) {
    processor_.add_imu(imu_message(kStart + t_ns, std::sin(to_seconds(t_ns) * 10)));
  }
  std::string text;
  EXPECT_FALSE(processor_.estimate_bias(&text));
  EXPECT_FALSE(text.empty());
  EXPECT_EQ(processor_.bias_rad_s().y(), 0);
}

TEST_F(ProcessorTest, ConstantRotationIsNoBias) {
  add_imu(kStart - 1200 * kMs, kStart, 1.5);
  std::string text;
  EXPECT_FALSE(processor_.estimate_bias(&text));
  EXPECT_NE(text.find("gyro_bias = 1.5"), std::string::npos) << text;
  EXPECT_EQ(processor_.bias_rad_s().y(), 0);
}

TEST_F(ProcessorTest, BiasOfTooFewSamplesIsRefused) {
  std::string text;
  EXPECT_FALSE(processor_.estimate_bias(&text));
  EXPECT_NE(text.find("bias_window"), std::string::npos);
  add_imu(kStart, kStart + 500 * kMs, 0.1);
  EXPECT_FALSE(processor_.estimate_bias(&text));
  EXPECT_NE(text.find("0.5"), std::string::npos) << text;
}

TEST_F(ProcessorTest, ResetLetsWaitingFramesOutAndForgets) {
  add_imu(kStart - 50 * kMs, kStart);
  add_frame(kStart);
  processor_.reset();
  advance();
  expect_passed_through(0, PassThroughReason::TIME_JUMP, "reset");
  EXPECT_FALSE(processor_.statistics().newest_imu_ns);
  add_imu(kStart - 60 * kSecond, kStart - 60 * kSecond);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u) << "any time may follow a reset";
}

// --- what is asked for ---

TEST_F(ProcessorTest, OnlyWhatIsAskedForIsMade) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  request_ = {false, false, false, false};
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_EQ(outputs_[0].image, outputs_[0].input);
  EXPECT_EQ(outputs_[0].stages.deconvolution_ms, 0);
  EXPECT_EQ(outputs_[0].keypoints, nullptr);
  EXPECT_EQ(outputs_[0].overlay, nullptr);
  EXPECT_EQ(outputs_[0].markers, nullptr);
  EXPECT_FALSE(outputs_[0].blur_field->status.empty());
  request_ = {true, true, true, true};
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
}

// The tracker needs gyroscope samples from the image before on; the frame itself is none the different for it.
TEST_F(ProcessorTest, FrameIsTheSameBitByBitWithTracks) {
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

TEST_F(ProcessorTest, MarkersOfTheFrameBeforeAreTakenAway) {
  request_.markers = true;
  auto floats = image_message(kStart);
  floats->encoding = "32FC1";
  processor_.add_image(floats);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  ASSERT_NE(outputs_[0].markers, nullptr);
  EXPECT_EQ(outputs_[0].markers->markers[0].action, visualization_msgs::Marker::DELETE);
}

class ProcessorEncodingTest : public ProcessorTest, public testing::WithParamInterface<const char*> {};

TEST_P(ProcessorEncodingTest, IsDeblurredAndKept) {
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

INSTANTIATE_TEST_SUITE_P(Encodings, ProcessorEncodingTest,
                         testing::Values("mono8", "mono16", "8UC1", "16UC1", "bgr8", "rgb8", "bgra8", "rgba8", "bgr16",
                                         "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8", "bayer_rggb16"));

TEST_F(ProcessorTest, ByteOrderMakesNoDifference) {
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

/// A camera that moves sideways at a constant speed while it turns about y.
class ProcessorTranslationTest : public ProcessorTest {
 protected:
  static nav_msgs::Odometry odometry(TimeNs stamp_ns, double speed_x_m_s) {
    nav_msgs::Odometry message;
    message.header.stamp = to_ros_time(stamp_ns);
    message.header.frame_id = "world";
    message.child_frame_id = kImuFrame;
    message.pose.pose.orientation.w = 1;
    message.twist.twist.linear.x = speed_x_m_s;
    return message;
  }
  static sensor_msgs::Range depth(TimeNs stamp_ns, float depth_m) {
    sensor_msgs::Range message;
    message.header.stamp = to_ros_time(stamp_ns);
    message.range = depth_m;
    message.max_range = 50;
    return message;
  }
  /// At rest in the world, as seen by a body that turns: the velocity turns the other way.
  void add_odometry(double speed_x_m_s, TimeNs until_ns = kStart - 20 * kMs) {
    for (TimeNs t_ns = kStart - 120 * kMs; t_ns <= until_ns; t_ns += 50 * kMs) {
      processor_.add_odometry(odometry(t_ns, speed_x_m_s));
    }
  }
  /// One frame after gyroscope samples of the given rate.
  const FrameOutput& process(double rate_rad_s) {
    add_imu(kStart - 300 * kMs, kStart + 100 * kMs, rate_rad_s);
    add_frame(kStart);
    advance();
    EXPECT_EQ(outputs_.size(), 1u);
    return outputs_.at(0);
  }
  double center_extent_px() const {
    const FrameBlur& field = *outputs_.at(0).field;
    return field.blocks[field.grid.index_at(kWidth / 2.0, kHeight / 2.0)].extent_px;
  }
};

TEST_F(ProcessorTranslationTest, ExtentIsThatOfTheTranslation) {
  add_odometry(2.4);
  processor_.add_scene_depth(depth(kStart - 100 * kMs, 2));
  const FrameOutput& output = process(0);
  EXPECT_TRUE(output.translated);
  EXPECT_TRUE(output.reason_text.empty()) << output.reason_text;
  // focal length * speed * exposure / depth
  EXPECT_NEAR(center_extent_px(), kFocalPx * 2.4 * to_seconds(kExposure) / 2, 0.01);
  EXPECT_NE(output.image, output.input);
  EXPECT_EQ(processor_.statistics().frames_translated, 1u);
}

TEST_F(ProcessorTranslationTest, DepthComesFromTheParameterWhereNoMessageIsFresh) {
  config_.translation.scene_depth_m = 4;
  configure();
  processor_.add_scene_depth(depth(kStart - 3 * kSecond, 1));
  add_odometry(1.2);
  process(0);
  EXPECT_NEAR(center_extent_px(), kFocalPx * 1.2 * to_seconds(kExposure) / 4, 0.01);
}

TEST_F(ProcessorTranslationTest, ATwistInTheWorldIsTurnedIntoTheBody) {
  config_.translation.scene_depth_m = 2;
  config_.odometry_twist_frame = TwistFrame::PARENT;
  configure();
  for (const TimeNs t_ns : {kStart - 70 * kMs, kStart - 20 * kMs}) {
    nav_msgs::Odometry message = odometry(t_ns, 0);
    message.child_frame_id = message.header.frame_id;
    message.twist.twist.linear.z = 1.2;
    // The body's x along the world's z.
    message.pose.pose.orientation.w = message.pose.pose.orientation.y = -std::sqrt(0.5);
    message.pose.pose.orientation.w *= -1;
    processor_.add_odometry(message);
  }
  process(0);
  EXPECT_NEAR(center_extent_px(), kFocalPx * 1.2 * to_seconds(kExposure) / 2, 0.01);
}

TEST_F(ProcessorTranslationTest, StampsOfTheImusClockAreMoved) {
  config_.translation.scene_depth_m = 2;
  config_.odometry_clock = OdometryClock::IMU;
  config_.gyro.time_offset_ns = 5 * kSecond;
  configure();
  for (const TimeNs t_ns : {kStart - 70 * kMs, kStart - 20 * kMs}) {
    processor_.add_odometry(odometry(t_ns + 5 * kSecond, 1.2));
  }
  add_imu(kStart + 5 * kSecond - 300 * kMs, kStart + 5 * kSecond + 100 * kMs, 0);
  add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  EXPECT_TRUE(outputs_[0].translated) << outputs_[0].reason_text;
}

TEST_F(ProcessorTranslationTest, ABodyAtAnotherPlaceMovesTheCameraByTurning) {
  config_.translation.scene_depth_m = 2;
  config_.p_cam_imu_m = {0, 0, -0.5};  // the IMU half a metre behind the camera
  configure();
  add_odometry(0);
  process(kFastRadS);
  // The camera goes sideways at rate * 0.5 m, against the motion that the rotation alone makes.
  const double rotation_px = kFocalPx * kFastRadS * to_seconds(kExposure);
  EXPECT_NEAR(center_extent_px(), rotation_px * (1 + 0.5 / 2), 0.1);  // the block is not quite in the middle
}

// Each case leaves the frame exactly as it is without an odometry.
TEST_F(ProcessorTranslationTest, WithoutUsableOdometryNothingChanges) {
  const auto rendered = [](const Config& config, const std::function<void(Processor&)>& feed, std::string* reason) {
    TimeNs now_ns = kStart;
    Processor::Environment environment;
    environment.clock = [&now_ns] { return now_ns; };
    environment.log = [](LogLevel, const std::string&) {};
    Processor processor(std::move(environment));
    processor.set_config(config);
    feed(processor);
    for (TimeNs t_ns = kStart - 300 * kMs; t_ns <= kStart + 100 * kMs; t_ns += kImuPeriod) {
      processor.add_imu(imu_message(t_ns, kFastRadS));
    }
    processor.add_image(image_message(kStart));
    processor.add_camera_info(camera_info(kStart));
    std::vector<std::uint8_t> pixels;
    processor.advance([&](FrameOutput&& output) {
      pixels = output.image->data;
      for (const auto& list : {output.blur_field->angle, output.blur_field->extent}) {
        const auto* bytes = reinterpret_cast<const std::uint8_t*>(list.data());
        pixels.insert(pixels.end(), bytes, bytes + list.size() * sizeof(float));
      }
      for (const Keypoint& keypoint : output.keypoints->keypoints) {
        const auto* bytes = reinterpret_cast<const std::uint8_t*>(&keypoint.rectified_x);
        pixels.insert(pixels.end(), bytes, bytes + 2 * sizeof(float));
      }
      EXPECT_FALSE(output.translated);
      *reason = output.reason_text;
      return true;
    });
    return pixels;
  };
  Config with_depth = config_;
  with_depth.translation.scene_depth_m = 2;
  std::string reason;
  const std::vector<std::uint8_t> plain = rendered(
      config_, [](Processor&) {}, &reason);
  ASSERT_FALSE(plain.empty());
  EXPECT_EQ(rendered(
                with_depth, [](Processor&) {}, &reason),
            plain)
      << "a depth without an odometry";
  EXPECT_EQ(reason, "");

  const auto feed = [](const std::vector<nav_msgs::Odometry>& messages) {
    return [messages](Processor& processor) {
      for (const nav_msgs::Odometry& message : messages) processor.add_odometry(message);
    };
  };
  nav_msgs::Odometry first = odometry(kStart - 70 * kMs, 1), second = odometry(kStart - 20 * kMs, 1);
  const auto expect_plain = [&](const Config& config, const std::vector<nav_msgs::Odometry>& messages,
                                const std::string& why) {
    EXPECT_EQ(rendered(config, feed(messages), &reason), plain) << why;
    EXPECT_NE(reason.find(why), std::string::npos) << reason;
  };
  expect_plain(config_, {first, second}, "no depth of the scene");
  expect_plain(with_depth, {odometry(kStart - 400 * kMs, 1), odometry(kStart - 350 * kMs, 1)}, "odometry_max_age");
  expect_plain(with_depth, {first, odometry(kStart - 20 * kMs, 9)}, "jumps by");
  nav_msgs::Odometry uncertain_first = first, uncertain_second = second;
  uncertain_first.twist.covariance[7] = uncertain_second.twist.covariance[7] = 1;
  expect_plain(with_depth, {uncertain_first, uncertain_second}, "odometry_max_stddev");
  nav_msgs::Odometry nan_first = first, nan_second = second;
  nan_first.twist.twist.linear.y = nan_second.twist.twist.linear.y = std::numeric_limits<double>::quiet_NaN();
  expect_plain(with_depth, {nan_first, nan_second}, "no odometry");
  expect_plain(with_depth, {odometry(kStart - 70 * kMs, 20.5), odometry(kStart - 20 * kMs, 20.5)},
               "odometry_max_speed");
  nav_msgs::Odometry elsewhere_first = first, elsewhere_second = second;
  elsewhere_first.child_frame_id = elsewhere_second.child_frame_id = "base_link";
  expect_plain(with_depth, {elsewhere_first, elsewhere_second}, "no transform from the odometry's child frame");

  // The comparison sees a translation.
  Config usable = with_depth;
  usable.R_cam_imu = config_.R_cam_imu;
  TimeNs now_ns = kStart;
  Processor::Environment environment;
  environment.clock = [&now_ns] { return now_ns; };
  environment.log = [](LogLevel, const std::string&) {};
  Processor processor(std::move(environment));
  processor.set_config(usable);
  feed({first, second})(processor);
  for (TimeNs t_ns = kStart - 300 * kMs; t_ns <= kStart + 100 * kMs; t_ns += kImuPeriod) {
    processor.add_imu(imu_message(t_ns, kFastRadS));
  }
  processor.add_image(image_message(kStart));
  processor.add_camera_info(camera_info(kStart));
  processor.advance([&](FrameOutput&& output) {
    EXPECT_TRUE(output.translated) << output.reason_text;
    EXPECT_FALSE(std::equal(output.image->data.begin(), output.image->data.end(), plain.begin()));
    return true;
  });
}

TEST_F(ProcessorTranslationTest, RefusedMessagesAreCountedAndATimeJumpStartsAnew) {
  config_.translation.scene_depth_m = 2;
  configure();
  nav_msgs::Odometry wrong = odometry(kStart, 1);
  wrong.twist.covariance[0] = -1;
  processor_.add_odometry(wrong);
  processor_.add_odometry(odometry(kStart + 10 * kSecond, 1));
  processor_.add_odometry(odometry(kStart + 10 * kSecond, 1));
  EXPECT_EQ(processor_.statistics().odometry_refused, 2u);
  EXPECT_EQ(logged("covariance"), 1u);
  add_odometry(1);  // ten seconds back: a new epoch
  EXPECT_EQ(processor_.statistics().odometry_refused, 2u);
  process(0);
  EXPECT_TRUE(outputs_[0].translated) << outputs_[0].reason_text;
}

TEST_F(ProcessorTranslationTest, TheAccelerometerGoesOnAfterStrayStamps) {
  config_.translation.scene_depth_m = 2;
  // A swing sideways that only the accelerometer can follow from the odometry, which is late, to the frame.
  constexpr double kAmplitudeM = 0.1, kRateRadS = 2 * M_PI;
  constexpr TimeNs kLatency = 150 * kMs;
  const auto feed = [&](const std::vector<TimeNs>& strays) {
    outputs_.clear();
    processor_.reset();
    configure();
    for (TimeNs t_ns = kStart - 1500 * kMs; t_ns <= kStart + 100 * kMs; t_ns += kImuPeriod) {
      sensor_msgs::Imu imu = imu_message(t_ns, 0);
      imu.linear_acceleration.x =
          -kAmplitudeM * kRateRadS * kRateRadS * std::sin(kRateRadS * to_seconds(t_ns - kStart));
      imu.linear_acceleration.y = -9.81;
      processor_.add_imu(imu);
      if (t_ns == kStart - 300 * kMs) {
        for (const TimeNs stray_ns : strays) {
          imu.header.stamp = to_ros_time(stray_ns);
          processor_.add_imu(imu);
        }
      }
      if (t_ns <= kStart - kLatency && (kStart - t_ns) % (50 * kMs) == 0) {
        const double speed_m_s = kAmplitudeM * kRateRadS * std::cos(kRateRadS * to_seconds(t_ns - kStart));
        processor_.add_odometry(odometry(t_ns, speed_m_s));
      }
    }
    add_frame(kStart);
    advance();
    EXPECT_EQ(outputs_.size(), 1u);
    EXPECT_TRUE(outputs_.at(0).translated) << outputs_[0].reason_text;
    return center_extent_px();
  };
  const double expected_px = feed({});
  const double speed_m_s = kAmplitudeM * kRateRadS * std::cos(kRateRadS * to_seconds((kExposure + kReadout) / 2));
  EXPECT_NEAR(expected_px, kFocalPx * speed_m_s * to_seconds(kExposure) / 2, 0.01);
  for (const TimeNs stray_ns : {kStart + 1000 * kSecond, kStart + 500 * kMs, kStart - kSecond, TimeNs{0}}) {
    EXPECT_EQ(feed({stray_ns}), expected_px) << seconds_text(stray_ns);
  }
}

TEST_F(ProcessorTranslationTest, ADepthOutOfItsRangeIsRefused) {
  add_odometry(1.2);
  for (const float bad : {0.f, -1.f, std::numeric_limits<float>::infinity(), 51.f}) {
    processor_.add_scene_depth(depth(kStart, bad));
  }
  process(0);
  EXPECT_FALSE(outputs_[0].translated);
  EXPECT_NE(outputs_[0].reason_text.find("no depth of the scene"), std::string::npos) << outputs_[0].reason_text;
}

}  // namespace
}  // namespace gyro_deblur
