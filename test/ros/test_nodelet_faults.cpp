// The nodelet under rough handling, loaded into this very process, so that publishers and subscribers share memory with
// it. Waits for messages and conditions with a deadline; time never decides.
#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <dynamic_reconfigure/Reconfigure.h>
#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "camera_topics.hpp"
#include "message_builders.hpp"
#include "process_memory.hpp"
#include "ros/messages.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

constexpr TimeNs kFramePeriod = 33 * kMs;
constexpr std::uint32_t kNoLimit = 100000;

class NodeletFaultTest : public CameraTopicsTest {
 protected:
  NodeletFaultTest() : CameraTopicsTest("/faults", kNoLimit) {
    image_subscriber_ = nh_.subscribe<sensor_msgs::Image>(
        ns_ + "/deblurred/image_raw", kNoLimit,
        [this](const sensor_msgs::ImageConstPtr& image) { mailbox_.put([&] { images_.push_back(image); }); });
    field_subscriber_ = nh_.subscribe<BlurFieldMessage>(
        ns_ + "/blur_field", kNoLimit,
        [this](const BlurFieldMessageConstPtr& field) { mailbox_.put([&] { fields_.push_back(field); }); });
  }

  /// Loads the nodelet, and waits until everything is connected.
  void load() {
    ASSERT_TRUE(loader_.load(name_, "gyro_deblur/DeblurNodelet", {}, {}));
    ASSERT_TRUE(poll_until([this] {
      return inputs_connected() && image_subscriber_.getNumPublishers() > 0 && field_subscriber_.getNumPublishers() > 0;
    }));
  }
  void unload() { ASSERT_TRUE(loader_.unload(name_)); }

  bool wait_for_frames(std::size_t count) {
    return mailbox_.wait([&] { return std::min(images_.size(), fields_.size()) >= count; });
  }
  /// Each stamp is later than the one before: nothing twice, nothing out of order.
  void expect_in_order() {
    mailbox_.look([this] {
      for (std::size_t i = 1; i < images_.size(); ++i) {
        ASSERT_LT(images_[i - 1]->header.stamp, images_[i]->header.stamp) << i;
      }
    });
  }
  void expect_all_in_order(std::size_t count) {
    ASSERT_TRUE(wait_for_frames(count)) << images_.size() << " of " << count << " frames came out";
    expect_in_order();
    EXPECT_EQ(images_.size(), count);
    for (std::size_t i = 0; i < count; ++i) {
      EXPECT_EQ(images_[i]->header.stamp, to_ros_time(kStart + static_cast<TimeNs>(i) * kFramePeriod));
      EXPECT_EQ(fields_[i]->header.stamp, images_[i]->header.stamp);
    }
  }

  Mailbox mailbox_;
  std::vector<sensor_msgs::ImageConstPtr> images_;
  std::vector<BlurFieldMessageConstPtr> fields_;
  ros::Subscriber image_subscriber_, field_subscriber_;
  nodelet::Loader loader_{false};  // without services
};

TEST_F(NodeletFaultTest, TwoHundredReloadsWhileFramesFlow) {
  constexpr int kReloads = 200;
  constexpr TimeNs kPeriod = kSecond;
  double memory_mib = 0;
  for (int i = 0; i < kReloads; ++i) {
    ASSERT_NO_FATAL_FAILURE(load());
    const TimeNs begin_ns = kStart + i * kPeriod;
    publish_imu(begin_ns - 10 * kMs, begin_ns + kFramePeriod + kExposure + kReadout + kImuPeriod);
    for (int frame = 0; frame < 3; ++frame) publish_frame(begin_ns + frame * kFramePeriod);
    // Every other time it is unloaded with whatever is on its way; the last frame always waits for samples.
    if (i % 2 == 0) {
      ASSERT_TRUE(wait_for_frames(2)) << "reload " << i;
    }
    ASSERT_NO_FATAL_FAILURE(unload());
    ASSERT_TRUE(poll_until([this] { return image_publisher_.getNumSubscribers() == 0; })) << "reload " << i;
    ASSERT_NO_FATAL_FAILURE(expect_in_order()) << "reload " << i;
    // Nothing is kept here, so that what grows is the nodelet's.
    mailbox_.look([this] {
      images_.clear();
      fields_.clear();
    });
    if (i == kReloads / 4) memory_mib = process_memory_mib();
  }
  constexpr double kAllowedGrowthMib = 15;  // of the allocator and of ROS, which keeps some record of each connection
  EXPECT_LT(process_memory_mib(), memory_mib + kAllowedGrowthMib);
}

