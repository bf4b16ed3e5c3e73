// Frames of a camera whose rotation, time offset, readout time and bias nobody has given, or given wrongly.
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "calibrate/stored_calibration.hpp"
#include "gyro_deblur/exposure.hpp"
#include "ros/processor.hpp"
#include "ros/self_calibrator.hpp"
#include "rotating_camera.hpp"
#include "sync/calibration_in_use.hpp"

namespace gyro_deblur::unknown_calibration_test {
namespace {

using namespace test;

RotatingCamera& camera() {
  static RotatingCamera camera;
  return camera;
}

class UnknownCalibration : public testing::Test {
 protected:
  UnknownCalibration() {
    config_.shutter.exposure_ns = RotatingCamera::kShownFor;
    config_.given = {false, false, false};
    config_.pipeline.blur_field.block_size_px = 32;
    config_.pipeline.keypoints.detector = "FAST";
    config_.pipeline.keypoints.descriptor = "NONE";
    camera().rewind();
  }

  void start() {
    Processor::Environment environment;
    environment.clock = [this] { return now_ns_; };
    environment.log = [this](LogLevel, const std::string& text) { log_.push_back(text); };
    environment.extrinsic = [this](const std::string&, const std::string&) { return tf_; };
    if (stored_) {
      environment.stored_calibration = [this](int, int) {
        ++reads_;
        return stored_;
      };
    }
    environment.request = [] {
      FrameRequest request;
      request.keypoints = false;
      return request;
    };
    processor_ = std::make_unique<Processor>(std::move(environment));
    processor_->set_config(config_);
  }

  /// Frames [from, to) go in and come out.
  void play(int from, int to) {
    for (int i = from; i < to; ++i) {
      now_ns_ = camera().stamp(i) + config_.input_timeout_ns;
      for (const sensor_msgs::Imu& imu : camera().samples_before(i)) processor_->add_imu(imu);
      processor_->add_image(camera().image(i));
      const sensor_msgs::CameraInfoPtr info = camera().info(i);
      if (i < calibrated_from_) info->K.fill(0);
      processor_->add_camera_info(info);
      now_ns_ += config_.input_timeout_ns;
      processor_->advance([this](FrameOutput&& output) {
        outputs_.push_back(std::move(output));
        return true;
      });
    }
    ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(to));
  }
  void play() { play(0, RotatingCamera::kFrames); }

  CalibrationRow row(const std::string& key) const {
    for (const CalibrationRow& row : processor_->statistics().calibration) {
      if (row.key == key) return row;
    }
    ADD_FAILURE() << "no row " << key;
    return {};
  }
  std::string problem(const std::string& key) const {
    const auto problems = processor_->statistics().input_problems;
    const auto found = problems.find(key + " by images");
    return found == problems.end() || !found->second.active ? "" : found->second.text;
  }
  std::size_t logged(const std::string& part) const {
    std::size_t count = 0;
    for (const std::string& line : log_) count += line.find(part) != std::string::npos ? 1 : 0;
    return count;
  }

