#include "ros/frame_synchronizer.hpp"

#include <algorithm>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "base/format.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "processor_test.hpp"

namespace gyro_deblur::frame_synchronizer_test {
namespace {

using namespace test;

class FrameSynchronizerTest : public ProcessorTest {};

TEST_F(FrameSynchronizerTest, FrameWaitsUntilTheGyroscopeCoversItsLastRow) {
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

TEST_F(FrameSynchronizerTest, TimeOffsetMovesTheRangeThatIsNeeded) {
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

TEST_F(FrameSynchronizerTest, WithoutGyroscopeFramesPassThroughAfterTheTimeoutInOrder) {
  add_frame(kStart);
  now_ns_ += 33 * kMs;
  add_frame(kStart + 33 * kMs);
  now_ns_ = kStart + config_.input_timeout_ns - 1;
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

Exposure exposure_message(TimeNs stamp_ns, TimeNs exposure_ns, TimeNs readout_ns = 0) {
  Exposure exposure;
  exposure.header.stamp = to_ros_time(stamp_ns);
  exposure.exposure_time.fromNSec(exposure_ns);
  exposure.readout_time.fromNSec(readout_ns);
  return exposure;
}

TEST_F(FrameSynchronizerTest, ExposureOfTheMessageGoesBeforeTheParameter) {
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

TEST_F(FrameSynchronizerTest, ExpectedExposureIsWaitedFor) {
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
  processor_.add_exposure(exposure_message(kStart + 2 * kMs, 26 * kMs));  // another image's
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  time_out();
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_EQ(outputs_[1].field->exposure_ns, kExposure) << "the parameter, after the timeout";
  EXPECT_EQ(logged("no exposure message"), 1u);
}

TEST_F(FrameSynchronizerTest, NoExposureTimeAtAll) {
  config_.shutter.exposure_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_EXPOSURE_TIME, "the exposure time is not known yet");
  exposure_expected_ = true;
  add_frame(kStart + 50 * kMs);
  advance();
  EXPECT_EQ(outputs_.size(), 1u) << "a message may still come";
  time_out();
  expect_passed_through(1, PassThroughReason::NO_EXPOSURE_TIME, "no exposure_time that fits");
}

TEST_F(FrameSynchronizerTest, ExposureMessageOutOfRangeIsNamed) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_exposure(exposure_message(kStart, -5 * kMs));
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_EXPOSURE_TIME, "-0.005");
}

TEST_F(FrameSynchronizerTest, LastExposureServesForAsLongAsItMay) {
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
  expect_passed_through(2, PassThroughReason::NO_EXPOSURE_TIME, "the exposure time is not known yet");
}

TEST_F(FrameSynchronizerTest, ExposureSettingHoldsUntilTheNext) {
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
  expect_passed_through(2, PassThroughReason::NO_EXPOSURE_TIME, "the driver's exposure setting = 33 is outside");
  processor_.add_exposure_setting(20 * kMs);
  for (int i = 3; i < 10; ++i) {
    add_frame(kStart + i * 50 * kMs);
    time_out();
  }
  EXPECT_EQ(logged("no longer wait"), 0u) << "nobody expects a message";
}

TEST_F(FrameSynchronizerTest, ExtrinsicMayComeLater) {
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

TEST_F(FrameSynchronizerTest, CameraInfoIsMatchedByStampInAnyOrder) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_camera_info(camera_info(kStart));
  processor_.add_image(image_message(kStart));
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  processor_.add_image(image_message(kStart + kMs));
  const auto next = camera_info(kStart + 2 * kMs);
  next->D[0] = 0.01;
  processor_.add_camera_info(next);
  advance();
  EXPECT_EQ(outputs_.size(), 1u) << "its neighbours differ";
  const auto info = camera_info(kStart + kMs);
  processor_.add_camera_info(info);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(outputs_[1].camera_info, info);
}

TEST_F(FrameSynchronizerTest, LostCameraInfoIsThatOfItsNeighbours) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  add_frame(kStart);
  processor_.add_image(image_message(kStart + 33 * kMs));
  advance();
  EXPECT_EQ(outputs_.size(), 1u) << "its own may still come";
  add_frame(kStart + 66 * kMs);
  advance();  // no time has passed
  ASSERT_EQ(outputs_.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) expect_deblurred(i);
  sensor_msgs::CameraInfo expected = *camera_info(kStart + 33 * kMs);
  EXPECT_EQ(*outputs_[1].camera_info, expected) << "all of it, with the image's stamp";
}

TEST_F(FrameSynchronizerTest, LostFirstCameraInfoIsThatOfTheNextTwo) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  processor_.add_image(image_message(kStart));
  add_frame(kStart + 33 * kMs);
  advance();
  EXPECT_TRUE(outputs_.empty());
  add_frame(kStart + 66 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 3u);
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].camera_info->K[0], kFocalPx);
}