TEST_F(NodeletFaultTest, ParametersChangeAt50Hz) {
  ASSERT_NO_FATAL_FAILURE(load());
  constexpr std::size_t kFrames = 60;
  publish_imu(kStart - 50 * kMs, kStart + kFrames * kFramePeriod + kSecond);
  std::atomic<bool> stop{false};
  std::size_t changes = 0, refused = 0;
  std::thread owner([&] {
    ros::WallRate rate(50);
    for (int i = 0; !stop; ++i) {
      dynamic_reconfigure::Reconfigure change;
      change.request.config.doubles.resize(1);
      change.request.config.doubles[0].name = "gamma";
      change.request.config.doubles[0].value = 0.001 * (1 + i % 20);
      change.request.config.ints.resize(1);
      change.request.config.ints[0].name = "block_size";
      change.request.config.ints[0].value = i % 5 == 0 ? 33 : 32 + 2 * (i % 8);  // 33 is refused
      ros::service::call(name_ + "/set_parameters", change) ? ++changes : ++refused;
      rate.sleep();
    }
  });
  ros::WallRate rate(30);
  for (std::size_t i = 0; i < kFrames; ++i) {
    publish_frame(kStart + static_cast<TimeNs>(i) * kFramePeriod);
    rate.sleep();
  }
  EXPECT_TRUE(wait_for_frames(kFrames));
  stop = true;
  owner.join();
  expect_all_in_order(kFrames);
  for (const BlurFieldMessageConstPtr& field : fields_) {
    EXPECT_EQ(field->reason, BlurFieldMessage::REASON_NONE) << field->reason_text;
  }
  EXPECT_GT(changes, kFrames / 2);
  EXPECT_EQ(refused, 0u) << "the service has to answer always";
  unload();
}

TEST_F(NodeletFaultTest, SlowSubscriberHoldsUpNobodyElse) {
  constexpr std::size_t kFrames = 60;
  std::atomic<std::size_t> slow_got{0};
  std::mutex gate;
  ros::CallbackQueue slow_queue;
  ros::NodeHandle slow_nh;
  slow_nh.setCallbackQueue(&slow_queue);
  const ros::Subscriber slow =
      slow_nh.subscribe<sensor_msgs::Image>(ns_ + "/deblurred/image_raw", 2, [&](const sensor_msgs::ImageConstPtr&) {
        ++slow_got;
        const std::lock_guard<std::mutex> wait(gate);  // does not come back before everybody else has everything
      });
  ros::AsyncSpinner spinner(1, &slow_queue);
  std::unique_lock<std::mutex> closed(gate);
  spinner.start();
  ASSERT_NO_FATAL_FAILURE(load());
  publish_imu(kStart - 50 * kMs, kStart + kFrames * kFramePeriod + kSecond);
  for (std::size_t i = 0; i < kFrames; ++i) publish_frame(kStart + static_cast<TimeNs>(i) * kFramePeriod);
  expect_all_in_order(kFrames);
  EXPECT_LE(slow_got, 1u) << "it is still at its first message";
  closed.unlock();
  unload();
}

TEST_F(NodeletFaultTest, UnloadedDuringWorkItLetsOutWhatHasComeIn) {
  constexpr std::size_t kQueue = 5, kFrames = 15;
  set("frame_queue_size", static_cast<int>(kQueue));
  ASSERT_NO_FATAL_FAILURE(load());
  for (std::size_t i = 0; i < kFrames; ++i) publish_frame(kStart + static_cast<TimeNs>(i) * kFramePeriod);
  // Without gyroscope samples a frame leaves only because of the one that comes in behind it: all have come in then.
  ASSERT_TRUE(wait_for_frames(kFrames - kQueue));
  unload();
  expect_all_in_order(kFrames);
  for (std::size_t i = 0; i < kFrames; ++i) {
    EXPECT_EQ(fields_[i]->reason,
              i < kFrames - kQueue ? BlurFieldMessage::REASON_OVERLOAD : BlurFieldMessage::REASON_NO_GYRO);
  }
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "test_nodelet_faults");
  ros::AsyncSpinner spinner(2);
  spinner.start();
  return RUN_ALL_TESTS();
}
