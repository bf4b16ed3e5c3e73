#include <algorithm>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "processor_test.hpp"

#include "gyro_deblur/frame_blur.hpp"
#include "rotating_camera.hpp"

namespace gyro_deblur::processor_global_shutter_test {
namespace {

using namespace test;

/// The middle of the middle row's exposure; row (N - 1) / 2 begins half a row before the middle of the readout.
constexpr TimeNs kToReference = kReadout * (kHeight - 1) / (2 * kHeight) + kExposure / 2;

class ProcessorGlobalShutterTest : public ProcessorTest {
 protected:
  ProcessorGlobalShutterTest() : ProcessorTest(true) { request_.global_shutter = true; }

  TimeNs moved_ns(std::size_t index) const { return to_time_ns(outputs_.at(index).global_shutter->header.stamp); }
  void expect_moved(std::size_t index) const {
    const FrameOutput& output = outputs_.at(index);
    ASSERT_NE(output.global_shutter, nullptr);
    EXPECT_EQ(moved_ns(index), to_time_ns(output.input->header.stamp) + kToReference);
    EXPECT_EQ(output.global_shutter->header.frame_id, output.input->header.frame_id);
    EXPECT_NE(output.global_shutter->data, output.image->data);
    sensor_msgs::CameraInfo info = *output.global_shutter_info;
    EXPECT_EQ(info.header.stamp, output.global_shutter->header.stamp);
    info.header.stamp = output.camera_info->header.stamp;
    EXPECT_EQ(info, *output.camera_info) << "nothing but the stamp is another";
  }
  void expect_unmoved(std::size_t index) const {
    const FrameOutput& output = outputs_.at(index);
    EXPECT_EQ(output.global_shutter, output.input) << "the very message that came in";
    EXPECT_EQ(output.global_shutter_info, output.camera_info);
  }
};

TEST_F(ProcessorGlobalShutterTest, CarriesTheInstantOfItsRows) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  expect_moved(0);
  EXPECT_EQ(outputs_[0].global_shutter->encoding, "mono8");
  EXPECT_EQ(outputs_[0].keypoints->reference_time, outputs_[0].global_shutter->header.stamp);
  EXPECT_GT(outputs_[0].times.global_shutter_ms, 0);
}

TEST_F(ProcessorGlobalShutterTest, NeedsNoOtherOutput) {
  request_.image = request_.keypoints = false;
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  const auto input = add_frame(kStart);
  advance();
  ASSERT_EQ(outputs_.size(), 1u);
  ASSERT_NE(outputs_[0].global_shutter, nullptr);
  EXPECT_EQ(moved_ns(0), kStart + kToReference);
  EXPECT_EQ(outputs_[0].image, input);
  EXPECT_EQ(outputs_[0].keypoints, nullptr);
  request_.global_shutter = false;
  add_imu(kStart + 105 * kMs, kStart + 200 * kMs);
  add_frame(kStart + 100 * kMs);
  advance();
  EXPECT_EQ(outputs_.at(1).global_shutter, nullptr);
  EXPECT_EQ(outputs_[1].global_shutter_info, nullptr);
}

TEST_F(ProcessorGlobalShutterTest, EncodingsStayAndMosaicsBecomeColours) {
  const std::pair<std::string, std::string> encodings[] = {
      {"mono8", "mono8"}, {"mono16", "mono16"}, {"rgb8", "rgb8"},        {"bgr8", "bgr8"},
      {"bgra8", "bgra8"}, {"8UC1", "8UC1"},     {"bayer_rggb8", "bgr8"}, {"bayer_grbg16", "bgr16"}};
  add_imu(kStart - 50 * kMs, kStart + 2 * kSecond);
  TimeNs stamp_ns = kStart;
  for (const auto& [encoding, expected] : encodings) {
    processor_.add_image(image_message(stamp_ns, encoding));
    processor_.add_camera_info(camera_info(stamp_ns));
    advance();
    expect_moved(outputs_.size() - 1);
    const sensor_msgs::Image& image = *outputs_.back().global_shutter;
    EXPECT_EQ(image.encoding, expected);
    EXPECT_EQ(image.width, static_cast<unsigned>(kWidth));
    EXPECT_EQ(image.step, view_image(image).image.elemSize() * kWidth);
    EXPECT_EQ(outputs_.back().image->encoding, encoding) << "the deblurred image stays what it was";
    stamp_ns += 100 * kMs;
  }
}

TEST_F(ProcessorGlobalShutterTest, WhatPassesThroughKeepsItsStamp) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  add_frame(kStart + 400 * kMs);
  time_out();
  expect_moved(0);
  expect_passed_through(1, PassThroughReason::NO_GYRO, "");
  expect_unmoved(1);
  // Nor does a frame that its stereo partner keeps from being deblurred.
  add_imu(kStart + 700 * kMs, kStart + 900 * kMs);
  add_frame(kStart + 800 * kMs);
  advance_refused(kStart + 800 * kMs);
  expect_passed_through(2, PassThroughReason::STEREO_PARTNER, "/cam1 passes this image through: NO_CALIBRATION");
  expect_unmoved(2);
}

