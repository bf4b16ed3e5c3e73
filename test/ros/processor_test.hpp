// A processor on a clock of its own, with messages of a small camera that rotates.
#pragma once

#include <memory>
#include <new>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "engine/engine.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "message_builders.hpp"
#include "ros/processor.hpp"

namespace gyro_deblur::test {

constexpr TimeNs kStart = 100 * kSecond;
constexpr TimeNs kImuPeriod = 5 * kMs;
/// From the stamp to the end of the last row's exposure; row 127 of 128 starts one row before the readout's end.
constexpr TimeNs kFrameDuration = kExposure + kReadout;

class ProcessorTest : public testing::Test {
 protected:
  /// @param in_rig  the camera has a place in a stereo rig, where it is alone but for advance_refused()
  explicit ProcessorTest(bool in_rig = false)
      : rig_(in_rig ? std::make_shared<StereoRig>() : nullptr), processor_(environment()) {
    processor_.set_config(config_);
    now_ns_ = kStart;
  }

  Processor::Environment environment() {
    Processor::Environment environment;
    environment.clock = [this] { return now_ns_; };
    environment.steady_clock = [this] { return steady_ns_; };
    environment.log = [this](LogLevel, const std::string& text) { log_.push_back(text); };
    if (rig_) environment.stereo = std::make_shared<StereoCamera>(rig_, "/cam0");
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
  /// The picture of an image again, under another stamp.
  sensor_msgs::ImageConstPtr add_repetition(const sensor_msgs::Image& image, TimeNs stamp_ns) {
    const auto again = boost::make_shared<sensor_msgs::Image>(image);
    again->header.stamp = to_ros_time(stamp_ns);
    processor_.add_image(again);
    processor_.add_camera_info(camera_info(stamp_ns));
    return again;
  }
  void advance() {
    processor_.advance([this](FrameOutput&& output) {
      outputs_.push_back(std::move(output));
      return true;
    });
  }
  /// The same while a stereo partner passes its image of this instant through. It leaves the rig then: no other frame
  /// has a partner.
  void advance_refused(TimeNs stamp_ns) {
    StereoCamera partner(rig_, "/cam1");
    partner.set_timeout(kSecond);
    partner.announce(stamp_ns);
    partner.pass_through(stamp_ns, PassThroughReason::NO_CALIBRATION);
    advance();
  }
  void time_out() {
    now_ns_ += config_.input_timeout_ns;
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
    ASSERT_NE(output.quality, nullptr);
    EXPECT_EQ(output.quality->header.stamp, output.input->header.stamp);
    if (reason != PassThroughReason::STEREO_PARTNER) {
      EXPECT_EQ(output.quality->grade, ImageQuality::UNKNOWN);
      EXPECT_LT(output.quality->score, 0);
      EXPECT_EQ(output.quality->no_gyro, 1);
    }
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
    EXPECT_EQ(output.quality->grade, ImageQuality::DEBLURRED);
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
  const std::shared_ptr<StereoRig> rig_;
  Processor processor_;
};

}  // namespace gyro_deblur::test