/// The region of interest that a camera may change from image to image; the size stays.
sensor_msgs::CameraInfoPtr region_info(TimeNs stamp_ns, std::uint32_t y_offset_px) {
  auto info = camera_info(stamp_ns, kWidth, 2 * kHeight);
  info->roi.width = kWidth;
  info->roi.height = kHeight;
  info->roi.y_offset = y_offset_px;
  return info;
}

TEST_F(FrameSynchronizerTest, CameraInfoOutOfOrderIsWaitedForWhereNeighboursDiffer) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  processor_.add_camera_info(region_info(kStart - 33 * kMs, 0));
  processor_.add_image(image_message(kStart));
  // Behind the next two, as in the fault table.
  processor_.add_camera_info(region_info(kStart + 33 * kMs, 20));
  processor_.add_camera_info(region_info(kStart + 66 * kMs, 20));
  advance();
  EXPECT_TRUE(outputs_.empty());
  const auto own = region_info(kStart, 10);
  processor_.add_camera_info(own);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].camera_info, own);
}

TEST_F(FrameSynchronizerTest, LostCameraInfoBetweenOnesThatDifferPassesThroughWithoutTimeout) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  processor_.add_camera_info(region_info(kStart - 33 * kMs, 0));
  processor_.add_image(image_message(kStart));
  for (int i = 1; i <= 3; ++i) {
    EXPECT_TRUE(outputs_.empty());
    processor_.add_camera_info(region_info(kStart + i * 33 * kMs, 20));
    advance();
  }
  ASSERT_EQ(outputs_.size(), 1u);
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "within 1 s of it differ from each other");
  EXPECT_EQ(outputs_[0].camera_info->K[0], 0) << "whose region it is nobody knows";
}

TEST_F(FrameSynchronizerTest, NeighboursCameraInfoServesNoImageOfAnotherSize) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  add_frame(kStart);
  processor_.add_image(image_message(kStart + 33 * kMs, "mono8", kWidth, kHeight / 2));
  add_frame(kStart + 66 * kMs);
  advance();
  EXPECT_EQ(outputs_.size(), 1u);
  for (int i = 3; i <= 4; ++i) add_frame(kStart + i * 33 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 5u);
  expect_passed_through(1, PassThroughReason::NO_CALIBRATION,
                        "is for another size than 192x64 px: its size is 192x128");
  EXPECT_EQ(outputs_[1].camera_info->height, static_cast<unsigned>(kHeight / 2));
}

TEST_F(FrameSynchronizerTest, LastCameraInfoServesWhenNoneComesAfterIt) {
  add_imu(kStart - 50 * kMs, kStart + 2 * kSecond);
  add_frame(kStart);
  add_frame(kStart + 33 * kMs);
  processor_.add_image(image_message(kStart + 66 * kMs));
  advance();
  EXPECT_EQ(outputs_.size(), 2u);
  time_out();
  ASSERT_EQ(outputs_.size(), 3u);
  expect_deblurred(2);
  EXPECT_EQ(to_time_ns(outputs_[2].camera_info->header.stamp), kStart + 66 * kMs);
}