TEST_F(ProcessorGlobalShutterTest, AFrameWithoutCameraInfoPassesWithOne) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_image(image_message(kStart));
  time_out();
  expect_passed_through(0, PassThroughReason::NO_CALIBRATION, "");
  expect_unmoved(0);
}

TEST_F(ProcessorGlobalShutterTest, AStillCameraIsMovedByNothing) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs, 0.0);
  add_frame(kStart);
  advance();
  EXPECT_EQ(moved_ns(0), kStart + kToReference);
  EXPECT_EQ(outputs_[0].global_shutter->data, outputs_[0].input->data);
}

TEST_F(ProcessorGlobalShutterTest, AGlobalShutterIsStampedAndUnchanged) {
  config_.shutter.readout_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  EXPECT_EQ(moved_ns(0), kStart + kExposure / 2);
  EXPECT_EQ(outputs_[0].global_shutter->data, outputs_[0].image->data);
  EXPECT_NE(outputs_[0].global_shutter->data, outputs_[0].input->data);
}

// At 30 Hz, to the last row: 30 ms + 20 ms after the stamp, and the next one passes through with its own.
TEST_F(ProcessorGlobalShutterTest, StampsNeverGoBack) {
  config_.pipeline.rectify_to = RectifyTo::LAST_ROW;
  config_.shutter.exposure_ns = 33 * kMs;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  ASSERT_GT(moved_ns(0), kStart + 33 * kMs);
  add_frame(kStart + 33 * kMs);
  advance_refused(kStart + 33 * kMs);
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_EQ(outputs_[1].global_shutter, nullptr);
  EXPECT_EQ(outputs_[1].global_shutter_info, nullptr);
  EXPECT_EQ(outputs_[1].image, outputs_[1].input) << "every other output has the frame";
  EXPECT_EQ(logged("has no global-shutter image"), 1u);
  add_imu(kStart + 105 * kMs, kStart + 300 * kMs);
  add_frame(kStart + 66 * kMs);
  advance();
  ASSERT_NE(outputs_.at(2).global_shutter, nullptr);
  EXPECT_GT(moved_ns(2), moved_ns(0));
}