  Config config_;
  std::optional<Eigen::Matrix3d> tf_;
  std::optional<LearnedCalibration> stored_;
  int reads_ = 0;            // of it
  int calibrated_from_ = 0;  // frame
  TimeNs now_ns_ = 0;
  std::vector<std::string> log_;
  std::vector<FrameOutput> outputs_;
  std::unique_ptr<Processor> processor_;
};

constexpr double kFocalPx = 200, kFocalLength = kFocalPx / 256;

TEST_F(UnknownCalibration, FocalLengthIsLearnedAndUsed) {
  constexpr std::size_t kLast = 5;
  calibrated_from_ = RotatingCamera::kFrames - kLast;
  start();
  play();
  std::size_t first = 0;
  while (first < outputs_.size() && (!outputs_[first].field || outputs_[first].field->images_alone)) ++first;
  EXPECT_GT(first, 2 * RotatingCamera::kFramesPerS) << "nothing is known at first";
  EXPECT_LT(first, 5 * RotatingCamera::kFramesPerS) << "five seconds of motion are enough";
  EXPECT_EQ(logged("focal_length is estimated from the images and used"), 1U);
  for (std::size_t i = 1; i < first; ++i) {
    EXPECT_EQ(outputs_[i].reason_text, "optical flow alone: the camera is not calibrated") << i;
  }
  // The same frames of a camera that is calibrated.
  const std::vector<FrameOutput> uncalibrated = std::exchange(outputs_, {});
  config_.R_cam_imu = RotatingCamera::R_cam_imu();
  config_.gyro.time_offset_ns = RotatingCamera::kTimeOffset;
  config_.gyro.bias_rad_s = RotatingCamera::bias_rad_s();
  config_.given = {true, true, true};
  calibrated_from_ = 0;
  camera().rewind();
  start();
  play();
  for (std::size_t i = first; i < uncalibrated.size(); ++i) {
    const FrameOutput& output = uncalibrated[i];
    ASSERT_EQ(output.reason, PassThroughReason::NONE) << i << ": " << output.reason_text;
    EXPECT_FALSE(output.field->images_alone) << i;
    EXPECT_EQ(output.camera_info->K[0], i + kLast < uncalibrated.size() ? 0 : kFocalPx) << "the input's own";
    const std::vector<BlockBlur>&blocks = output.field->blocks, &truth = outputs_[i].field->blocks;
    for (std::size_t b = 0; b < blocks.size(); ++b) {
      EXPECT_NEAR(blocks[b].extent_px, truth[b].extent_px, 0.3 + 0.1 * truth[b].extent_px) << i << ", " << b;
    }
  }
}

TEST_F(UnknownCalibration, FocalLengthIsInTheTableOfAnUncalibratedCameraAlone) {
  calibrated_from_ = RotatingCamera::kFrames;
  start();
  play(0, 20);
  EXPECT_NE(row("focal_length").text.find("not known, images are deblurred by optical flow alone: "), std::string::npos)
      << row("focal_length").text;
  play(20, 100);
  const CalibrationRow found = row("focal_length");
  EXPECT_TRUE(found.by_images);
  EXPECT_NEAR(std::stod(found.text), kFocalLength, 0.08 * kFocalLength);
  EXPECT_NE(found.text.find("of the image's larger side (+- 0.0"), std::string::npos) << found.text;
  const auto kept = processor_->calibration_by_images();
  ASSERT_TRUE(kept && kept->calibration.focal_length.known);
  const std::string path = testing::TempDir() + "focal_length.json";
  save_stored_calibration(path, kept->calibration);
  stored_ = load_stored_calibration(path);
  EXPECT_EQ(stored_->focal_length.value, kept->calibration.focal_length.value);

  // At the next start it is used from the first image on.
  outputs_.clear();
  camera().rewind();
  start();
  play(0, 3);
  for (const FrameOutput& output : outputs_) EXPECT_FALSE(output.field->images_alone) << output.reason_text;

  // The camera has been calibrated meanwhile.
  calibrated_from_ = 0;
  outputs_.clear();
  camera().rewind();
  start();
  play(0, 3);
  for (const CalibrationRow& row : processor_->statistics().calibration) EXPECT_NE(row.key, "focal_length");
  EXPECT_FALSE(processor_->calibration_by_images()->calibration.focal_length.known);
}

TEST_F(UnknownCalibration, WithoutSelfCalibrationFlowAloneServesAnUncalibratedCamera) {
  calibrated_from_ = RotatingCamera::kFrames;
  config_.self_calibration = SelfCalibrationMode::NEVER;
  start();
  play(0, 100);
  for (std::size_t i = 1; i < outputs_.size(); ++i) EXPECT_TRUE(outputs_[i].field->images_alone) << i;
  EXPECT_NE(row("focal_length").text.find("self_calibration is never"), std::string::npos);
}

TEST_F(UnknownCalibration, FlowAloneServesWhereTheRotationIsNotKnown) {
  calibrated_from_ = RotatingCamera::kFrames;
  stored_.emplace();
  stored_->focal_length = {kFocalLength, 0.01, 10, true, ""};
  stored_->focal_image_px = 256;
  start();
  play(0, 5);
  for (std::size_t i = 1; i < outputs_.size(); ++i) {
    EXPECT_TRUE(outputs_[i].field->images_alone) << i;
    EXPECT_EQ(outputs_[i].reason_text.rfind("optical flow alone: no transform", 0), 0U) << outputs_[i].reason_text;
  }

  stored_->focal_image_px = 512;  // of another size
  outputs_.clear();
  camera().rewind();
  start();
  play(0, 5);
  EXPECT_EQ(outputs_.back().reason_text, "optical flow alone: the camera is not calibrated");
}

TEST_F(UnknownCalibration, IsLearnedAndUsed) {
  start();
  EXPECT_FALSE(row("R_cam_imu").by_images);
  EXPECT_NE(row("R_cam_imu").text.find("alone unless tf has it: nothing has been seen yet"), std::string::npos)
      << row("R_cam_imu").text;
  play();
  EXPECT_EQ(outputs_.front().reason, PassThroughReason::NO_EXTRINSIC) << "there is no image before it";
  for (const char* part : {"not estimated from images yet: nothing has been seen yet", "shows no certain motion"}) {
    EXPECT_NE(outputs_.front().reason_text.find(part), std::string::npos) << outputs_.front().reason_text;
  }
  std::size_t first = 1;
  for (; first < outputs_.size() && outputs_[first].field->images_alone; ++first) {
    EXPECT_EQ(outputs_[first].reason, PassThroughReason::NONE) << first << ": " << outputs_[first].reason_text;
    EXPECT_EQ(outputs_[first].reason_text.rfind("optical flow alone: no transform", 0), 0U);
  }
  EXPECT_EQ(logged("by optical flow alone, which is less accurate: no transform"), 1U) << "said once";
  EXPECT_GT(first, 2 * RotatingCamera::kFramesPerS);
  EXPECT_LT(first, 5 * RotatingCamera::kFramesPerS) << "five seconds of motion are enough";
  for (std::size_t i = first; i < outputs_.size(); ++i) {
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << i << ": " << outputs_[i].reason_text;
    EXPECT_FALSE(outputs_[i].field->images_alone) << i;
  }
  for (const char* key : {"R_cam_imu", "time_offset", "readout_time", "gyro_bias"}) {
    EXPECT_TRUE(row(key).by_images) << row(key).text;
    EXPECT_NE(row(key).text.find("+-"), std::string::npos) << row(key).text;
    EXPECT_EQ(logged(std::string(key) + " is estimated from the images and used"), 1U);
  }
  EXPECT_NE(row("time_offset").text.find("0.03"), std::string::npos) << row("time_offset").text;
  EXPECT_LT((processor_->statistics().bias_rad_s - RotatingCamera::bias_rad_s()).norm(), 0.02);
  EXPECT_EQ(logged("contradict"), 0U);

  processor_->reset_calibration();
  processor_->advance([](FrameOutput&&) { return true; });
  EXPECT_FALSE(row("R_cam_imu").by_images) << "forgotten";
  EXPECT_EQ(processor_->statistics().bias_rad_s, Eigen::Vector3d(0, 0, 0));
}

TEST_F(UnknownCalibration, IsLearnedAgainEquallyFromTheSameMessages) {
  start();
  play();
  const std::string first = row("R_cam_imu").text + row("time_offset").text;
  outputs_.clear();
  camera().rewind();
  start();
  play();
  EXPECT_EQ(row("R_cam_imu").text + row("time_offset").text, first);
}

TEST_F(UnknownCalibration, IsNotLearnedWhereNobodyWantsIt) {
  config_.self_calibration = SelfCalibrationMode::NEVER;
  config_.pipeline.flow_without_gyro = "never";
  start();
  play(0, 80);
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NO_EXTRINSIC);
  EXPECT_NE(outputs_.back().reason_text.find("self_calibration is never"), std::string::npos);
  EXPECT_NE(row("time_offset").text.find("not known, 0 s is used: self_calibration is never"), std::string::npos)
      << row("time_offset").text;
}