TEST_F(FrameSynchronizerTest, FramesThatPassThroughHaveTheirNeighboursCameraInfoToo) {
  add_frame(kStart);
  processor_.add_image(image_message(kStart + 33 * kMs));
  add_frame(kStart + 66 * kMs);
  auto unsupported = image_message(kStart + 99 * kMs);
  unsupported->encoding = "nonsense";
  processor_.add_image(unsupported);
  time_out();
  ASSERT_EQ(outputs_.size(), 4u);
  for (const std::size_t i : {1u, 3u}) {
    EXPECT_EQ(outputs_[i].camera_info->K[0], kFocalPx) << i;
    EXPECT_EQ(outputs_[i].camera_info->header.stamp, outputs_[i].input->header.stamp) << i;
  }
}

TEST_F(FrameSynchronizerTest, LostExposureIsThatOfItsNeighbours) {
  config_.shutter.exposure_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  for (int i = 0; i < 3; ++i) {
    if (i != 1) processor_.add_exposure(exposure_message(kStart + i * 33 * kMs, 20 * kMs));
    add_frame(kStart + i * 33 * kMs);
  }
  advance();
  ASSERT_EQ(outputs_.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) expect_deblurred(i);
  EXPECT_EQ(outputs_[1].field->exposure_ns, 20 * kMs);
}

TEST_F(FrameSynchronizerTest, LostExposureBetweenOnesThatDifferCostsTwoFrames) {
  config_.exposure_max_age_ns = 50 * kMs;
  configure();
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(outputs_.size(), i < 3 ? std::min<std::size_t>(static_cast<std::size_t>(i), 1) : 1u);
    if (i != 1) processor_.add_exposure(exposure_message(kStart + i * 33 * kMs, (10 + i) * kMs));
    add_frame(kStart + i * 33 * kMs);
    advance();
  }
  ASSERT_EQ(outputs_.size(), 4u);
  EXPECT_EQ(outputs_[1].field->exposure_ns, 10 * kMs) << "the one before, as exposure_max_age says";
}

TEST_F(FrameSynchronizerTest, SilentExposureTopicIsNotWaitedForForEver) {
  exposure_expected_ = true;
  constexpr TimeNs kPeriod = 33 * kMs;
  constexpr int kFrames = 40;
  add_imu(kStart - 50 * kMs, kStart + kFrames * kPeriod + kSecond);
  std::vector<TimeNs> latencies_ns;
  const auto play = [&](int from, int to, bool spoken) {
    for (int i = from; i < to; ++i) {
      now_ns_ = kStart + i * kPeriod;
      add_frame(kStart + i * kPeriod);
      advance();
      // The message comes a little after its image.
      now_ns_ += 5 * kMs;
      if (spoken) processor_.add_exposure(exposure_message(kStart + i * kPeriod, 20 * kMs));
      advance();
      for (std::size_t k = latencies_ns.size(); k < outputs_.size(); ++k) {
        latencies_ns.push_back(now_ns_ - to_time_ns(outputs_[k].input->header.stamp));
      }
    }
  };
  play(0, kFrames / 2, false);
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames / 2));
  EXPECT_GE(latencies_ns[0], config_.input_timeout_ns);
  EXPECT_EQ(latencies_ns.back(), 5 * kMs) << "looked at once more when its message would have come";
  EXPECT_EQ(logged("images no longer wait"), 1u);
  EXPECT_EQ(outputs_.back().field->exposure_ns, kExposure);
  // Somebody speaks: each waits for its own again.
  play(kFrames / 2, kFrames, true);
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames));
  EXPECT_EQ(outputs_[kFrames / 2].field->exposure_ns, kExposure);
  EXPECT_EQ(outputs_[kFrames / 2 + 1].field->exposure_ns, 20 * kMs);
  EXPECT_EQ(outputs_.back().field->exposure_ns, 20 * kMs);
  EXPECT_EQ(logged("images no longer wait"), 1u);
}