TEST_F(ProcessorGlobalShutterTest, TracksCarryTheInstantTheyAreMovedTo) {
  request_.global_shutter = false;
  request_.tracks = request_.global_shutter_tracks = true;
  for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= kStart + 400 * kMs; t_ns += kImuPeriod) {
    processor_.add_imu(imu_message(t_ns, 0));
  }
  for (const TimeNs stamp_ns : {kStart, kStart + 100 * kMs, kStart + 200 * kMs}) add_frame(stamp_ns);
  advance();
  ASSERT_EQ(outputs_.size(), 3u);
  for (std::size_t i = 0; i < outputs_.size(); ++i) {
    const FrameOutput& output = outputs_[i];
    ASSERT_TRUE(output.tracks && output.global_shutter_tracks);
    EXPECT_EQ(output.tracks->header.stamp, output.input->header.stamp);
    EXPECT_EQ(to_time_ns(output.global_shutter_tracks->header.stamp),
              to_time_ns(output.input->header.stamp) + kToReference);
    EXPECT_EQ(output.global_shutter_tracks->header.frame_id, output.input->header.frame_id);
    EXPECT_EQ(output.global_shutter, nullptr);
    // A camera at rest: the same places.
    ASSERT_EQ(output.global_shutter_tracks->points.size(), output.tracks->points.size());
    for (std::size_t k = 0; k < output.tracks->points.size(); ++k) {
      EXPECT_EQ(output.global_shutter_tracks->channels[0].values[k], output.tracks->channels[0].values[k]);
      EXPECT_NEAR(output.global_shutter_tracks->points[k].x, output.tracks->points[k].x, 1e-3);
      EXPECT_NEAR(output.global_shutter_tracks->points[k].y, output.tracks->points[k].y, 1e-3);
    }
  }
  EXPECT_FALSE(outputs_[2].tracks->points.empty());
}

/// Nine of ten are below.
double quantile_90(std::vector<double> values) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 9 / 10);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// A camera that rotates, with a rolling shutter, all of it known but whether there is a gyroscope.
class RollingTracksTest : public testing::Test {
 protected:
  void play(bool with_gyro) {
    constexpr int kFrames = 14;
    Config config;
    config.shutter.exposure_ns = RotatingCamera::kShownFor;
    config.shutter.readout_ns = kReadout;
    config.gyro.time_offset_ns = RotatingCamera::kTimeOffset;
    config.gyro.bias_rad_s = RotatingCamera::bias_rad_s();
    config.R_cam_imu = RotatingCamera::R_cam_imu();
    config.given = {true, true, true, true};
    config.pipeline.blur_field.block_size_px = 32;
    TimeNs now_ns = 0;
    Processor::Environment environment;
    environment.clock = [&now_ns] { return now_ns; };
    environment.log = [](LogLevel, const std::string&) {};
    environment.request = [] {
      FrameRequest request;
      request.keypoints = false;
      request.tracks = request.global_shutter_tracks = true;
      return request;
    };
    Processor processor(std::move(environment));
    processor.set_config(config);
    for (int frame = 0; frame < kFrames; ++frame) {
      now_ns = camera_.stamp(frame) + 100 * kMs;
      for (const sensor_msgs::Imu& sample : camera_.samples_before(frame)) {
        if (with_gyro) processor.add_imu(sample);
      }
      processor.add_camera_info(camera_.info(frame));
      processor.add_image(camera_.image(frame));
      const auto keep = [this](FrameOutput&& output) {
        outputs_.push_back(std::move(output));
        return true;
      };
      with_gyro ? processor.advance(keep) : processor.finish(keep);
    }
    ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames));
  }

  /// Distances of the moved tracks of an image from where their scene points are at its reference time.
  void compare(std::size_t index) {
    const int frame = static_cast<int>(index);
    const FrameOutput& output = outputs_[index];
    ASSERT_TRUE(output.tracks && output.global_shutter_tracks);
    const sensor_msgs::PointCloud &raw = *output.tracks, &moved = *output.global_shutter_tracks;
    const TimeNs reference_ns = camera_.truth().reference_time(frame);
    EXPECT_EQ(to_time_ns(moved.header.stamp), reference_ns);
    const sim::Pose pose = camera_.truth().pose(reference_ns);
    const auto pixel_of = [](const sensor_msgs::PointCloud& tracks, std::size_t i) {
      return Eigen::Vector2d(tracks.channels[1].values[i], tracks.channels[2].values[i]);
    };
    for (std::size_t i = 0, k = 0; i < raw.points.size() && k < moved.points.size(); ++i) {
      if (raw.channels[0].values[i] != moved.channels[0].values[k]) continue;
      const Eigen::Vector2d raw_px = pixel_of(raw, i), moved_px = pixel_of(moved, k++);
      const auto point_m = camera_.truth().scene_point(frame, raw_px);
      if (!point_m) continue;
      const Eigen::Vector2d truth_px =
          camera_.truth().camera().project(pose.R_world_cam.conjugate() * (*point_m - pose.p_world_m));
      errors_px_.push_back((moved_px - truth_px).norm());
      unmoved_px_.push_back((raw_px - truth_px).norm());
    }
  }

  RotatingCamera camera_{kReadout};
  std::vector<FrameOutput> outputs_;
  std::vector<double> errors_px_, unmoved_px_;
};