TEST_F(UnknownCalibration, GoesByTfWhereThatHasIt) {
  tf_ = RotatingCamera::R_cam_imu();
  start();
  play();
  EXPECT_EQ(outputs_.front().reason, PassThroughReason::NONE) << outputs_.front().reason_text;
  EXPECT_FALSE(row("R_cam_imu").by_images);
  EXPECT_NE(row("R_cam_imu").text.find("(tf), images differ from it by"), std::string::npos) << row("R_cam_imu").text;
  EXPECT_EQ(problem("R_cam_imu"), "");
  EXPECT_TRUE(row("time_offset").by_images) << row("time_offset").text;
}

TEST_F(UnknownCalibration, ThatIsGivenIsKeptAndCheckedWithoutAnEffect) {
  config_.R_cam_imu = RotatingCamera::R_cam_imu();
  config_.gyro.time_offset_ns = RotatingCamera::kTimeOffset;
  config_.gyro.bias_rad_s = RotatingCamera::bias_rad_s();
  config_.given = {};
  start();
  play();
  EXPECT_EQ(logged("contradict"), 0U);
  for (const char* key : {"R_cam_imu", "time_offset", "readout_time", "gyro_bias"}) {
    EXPECT_FALSE(row(key).by_images);
    EXPECT_NE(row(key).text.find("(parameter), images differ from it by"), std::string::npos) << row(key).text;
  }
  const std::vector<FrameOutput> checked = std::move(outputs_);
  outputs_.clear();
  camera().rewind();
  config_.self_calibration = SelfCalibrationMode::NEVER;
  start();
  play();
  for (std::size_t i = 0; i < checked.size(); ++i) EXPECT_EQ(checked[i].image->data, outputs_[i].image->data) << i;
}