TEST_F(FrameSynchronizerTest, SparseExposuresHoldNoFrameUp) {
  config_.exposure_max_age_ns = kSecond;
  config_.shutter.exposure_ns = 0;
  configure();
  constexpr TimeNs kPeriod = 33 * kMs;
  constexpr int kFrames = 100, kSettled = 30, kSparse = 10;
  add_imu(kStart - 50 * kMs, kStart + kFrames * kPeriod + kSecond);
  for (int i = 0; i < kFrames; ++i) {
    now_ns_ = kStart + i * kPeriod;
    const TimeNs exposure_ns = (10 + i / kSparse) * kMs;  // it changes, too
    if (i % kSparse == 0) processor_.add_exposure(exposure_message(now_ns_, exposure_ns));
    add_frame(now_ns_);
    advance();
    if (i < kSettled) continue;
    ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(i + 1)) << "at once";
    EXPECT_EQ(outputs_.back().field->exposure_ns, exposure_ns);
  }
  EXPECT_EQ(logged("images no longer wait"), 1u);
}

TEST_F(FrameSynchronizerTest, WithoutAnyCameraInfoFramesDoNotWaitForEver) {
  constexpr int kFrames = 30;
  for (int i = 0; i < kFrames; ++i) {
    now_ns_ = kStart + i * 33 * kMs;
    processor_.add_image(image_message(now_ns_));
    advance();
  }
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames));
  expect_passed_through(kFrames - 1, PassThroughReason::NO_CALIBRATION, "no camera_info");
  EXPECT_EQ(logged("images no longer wait"), 1u);
}

TEST_F(FrameSynchronizerTest, WithoutCameraInfoImagesStillPass) {
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

TEST_F(FrameSynchronizerTest, CalibrationFileServesWhereThereIsNoCameraInfo) {
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

// Its lens has no coefficients in a camera_info, neither in the one that is published nor in a driver's.
TEST_F(FrameSynchronizerTest, CalibrationFileServesWhereCameraInfoCannotHaveTheLens) {
  config_.calibration = calibration_file();
  config_.calibration->camera->model = "ds";
  config_.calibration->camera->coefficients = {-0.2, 0.6};
  configure();
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  processor_.add_image(image_message(kStart));
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].camera_info->distortion_model, "ds");
  EXPECT_TRUE(outputs_[0].camera_info->D.empty());

  auto info = boost::make_shared<sensor_msgs::CameraInfo>(*outputs_[0].camera_info);
  info->header.stamp = ros::Time().fromNSec(static_cast<std::uint64_t>(kStart + 50 * kMs));
  processor_.add_camera_info(info);
  processor_.add_image(image_message(kStart + 50 * kMs));
  advance();
  expect_deblurred(1);
  EXPECT_EQ(*outputs_[1].camera_info, *info);

  config_.calibration.reset();
  configure();
  auto alone = boost::make_shared<sensor_msgs::CameraInfo>(*info);
  alone->header.stamp = ros::Time().fromNSec(static_cast<std::uint64_t>(kStart + 100 * kMs));
  processor_.add_camera_info(alone);
  processor_.add_image(image_message(kStart + 100 * kMs));
  advance();
  expect_passed_through(2, PassThroughReason::NO_CALIBRATION, "set calibration_file");
}

TEST_F(FrameSynchronizerTest, WithACalibrationFileNobodyMissesCameraInfo) {
  config_.calibration = calibration_file();
  configure();
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  for (int i = 0; i < 20; ++i) {
    processor_.add_image(image_message(kStart + i * 33 * kMs));
    time_out();
  }
  expect_deblurred(19);
  EXPECT_EQ(logged("no longer wait"), 0u);
}