TEST_F(RollingTracksTest, AreWhereTheSceneIsAtTheirStamp) {
  ASSERT_NO_FATAL_FAILURE(play(true));
  for (std::size_t index = 4; index < outputs_.size(); ++index) ASSERT_NO_FATAL_FAILURE(compare(index));
  ASSERT_GT(errors_px_.size(), 100u);
  EXPECT_LT(quantile_90(errors_px_), 0.1);
  EXPECT_GT(quantile_90(unmoved_px_), 10 * quantile_90(errors_px_));
}

TEST_F(RollingTracksTest, AreMovedByOpticalFlowWithoutAGyroscope) {
  ASSERT_NO_FATAL_FAILURE(play(false));
  for (std::size_t index = 4; index < outputs_.size(); ++index) {
    ASSERT_TRUE(outputs_[index].field && outputs_[index].field->images_alone) << index;
    ASSERT_NO_FATAL_FAILURE(compare(index));
  }
  ASSERT_GT(errors_px_.size(), 100u);
  EXPECT_GT(quantile_90(unmoved_px_), 3 * quantile_90(errors_px_));
}

TEST_F(ProcessorGlobalShutterTest, TracksNeedNoListenerOfTheOthers) {
  request_.tracks = request_.global_shutter_tracks = true;
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  request_.tracks = false;
  add_imu(kStart + 105 * kMs, kStart + 200 * kMs);
  add_frame(kStart + 100 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_EQ(outputs_[1].tracks, nullptr);
  ASSERT_NE(outputs_[1].global_shutter_tracks, nullptr);
  EXPECT_EQ(outputs_[1].global_shutter_tracks->header.stamp, outputs_[1].global_shutter->header.stamp);
}

TEST_F(ProcessorGlobalShutterTest, StampsOfTracksNeverGoBack) {
  config_.pipeline.rectify_to = RectifyTo::LAST_ROW;
  config_.shutter.exposure_ns = 33 * kMs;
  configure();
  request_.global_shutter_tracks = true;
  add_imu(kStart - 50 * kMs, kStart + 300 * kMs);
  add_frame(kStart);
  advance();
  config_.pipeline.rectify_to = RectifyTo::STAMP;
  configure();
  add_frame(kStart + 33 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  EXPECT_NE(outputs_[0].global_shutter_tracks, nullptr);
  EXPECT_EQ(outputs_[1].global_shutter_tracks, nullptr);
  EXPECT_EQ(outputs_[1].global_shutter, nullptr);
}

// A bag that is played again: time begins anew.
TEST_F(ProcessorGlobalShutterTest, StampsGoBackWhereTimeDoes) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  processor_.reset();
  now_ns_ = kStart - 10 * kSecond;
  add_imu(now_ns_ - 50 * kMs, now_ns_ + 100 * kMs);
  add_frame(now_ns_);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_moved(1);
}

}  // namespace
}  // namespace gyro_deblur::processor_global_shutter_test