TEST_F(UnknownCalibration, ThatIsGivenWronglyIsNamedWithBothValuesAndKept) {
  config_.R_cam_imu = RotatingCamera::R_cam_imu() * so3_exp({0, 0, M_PI / 2}).toRotationMatrix();
  config_.gyro.time_offset_ns = RotatingCamera::kTimeOffset - 80 * kMs;
  config_.gyro.bias_rad_s = RotatingCamera::bias_rad_s() + Eigen::Vector3d(0, 0.2, 0);
  config_.shutter.readout_ns = 25 * kMs;
  config_.given = {};
  start();
  play();
  EXPECT_NE(problem("R_cam_imu").find("R_cam_imu (parameter) contradicts the images: it is ["), std::string::npos)
      << problem("R_cam_imu");
  EXPECT_NE(problem("R_cam_imu").find("90 degrees from it"), std::string::npos) << problem("R_cam_imu");
  EXPECT_NE(problem("time_offset").find("it is -0.0430 s, they say 0.0"), std::string::npos) << problem("time_offset");
  EXPECT_NE(problem("readout_time").find("it is 0.0250 s, they say 0.0000 s"), std::string::npos)
      << problem("readout_time");
  EXPECT_NE(problem("gyro_bias").find("rad/s, they say ["), std::string::npos) << problem("gyro_bias");
  for (const char* key : {"R_cam_imu", "time_offset", "readout_time", "gyro_bias"}) {
    EXPECT_FALSE(row(key).by_images) << "what is given is never replaced";
    EXPECT_EQ(logged(std::string(key) + " (parameter) contradicts"), 1U);
  }
  EXPECT_EQ(processor_->statistics().bias_rad_s, config_.gyro.bias_rad_s);
  // Corrected while running, as a user does.
  config_.R_cam_imu = RotatingCamera::R_cam_imu();
  processor_->set_config(config_);
  camera().rewind();
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NONE) << output.reason_text;
}

TEST_F(UnknownCalibration, IsUsedFromTheFirstImageOnAsItWasAtTheLastStart) {
  start();
  play();
  const auto seen = processor_->calibration_by_images();
  ASSERT_TRUE(seen);
  EXPECT_EQ(seen->width_px, 256);
  EXPECT_EQ(seen->height_px, 192);
  ASSERT_TRUE(seen->calibration.R_cam_imu.known && seen->calibration.time_offset_s.known);
  stored_ = seen->calibration;
  config_.given.time_offset = true;  // and 0: a number that is given goes before what is stored
  outputs_.clear();
  camera().rewind();
  start();
  play(0, 30);
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NONE) << output.reason_text;
  EXPECT_NE(row("R_cam_imu").text.find("s before this start"), std::string::npos) << row("R_cam_imu").text;
  EXPECT_EQ(row("time_offset").text.find("before this start"), std::string::npos) << row("time_offset").text;
  EXPECT_FALSE(processor_->calibration_by_images()->calibration.time_offset_s.known) << "it is not used";
  processor_->reset_calibration();
  EXPECT_FALSE(row("R_cam_imu").by_images) << "forgotten at once";
}

TEST_F(UnknownCalibration, WhatIsStoredIsReadOnceAndOnlyWhereItMayBeUsed) {
  stored_.emplace();
  for (const SelfCalibrationMode mode : {SelfCalibrationMode::AUTO, SelfCalibrationMode::NEVER}) {
    config_.self_calibration = mode;
    outputs_.clear();
    camera().rewind();
    start();
    play(0, 3);
    EXPECT_EQ(reads_, 1) << "NEVER adds none";
  }
}

TEST_F(UnknownCalibration, OfAnotherCameraIsDroppedWithinFiveSecondsOfMotion) {
  LearnedCalibration other;
  other.R_cam_imu = {Eigen::Matrix3d(RotatingCamera::R_cam_imu() * so3_exp({0, 1.5, 0}).toRotationMatrix()), 0.002, 20,
                     true, ""};
  other.time_offset_s = {-0.2, 0.0005, 20, true, ""};
  stored_ = other;
  start();
  play(0, 100);
  EXPECT_EQ(logged("R_cam_imu of the last start is dropped"), 1U);
  EXPECT_EQ(logged("time_offset of the last start is dropped: it was -0.2000 s, the images now give 0.03"), 1U);
  EXPECT_EQ(row("R_cam_imu").text.find("before this start"), std::string::npos) << row("R_cam_imu").text;
  EXPECT_NE(row("time_offset").text.find("0.03"), std::string::npos) << row("time_offset").text;
}