TEST_F(FrameSynchronizerTest, FrameThatStillWaitsGoesByItsOwnCameraInfoThatComesAfterIt) {
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

TEST_F(FrameSynchronizerTest, FrameWithoutCameraInfoGoesByTheFileThoughALaterOneHasIt) {
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

TEST_F(FrameSynchronizerTest, ImageOfAnotherSizeThanTheFileWaitsForItsCameraInfo) {
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

/// A driver that does not know its calibration: all zeros but size, region and binning.
sensor_msgs::CameraInfoPtr uncalibrated_info(TimeNs stamp_ns) {
  auto info = boost::make_shared<sensor_msgs::CameraInfo>();
  info->header = camera_info(stamp_ns)->header;
  info->width = kWidth;
  info->height = kHeight;
  return info;
}

TEST_F(FrameSynchronizerTest, UncalibratedCameraInfoContradictsNoFile) {
  config_.calibration = calibration_file();
  configure();
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  const auto info = uncalibrated_info(kStart);
  processor_.add_image(image_message(kStart));
  processor_.add_camera_info(info);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].camera_info, info) << "the input's own";
  const auto region = uncalibrated_info(kStart + 33 * kMs);
  region->roi.y_offset = 30;
  region->roi.width = kWidth;
  region->roi.height = kHeight / 2;
  processor_.add_image(image_message(kStart + 33 * kMs, "mono8", kWidth, kHeight / 2));
  processor_.add_camera_info(region);
  advance();
  expect_deblurred(1);
  EXPECT_EQ(outputs_[1].field->readout_ns, kReadout / 2) << "its region applies";
}

TEST_F(FrameSynchronizerTest, UncalibratedCameraInfoWithoutAFileIsReportedWithTheRemedies) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  processor_.add_image(image_message(kStart));
  processor_.add_camera_info(uncalibrated_info(kStart));
  advance();
  for (const char* part : {"K are (0, 0)", "camera_calibration", "calibration_file"}) {
    expect_passed_through(0, PassThroughReason::NO_CALIBRATION, part);
  }
}

TEST_F(FrameSynchronizerTest, CameraInfoWithoutAStampServesAllImages) {
  constexpr int kFrames = 20;
  add_imu(kStart - 50 * kMs, kStart + kFrames * 33 * kMs + kSecond);
  for (int i = 0; i < kFrames; ++i) {
    now_ns_ = kStart + i * 33 * kMs;
    processor_.add_image(image_message(now_ns_));
    processor_.add_camera_info(camera_info(0));
    advance();
    ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(i + 1)) << "at once";
    expect_deblurred(static_cast<std::size_t>(i));
    sensor_msgs::CameraInfo expected = *camera_info(now_ns_);
    EXPECT_EQ(*outputs_.back().camera_info, expected) << "all of it, with the image's stamp";
  }
  EXPECT_EQ(logged("camera_info has the stamp 0"), 1u);
  EXPECT_EQ(log_.size(), 1u) << log_.back();
  EXPECT_TRUE(processor_.statistics().input_problems.at("camera_info stamp").active);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u);
  add_frame(now_ns_ + 33 * kMs);
  EXPECT_FALSE(processor_.statistics().input_problems.at("camera_info stamp").active) << "the driver has been repaired";
}

TEST_F(FrameSynchronizerTest, NewestCameraInfoWithoutAStampHolds) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  processor_.add_camera_info(camera_info(0));
  processor_.add_image(image_message(kStart));
  auto moved = camera_info(0);
  moved->K[0] = moved->K[4] = 2 * kFocalPx;
  advance();
  processor_.add_camera_info(moved);
  processor_.add_image(image_message(kStart + 33 * kMs));
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_EQ(outputs_[0].camera_info->K[0], kFocalPx);
  EXPECT_EQ(outputs_[1].camera_info->K[0], 2 * kFocalPx);
}

TEST_F(FrameSynchronizerTest, StrayCameraInfoWithoutAStampChangesNothing) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  for (int i = 0; i < 3; ++i) add_frame(kStart + i * 33 * kMs);
  auto other = camera_info(0);
  other->K[0] = 7;
  processor_.add_camera_info(other);
  processor_.add_image(image_message(kStart + 99 * kMs));
  advance();
  EXPECT_EQ(outputs_.size(), 3u) << "each image still waits for its own";
  processor_.add_camera_info(camera_info(kStart + 99 * kMs));
  advance();
  ASSERT_EQ(outputs_.size(), 4u);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(outputs_[i].camera_info->K[0], kFocalPx);
}

