// Frames of a camera whose rotation, time offset, readout time and bias nobody has given, or given wrongly.
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "ros/calibration_in_use.hpp"
#include "ros/processor.hpp"
#include "ros/self_calibrator.hpp"
#include "turning_camera.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

TurningCamera& camera() {
  static TurningCamera camera;
  return camera;
}

class UnknownCalibration : public testing::Test {
 protected:
  UnknownCalibration() {
    config_.shutter.exposure_ns = TurningCamera::kShownFor;
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
      now_ns_ = camera().stamp(i) + config_.gyro_timeout_ns;
      for (const sensor_msgs::Imu& imu : camera().samples_before(i)) processor_->add_imu(imu);
      processor_->add_image(camera().image(i));
      processor_->add_camera_info(camera().info(i));
      now_ns_ += config_.gyro_timeout_ns;
      processor_->advance([this](FrameOutput&& output) {
        outputs_.push_back(std::move(output));
        return true;
      });
    }
    ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(to));
  }
  void play() { play(0, TurningCamera::kFrames); }

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
  TimeNs now_ns_ = 0;
  std::vector<std::string> log_;
  std::vector<FrameOutput> outputs_;
  std::unique_ptr<Processor> processor_;
};

TEST_F(UnknownCalibration, IsLearnedAndUsed) {
  start();
  EXPECT_FALSE(row("R_cam_imu").by_images);
  EXPECT_NE(row("R_cam_imu").text.find("not known, images pass through unless tf has it: nothing has been seen yet"),
            std::string::npos)
      << row("R_cam_imu").text;
  play();
  EXPECT_EQ(outputs_.front().reason, PassThroughReason::NO_EXTRINSIC);
  EXPECT_NE(outputs_.front().reason_text.find("images do not tell it yet: nothing has been seen yet"),
            std::string::npos)
      << outputs_.front().reason_text;
  std::size_t first = 0;
  while (first < outputs_.size() && outputs_[first].reason == PassThroughReason::NO_EXTRINSIC) ++first;
  EXPECT_LT(first, 5 * TurningCamera::kFramesPerS) << "five seconds of motion are enough";
  for (std::size_t i = first; i < outputs_.size(); ++i) {
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << i << ": " << outputs_[i].reason_text;
  }
  for (const char* key : {"R_cam_imu", "time_offset", "readout_time", "gyro_bias"}) {
    EXPECT_TRUE(row(key).by_images) << row(key).text;
    EXPECT_NE(row(key).text.find("+-"), std::string::npos) << row(key).text;
    EXPECT_EQ(logged(std::string(key) + " is used as the images tell it"), 1U);
  }
  EXPECT_NE(row("time_offset").text.find("0.03"), std::string::npos) << row("time_offset").text;
  EXPECT_LT((processor_->bias_rad_s() - TurningCamera::bias_rad_s()).norm(), 0.02);
  EXPECT_EQ(logged("contradict"), 0U);

  processor_->reset_calibration();
  processor_->advance([](FrameOutput&&) { return true; });
  EXPECT_FALSE(row("R_cam_imu").by_images) << "forgotten";
  EXPECT_EQ(processor_->bias_rad_s(), Eigen::Vector3d(0, 0, 0));
}

TEST_F(UnknownCalibration, IsLearnedAgainAlikeFromTheSameMessages) {
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
  start();
  play(0, 80);
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NO_EXTRINSIC);
  EXPECT_NE(outputs_.back().reason_text.find("self_calibration is never"), std::string::npos);
  EXPECT_NE(row("time_offset").text.find("not known, 0 s is used: self_calibration is never"), std::string::npos)
      << row("time_offset").text;
}

TEST_F(UnknownCalibration, GoesByTfWhereThatHasIt) {
  tf_ = TurningCamera::R_cam_imu();
  start();
  play();
  EXPECT_EQ(outputs_.front().reason, PassThroughReason::NONE) << outputs_.front().reason_text;
  EXPECT_FALSE(row("R_cam_imu").by_images);
  EXPECT_NE(row("R_cam_imu").text.find("(tf), images differ from it by"), std::string::npos) << row("R_cam_imu").text;
  EXPECT_EQ(problem("R_cam_imu"), "");
  EXPECT_TRUE(row("time_offset").by_images) << row("time_offset").text;
}

TEST_F(UnknownCalibration, ThatIsGivenIsKeptAndCheckedWithoutAnEffect) {
  config_.R_cam_imu = TurningCamera::R_cam_imu();
  config_.gyro.time_offset_ns = TurningCamera::kTimeOffset;
  config_.gyro.bias_rad_s = TurningCamera::bias_rad_s();
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
  config_.R_cam_imu = TurningCamera::R_cam_imu() * so3_exp({0, 0, M_PI / 2}).toRotationMatrix();
  config_.gyro.time_offset_ns = TurningCamera::kTimeOffset - 80 * kMs;
  config_.gyro.bias_rad_s = TurningCamera::bias_rad_s() + Eigen::Vector3d(0, 0.2, 0);
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
  EXPECT_EQ(processor_->bias_rad_s(), config_.gyro.bias_rad_s);
  // Mended while running, as a user does.
  config_.R_cam_imu = TurningCamera::R_cam_imu();
  processor_->set_config(config_);
  camera().rewind();
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NONE) << output.reason_text;
}

TEST(SelfCalibrator, LearnsInTheBackgroundAndLeavesOutWhatItCannotKeepUpWith) {
  std::vector<std::string> log;
  ThrottledLog throttled([&log](LogLevel, const std::string& text) { log.push_back(text); });
  SelfCalibrator at_once(SelfCalibrator::Work::AT_ONCE, &throttled);
  SelfCalibrator background(SelfCalibrator::Work::IN_BACKGROUND, &throttled);
  camera().rewind();
  for (int i = 0; i < TurningCamera::kFrames; ++i) {
    std::vector<GyroSample> samples;
    for (const sensor_msgs::Imu& imu : camera().samples_before(i)) samples.push_back(*to_gyro_sample(imu));
    const sensor_msgs::ImageConstPtr image = camera().image(i);
    const SelfCalibrator::Image input{image,
                                      to_calibration(*camera().info(i), 256, 192, false),
                                      RowExposure(camera().stamp(i), 192, {TurningCamera::kShownFor, 0}),
                                      {}};
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
}  // namespace gyro_deblur