/// Without frames: what becomes of estimates.
class InUse : public testing::Test {
 protected:
  InUse() {
    config_.given = {false, false, false};
    config_.shutter.stamp_row = StampRow::FIRST;
    // Half of the readout time is in an offset that was learned without one.
    learned_.time_offset_s = {0.05, 0.0005, 20, true, ""};
    learned_.readout_s = {0.02, 0.0005, 20, true, ""};
    in_use_.set_config(config_);
  }
  double offset_s() const { return to_seconds(in_use_.config().gyro.time_offset_ns); }

  Config config_;
  LearnedCalibration learned_;
  InputProblems problems_{[](LogLevel, const std::string&) {}};
  CalibrationInUse in_use_{&problems_};
};

TEST_F(InUse, ALearnedOffsetHasHalfOfAReadoutTimeThatExposuresWereWithout) {
  in_use_.learn(learned_, 1, false);
  EXPECT_NEAR(offset_s(), 0.04, 1e-9);
  learned_.time_offset_s.value = 0.04;
  in_use_.learn(learned_, 1, true);  // now messages have it
  EXPECT_NEAR(offset_s(), 0.04, 1e-9);
}

TEST_F(InUse, AStoredOffsetMeansTheSameWhoeverKnowsTheReadoutTimeNextTime) {
  in_use_.learn(learned_, 1, false);
  const LearnedCalibration stored = in_use_.by_images();
  for (const bool given : {false, true}) {
    config_.given.readout_time = given;
    CalibrationInUse next(&problems_);
    next.set_config(config_);
    next.remember(stored);
    EXPECT_NEAR(to_seconds(next.config().gyro.time_offset_ns), 0.04, 1e-9) << given;
  }
  LearnedCalibration without = learned_;
  without.readout_s.known = false;
  config_.given.readout_time = false;
  CalibrationInUse other(&problems_);
  other.set_config(config_);
  other.learn(without, 1, false);
  EXPECT_FALSE(other.by_images().time_offset_s.known) << "half of an unknown readout time may be in it";
}

TEST_F(InUse, AContradictionIsReportedAgainAfterAReset) {
  config_.given.time_offset = config_.given.readout_time = true;
  in_use_.set_config(config_);
  in_use_.learn(learned_, 1, false);
  ASSERT_EQ(problems_.all().count("time_offset by images"), 1U);
  problems_.clear();
  in_use_.learn(learned_, 1, false);
  EXPECT_EQ(problems_.all().count("time_offset by images"), 1U);
}

TEST(SelfCalibrator, LearnsInTheBackgroundAndLeavesOutWhatItCannotKeepUpWith) {
  std::vector<std::string> log;
  InputProblems problems([&log](LogLevel, const std::string& text) { log.push_back(text); });
  SelfCalibrator at_once(SelfCalibrator::Work::AT_ONCE, &problems);
  SelfCalibrator background(SelfCalibrator::Work::IN_BACKGROUND, &problems);
  camera().rewind();
  for (int i = 0; i < RotatingCamera::kFrames; ++i) {
    std::vector<GyroSample> samples;
    for (const sensor_msgs::Imu& imu : camera().samples_before(i)) samples.push_back(*to_gyro_sample(imu));
    const sensor_msgs::ImageConstPtr image = camera().image(i);
    const SelfCalibrator::Image input{image,
                                      to_calibration(*camera().info(i), 256, 192, false),
                                      RowExposure(camera().stamp(i), 192, {RotatingCamera::kShownFor, 0}),
                                      {},
                                      true};
    at_once.add(samples, input);
    background.add(samples, input);  // faster than it can
  }
  EXPECT_TRUE(at_once.learned().R_cam_imu.known);
  EXPECT_GT(at_once.updates(), 3U);
  EXPECT_LE(background.updates(), at_once.updates());
  background.clear();
  EXPECT_FALSE(background.learned().R_cam_imu.known) << "at once, whatever it is doing";
  at_once.set_expected_offset(0);
  EXPECT_TRUE(at_once.learned().R_cam_imu.known) << "the same as before";
  at_once.set_expected_offset(kSecond);
  EXPECT_FALSE(at_once.learned().R_cam_imu.known);
  EXPECT_TRUE(log.empty()) << log.front();
}

}  // namespace
}  // namespace gyro_deblur::unknown_calibration_test