/// A camera_info that is sent once, then another.
class LatchedCameraInfoTest : public FrameSynchronizerTest {
 protected:
  static constexpr TimeNs kPeriod = 33 * kMs;
  /// With the samples of each image before it.
  void play(int from, int to) {
    for (int i = from; i < to; ++i) {
      now_ns_ = kStart + i * kPeriod;
      for (; next_imu_ns_ <= now_ns_ + 2 * kPeriod; next_imu_ns_ += kImuPeriod) {
        processor_.add_imu(imu_message(next_imu_ns_, kFastRadS));
      }
      processor_.add_image(image_message(now_ns_));
      advance();
    }
  }
  TimeNs next_imu_ns_ = kStart - 50 * kMs;
};

TEST_F(LatchedCameraInfoTest, ServesAllImages) {
  // Before the first image, with its stamp, or behind some.
  for (const TimeNs stamp_ns : {kStart - 10 * kSecond, kStart, kStart + 3 * kPeriod}) {
    SCOPED_TRACE(seconds_text(stamp_ns));
    outputs_.clear();
    log_.clear();
    now_ns_ = kStart;
    Processor fresh(environment());
    fresh.set_config(config_);
    for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= kStart + 60 * kPeriod; t_ns += kImuPeriod) {
      fresh.add_imu(imu_message(t_ns, kFastRadS));
    }
    for (int i = 0; i < 40; ++i) {
      now_ns_ = kStart + i * kPeriod;
      if (i == 0 && stamp_ns <= kStart) fresh.add_camera_info(camera_info(stamp_ns));
      fresh.add_image(image_message(now_ns_));
      if (i > 0 && stamp_ns == now_ns_) fresh.add_camera_info(camera_info(stamp_ns));
      fresh.advance([this](FrameOutput&& output) {
        outputs_.push_back(std::move(output));
        return true;
      });
    }
    ASSERT_EQ(outputs_.size(), 40u) << "the last ones do not wait";
    for (std::size_t i = 0; i < 40; ++i) {
      expect_deblurred(i);
      EXPECT_EQ(outputs_[i].camera_info->header.stamp, outputs_[i].input->header.stamp);
    }
    EXPECT_EQ(logged("images no longer wait"), 1u);
  }
}

TEST_F(LatchedCameraInfoTest, NextOneReplacesIt) {
  processor_.add_camera_info(camera_info(kStart));
  play(0, 30);
  auto other = camera_info(kStart + 30 * kPeriod);
  other->K[0] = other->K[4] = 2 * kFocalPx;
  processor_.add_camera_info(other);
  play(30, 60);
  ASSERT_EQ(outputs_.size(), 60u);
  for (std::size_t i = 0; i < 60; ++i) {
    expect_deblurred(i);
    EXPECT_EQ(outputs_[i].camera_info->K[0], (i < 30 ? 1 : 2) * kFocalPx) << i;
  }
}

TEST_F(LatchedCameraInfoTest, ResetsOfTimeAndOfTheNodeKeepIt) {
  processor_.add_camera_info(camera_info(kStart));
  play(0, 30);
  processor_.reset();
  play(40, 70);
  next_imu_ns_ = now_ns_ = kStart - 50 * kMs;  // a bag that loops
  play(0, 30);
  time_out();
  ASSERT_EQ(outputs_.size(), 90u);
  for (std::size_t i = 0; i < 90; ++i) expect_deblurred(i);
}

TEST_F(LatchedCameraInfoTest, ServesNoImageOfAnotherSize) {
  processor_.add_camera_info(camera_info(kStart, kWidth, 2 * kHeight));
  play(0, 30);
  time_out();
  expect_passed_through(29, PassThroughReason::NO_CALIBRATION, "192x128 px: its size is 192x256");
}

