#include "ros/translation_input.hpp"

#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "message_builders.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

constexpr TimeNs kStart = 100 * kSecond;
constexpr TimeNs kPeriod = 50 * kMs;

class TranslationInputTest : public testing::Test {
 protected:
  TranslationInputTest() { config_.translation.scene_depth_m = 2; }

  void add_odometry(TimeNs stamp_ns, const std::string& body_frame = kImuFrame) {
    nav_msgs::Odometry message;
    message.header.stamp = to_ros_time(stamp_ns);
    message.child_frame_id = body_frame;
    note(input_.add(message, config_));
  }
  void add_depth(TimeNs stamp_ns, float depth_m) {
    sensor_msgs::Range message;
    message.header.stamp = to_ros_time(stamp_ns);
    message.range = depth_m;
    note(input_.add(message, config_));
  }
  void note(const std::vector<RefusedMessage>& refused) {
    for (const RefusedMessage& each : refused) refused_ns_.push_back(each.stamp_ns);
  }
  TranslationJob around(TimeNs middle_ns) {
    std::string reason;
    const auto job = input_.around({middle_ns - 25 * kMs, middle_ns + 25 * kMs}, config_, kCameraFrame, kImuFrame,
                                   Eigen::Matrix3d::Identity(), {}, &reason);
    EXPECT_TRUE(job) << reason;
    return job.value_or(TranslationJob());
  }
  std::vector<TimeNs> velocity_stamps(TimeNs middle_ns) {
    std::vector<TimeNs> stamps_ns;
    for (const VelocitySample& sample : around(middle_ns).velocities) stamps_ns.push_back(sample.t_ns);
    return stamps_ns;
  }

  Config config_ = test_config();
  TranslationInput input_;
  std::vector<TimeNs> refused_ns_;
};

TEST_F(TranslationInputTest, TellsOfEveryMessageThatOneShowsToBeWrong) {
  for (int i = 0; i < 3; ++i) add_odometry(kStart + i * kPeriod);
  add_odometry(kStart - 10 * kSecond);  // held back until the next tells
  EXPECT_EQ(refused_ns_, std::vector<TimeNs>());
  add_odometry(kStart + 2 * kPeriod);  // a second time, which tells nothing of the other
  EXPECT_EQ(refused_ns_, std::vector<TimeNs>{kStart + 2 * kPeriod});
  add_odometry(kStart + 3 * kPeriod);
  EXPECT_EQ(refused_ns_, (std::vector<TimeNs>{kStart + 2 * kPeriod, kStart - 10 * kSecond}));
}

TEST_F(TranslationInputTest, AStrayStampCostsOneOdometryAlone) {
  // Farther than a reset of time, farther than a frame's reach, within it, and between two messages.
  for (const TimeNs off_ns : {1000 * kSecond, 3 * kSecond, 300 * kMs, 20 * kMs, -20 * kMs, -300 * kMs, -3 * kSecond,
                              -kStart - 10 * kPeriod}) {
    input_.clear();
    refused_ns_.clear();
    std::vector<TimeNs> right_ns;
    for (int i = 0; i < 20; ++i) {
      const TimeNs t_ns = kStart + i * kPeriod;
      add_odometry(t_ns);
      right_ns.push_back(t_ns);
      if (i == 10) add_odometry(t_ns + off_ns);
    }
    if (off_ns == 20 * kMs) {  // nobody can tell it from a right one
      EXPECT_TRUE(refused_ns_.empty());
      continue;
    }
    EXPECT_EQ(refused_ns_, std::vector<TimeNs>{kStart + 10 * kPeriod + off_ns});
    EXPECT_EQ(velocity_stamps(kStart + 19 * kPeriod), right_ns) << "off by " << off_ns;
  }
}

TEST_F(TranslationInputTest, AStrayMessageDoesNotChangeTheBody) {
  for (int i = 0; i < 20; ++i) add_odometry(kStart + i * kPeriod);
  add_odometry(kStart, "a_body_without_transform");
  EXPECT_EQ(velocity_stamps(kStart + 19 * kPeriod).back(), kStart + 19 * kPeriod);
}

TEST_F(TranslationInputTest, AStrayStampCostsOneDepthAlone) {
  for (const TimeNs off_ns : {1000 * kSecond, 400 * kMs, -3 * kSecond, -kStart - 10 * kPeriod}) {
    input_.clear();
    refused_ns_.clear();
    for (int i = 0; i < 20; ++i) {
      add_depth(kStart + i * kPeriod, 1.f + static_cast<float>(i));
      if (i == 10) add_depth(kStart + i * kPeriod + off_ns, 100);
    }
    EXPECT_EQ(refused_ns_, std::vector<TimeNs>{kStart + 10 * kPeriod + off_ns});
    for (const int i : {9, 10, 11, 12, 18, 19}) {
      EXPECT_EQ(around(kStart + i * kPeriod).depth_m, 1 + i) << "off by " << off_ns;
    }
  }
}

TEST_F(TranslationInputTest, AForceIsGivenBackWithItsSample) {
  add_odometry(kStart);
  const auto add_force = [this](TimeNs stamp_ns) {
    sensor_msgs::Imu imu = imu_message(stamp_ns, 0);
    imu.linear_acceleration.z = 9.81;
    input_.add(imu);
  };
  for (const TimeNs stamp_ns : {kStart, kStart + 40 * kMs, kStart + 5 * kMs, kStart + 10 * kMs}) add_force(stamp_ns);
  std::vector<TimeNs> stamps_ns;
  for (const ForceSample& force : around(kStart).forces) stamps_ns.push_back(force.t_ns);
  EXPECT_EQ(stamps_ns, (std::vector<TimeNs>{kStart, kStart + 5 * kMs, kStart + 10 * kMs}));
}

TEST_F(TranslationInputTest, AResetOfTimeStartsAnewWithItsSecondMessage) {
  for (int i = 0; i < 20; ++i) add_odometry(kStart + i * kPeriod);
  const TimeNs again_ns = kStart - 10 * kSecond;
  for (int i = 0; i < 3; ++i) add_odometry(again_ns + i * kPeriod);
  EXPECT_TRUE(refused_ns_.empty());
  EXPECT_EQ(velocity_stamps(again_ns), (std::vector<TimeNs>{again_ns, again_ns + kPeriod, again_ns + 2 * kPeriod}));
}

TEST_F(TranslationInputTest, LateMessagesAreRefusedAndNothingElse) {
  for (const int i : {0, 1, 2, 4, 3, 5, 6, 6, 7}) add_odometry(kStart + i * kPeriod);
  EXPECT_EQ(refused_ns_, (std::vector<TimeNs>{kStart + 3 * kPeriod, kStart + 6 * kPeriod}));
  std::vector<TimeNs> right_ns;
  for (const int i : {0, 1, 2, 4, 5, 6, 7}) right_ns.push_back(kStart + i * kPeriod);
  EXPECT_EQ(velocity_stamps(kStart + 7 * kPeriod), right_ns);
}

}  // namespace
}  // namespace gyro_deblur
