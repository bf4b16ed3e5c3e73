#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "processor_test.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

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