TEST_F(FrameSynchronizerTest, SizeThatIsNotFilledInIsTheImages) {
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  for (int i = 0; i < 3; ++i) {
    const auto info = camera_info(kStart + i * 33 * kMs);
    info->width = info->height = 0;
    processor_.add_image(image_message(kStart + i * 33 * kMs));
    processor_.add_camera_info(info);
  }
  advance();
  ASSERT_EQ(outputs_.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    expect_deblurred(i);
    EXPECT_EQ(outputs_[i].camera_info->width, 0u) << "the input's own";
  }
  EXPECT_EQ(outputs_[0].field->readout_ns, kReadout);
  EXPECT_EQ(logged("width and height 0"), 1u);
}

TEST_F(FrameSynchronizerTest, ReasonSaysWhatCameraInfoThereIs) {
  add_imu(kStart - 50 * kMs, kStart + 20 * kSecond);
  processor_.add_image(image_message(kStart));
  time_out();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, ", nor any other");
  // Two in a row, so that each may be of a region of its own.
  const auto add_with_region = [this](TimeNs stamp_ns, std::uint32_t y_offset_px) {
    processor_.add_image(image_message(stamp_ns));
    processor_.add_camera_info(region_info(stamp_ns, y_offset_px));
  };
  for (std::uint32_t i = 0; i < 3; ++i) add_with_region(kStart + kSecond + i * 33 * kMs, i);
  processor_.add_image(image_message(kStart + 10 * kSecond));
  advance();
  time_out();
  ASSERT_EQ(outputs_.size(), 5u);
  expect_passed_through(4, PassThroughReason::NO_CALIBRATION, "and none within 1 s of it");
  add_with_region(kStart + 11 * kSecond, 5);
  processor_.add_image(image_message(kStart + 11 * kSecond + 33 * kMs));
  advance();
  time_out();
  ASSERT_EQ(outputs_.size(), 7u);
  expect_passed_through(6, PassThroughReason::NO_CALIBRATION, "a single one within 1 s of it");
}

TEST_F(FrameSynchronizerTest, UsableCameraInfoServesAfterUnusableOnes) {
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

TEST_F(FrameSynchronizerTest, CameraInfoThatContradictsTheFileIsPrintedWithIt) {
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

TEST_F(FrameSynchronizerTest, RegionOfInterestOfCameraInfoAppliesToTheFile) {
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

TEST_F(FrameSynchronizerTest, TransformThatContradictsTheParameterIsPrintedWithIt) {
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

TEST_F(FrameSynchronizerTest, ReadoutLongerThanTheFramePeriodIsNamed) {
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs);
  constexpr TimeNs kPeriod = kReadout / 2;
  config_.shutter.exposure_ns = kPeriod;
  configure();
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

TEST_F(FrameSynchronizerTest, ReadoutOfAPeriodPassesWhenEveryPictureComesTwice) {
  config_.shutter.exposure_ns = kReadout;  // no longer than the period, either
  configure();
  add_imu(kStart - 50 * kMs, kStart + 2 * kSecond);
  for (int i = 0; i < 50; ++i) {
    add_repetition(*add_frame(kStart + i * kReadout), kStart + i * kReadout + kReadout / 2);
    advance();
  }
  ASSERT_EQ(outputs_.size(), 100u);
  for (std::size_t i = 0; i < outputs_.size(); ++i) expect_deblurred(i);
}

TEST_F(FrameSynchronizerTest, ReadoutOfAPeriodPassesWhenFramesAreStampedInPairs) {
  config_.shutter.readout_ns = 33'300'000;
  configure();
  constexpr TimeNs kPeriod = 33'333'333;
  for (int i = 0; i < 100; ++i) {
    add_frame(kStart + i / 2 * 2 * kPeriod + i % 2 * kMs);
    time_out();
    expect_passed_through(static_cast<std::size_t>(i), PassThroughReason::NO_GYRO, "there are none");
  }
}

TEST_F(FrameSynchronizerTest, UnusableCameraInfoIsNamedAtOnce) {
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

TEST_F(FrameSynchronizerTest, RegionOfInterestShortensTheReadout) {
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

TEST_F(FrameSynchronizerTest, FrameThatCannotBePreparedDoesNotHoldUpOthers) {
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

}  // namespace
}  // namespace gyro_deblur::frame_synchronizer_test
