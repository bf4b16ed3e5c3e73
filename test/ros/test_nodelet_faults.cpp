// The nodelet under rough handling, loaded into this very process, so that publishers and subscribers share memory with
// it. Waits for messages and conditions with a deadline; time never decides.
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <dynamic_reconfigure/Reconfigure.h>
#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/callback_queue.h>
#include <ros/console.h>
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "camera_topics.hpp"
#include "message_builders.hpp"
#include "own_ros_home.hpp"
#include "process_memory.hpp"
#include "ros/messages.hpp"
#include "ros/shared_imu.hpp"

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
    field_subscriber_ = nh_.subscribe<BlurField>(ns_ + "/blur_field", kNoLimit, [this](const BlurFieldConstPtr& field) {
      mailbox_.put([&] { fields_.push_back(field); });
    });
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
  std::vector<BlurFieldConstPtr> fields_;
  ros::Subscriber image_subscriber_, field_subscriber_;
  nodelet::Loader loader_{false};  // without services
};

// GYRO_DEBLUR_RELOADS in the environment: fewer, in scripts/test.sh for time, with sanitizers for their memory, which
// grows.
TEST_F(NodeletFaultTest, ReloadsWhileFramesFlow) {
  constexpr int kAllReloads = 200;
  const char* fewer = std::getenv("GYRO_DEBLUR_RELOADS");
  const int reloads = fewer == nullptr ? kAllReloads : std::stoi(fewer);
  constexpr TimeNs kPeriod = kSecond;
  double memory_mib = 0;
  for (int i = 0; i < reloads; ++i) {
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
    if (i == kAllReloads / 4) memory_mib = process_memory_mib();
  }
  constexpr double kAllowedGrowthMib = 15;  // of the allocator and of ROS, which keeps some record of each connection
  if (reloads == kAllReloads) {
    EXPECT_LT(process_memory_mib(), memory_mib + kAllowedGrowthMib);
  }
}

TEST_F(NodeletFaultTest, ParametersChangeAt50Hz) {
  ASSERT_NO_FATAL_FAILURE(load());
  constexpr std::size_t kFrames = 60;
  publish_imu(kStart - 50 * kMs, kStart + kFrames * kFramePeriod + kSecond);
  std::atomic<bool> stop{false};
  std::atomic<std::size_t> changes{0}, refused{0};
  std::thread owner([&] {
    ros::WallRate rate(50);
    for (int i = 0; !stop; ++i) {
      dynamic_reconfigure::Reconfigure change;
      change.request.config.doubles.resize(1);
      change.request.config.doubles[0].name = "noise_to_signal_ratio";
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
    // Processing that cannot keep up here is no matter of this test: never two newer frames than one that is ready.
    if (i >= 1) {
      EXPECT_TRUE(wait_for_frames(i));
    }
    rate.sleep();
    // On a busy machine the images wait for the changes, so that there are as many of them between two images.
    constexpr int kMostWaits = 300;
    for (int waits = 0; changes <= i / 2 && waits < kMostWaits; ++waits) rate.sleep();
  }
  EXPECT_TRUE(wait_for_frames(kFrames));
  stop = true;
  owner.join();
  expect_all_in_order(kFrames);
  for (const BlurFieldConstPtr& field : fields_) {
    EXPECT_EQ(field->reason, BlurField::REASON_NONE) << field->reason_text;
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
    EXPECT_EQ(fields_[i]->reason, i < kFrames - kQueue ? BlurField::REASON_OVERLOAD : BlurField::REASON_NO_GYRO);
  }
}

/// Holds up the thread that logs a line, and with it whatever it does, until it is released.
class LogGate : public ros::console::LogAppender {
 public:
  explicit LogGate(std::string part) : part_(std::move(part)) { ros::console::register_appender(this); }
  ~LogGate() override {
    open();
    ros::console::deregister_appender(this);
  }
  LogGate(const LogGate&) = delete;
  LogGate& operator=(const LogGate&) = delete;

  /// True when somebody came to the line before the deadline.
  bool wait_for_somebody() {
    return mailbox_.wait([this] { return came_; });
  }
  void open() {
    mailbox_.put([this] { open_ = true; });
  }

 private:
  void log(ros::console::Level /*level*/, const char* text, const char* /*file*/, const char* /*function*/,
           int /*line*/) override {
    if (std::string(text).find(part_) == std::string::npos) return;
    mailbox_.put([this] { came_ = true; });
    mailbox_.wait([this] { return open_; });
  }

  const std::string part_;
  Mailbox mailbox_;
  bool came_ = false, open_ = false;
};

class UnloadTest : public NodeletFaultTest {
 protected:
  void load() {
    ASSERT_NO_FATAL_FAILURE(NodeletFaultTest::load());
    ASSERT_TRUE(poll_until([this] { return image_publisher_.getNumSubscribers() > 0; }));
  }
  /// Unloads the nodelet while its worker is at the gate, which opens when unloading has begun.
  void unload_through(LogGate* gate) {
    ASSERT_TRUE(gate->wait_for_somebody());
    std::thread unloader([this] { unload(); });
    // Given up before the nodelet waits for its worker.
    EXPECT_TRUE(poll_until([this] { return image_publisher_.getNumSubscribers() == 0; }));
    gate->open();
    unloader.join();
  }
};

TEST_F(UnloadTest, WhileAFrameIsInWorkItWaitsForItAndLetsOutTheRest) {
  constexpr std::size_t kQueue = 5, kFrames = 7;
  set("frame_queue_size", static_cast<int>(kQueue));
  set("engine", std::string("opencl:no such device"));  // said while the first frame is processed
  ASSERT_NO_FATAL_FAILURE(load());
  for (std::size_t i = 0; i < kFrames; ++i) publish_frame(kStart + static_cast<TimeNs>(i) * kFramePeriod);
  ASSERT_TRUE(wait_for_frames(kFrames - kQueue)) << "all have come in then";
  LogGate gate("OpenCL failed");
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  ASSERT_NO_FATAL_FAILURE(unload_through(&gate));
  expect_all_in_order(kFrames);
  EXPECT_EQ(fields_[kFrames - kQueue]->reason, BlurField::REASON_NONE) << "the one in work";
}

TEST_F(UnloadTest, WhileAFrameFailsItStillLetsItOut) {
  ASSERT_NO_FATAL_FAILURE(load());
  LogGate gate("UNSUPPORTED_ENCODING");  // said with the processor's lock held
  const sensor_msgs::ImagePtr image = image_message(kStart);
  image->encoding = "nonsense";
  image_publisher_.publish(image);
  ASSERT_NO_FATAL_FAILURE(unload_through(&gate));
  expect_all_in_order(1);
  EXPECT_EQ(images_[0].get(), image.get());
  EXPECT_EQ(fields_[0]->reason, BlurField::REASON_UNSUPPORTED_ENCODING);
}

TEST_F(NodeletFaultTest, ImagesAreHandedOnWithoutACopy) {
  ASSERT_NO_FATAL_FAILURE(load());
  publish_imu(kStart - 50 * kMs, kStart + kSecond, 0);
  const sensor_msgs::ImageConstPtr sharp = publish_frame(kStart);
  ASSERT_TRUE(wait_for_frames(1));
  // Both ways: what the nodelet got was the camera's message, and what it published came here as it was. A deblurred
  // image takes the same way.
  EXPECT_EQ(images_[0].get(), sharp.get());

  publish_imu(kStart + kSecond + kImuPeriod, kStart + 2 * kSecond);
  const sensor_msgs::ImageConstPtr blurred = publish_frame(kStart + 1500 * kMs);
  ASSERT_TRUE(wait_for_frames(2));
  EXPECT_NE(images_[1].get(), blurred.get());
  EXPECT_FALSE(images_[1]->data == blurred->data);
  unload();
}

/// Two cameras and one IMU.
class StereoTest : public NodeletFaultTest {
 protected:
  struct Camera {
    std::string ns;
    ros::Publisher image_publisher, info_publisher;
    ros::Subscriber subscriber, field_subscriber;
    std::vector<sensor_msgs::ImageConstPtr> inputs, images;
    std::vector<BlurFieldConstPtr> fields;
  };

  StereoTest() {
    for (std::size_t i = 0; i < 2; ++i) {
      Camera& camera = cameras_[i];
      camera.ns = ns_ + "/cam" + std::to_string(i);
      camera.image_publisher = nh_.advertise<sensor_msgs::Image>(camera.ns + "/image_raw", kNoLimit);
      camera.info_publisher = nh_.advertise<sensor_msgs::CameraInfo>(camera.ns + "/camera_info", kNoLimit);
      camera.subscriber = nh_.subscribe<sensor_msgs::Image>(camera.ns + "/deblurred/image_raw", kNoLimit,
                                                            [this, &camera](const sensor_msgs::ImageConstPtr& image) {
                                                              mailbox_.put([&] { camera.images.push_back(image); });
                                                            });
      camera.field_subscriber = nh_.subscribe<BlurField>(
          camera.ns + "/blur_field", kNoLimit,
          [this, &camera](const BlurFieldConstPtr& field) { mailbox_.put([&] { camera.fields.push_back(field); }); });
      name_ = camera.ns + "/deblur";
      set_camera_parameters();
      set("stereo_sync_timeout", kLongTimeoutS);
    }
  }

  void load(std::size_t i) {
    const Camera& camera = cameras_[i];
    ASSERT_TRUE(
        loader_.load(camera.ns + "/deblur", "gyro_deblur/DeblurNodelet", {{camera.ns + "/imu", ns_ + "/imu"}}, {}));
    ASSERT_TRUE(poll_until([&] {
      return camera.image_publisher.getNumSubscribers() > 0 && camera.info_publisher.getNumSubscribers() > 0 &&
             imu_publisher_.getNumSubscribers() > 0 && camera.subscriber.getNumPublishers() > 0 &&
             camera.field_subscriber.getNumPublishers() > 0;
    }));
  }
  void unload(std::size_t i) { ASSERT_TRUE(loader_.unload(cameras_[i].ns + "/deblur")); }
  void publish(std::size_t i, TimeNs stamp_ns, const std::string& encoding = "mono8") {
    Camera& camera = cameras_[i];
    const sensor_msgs::ImagePtr image = image_message(stamp_ns);
    image->encoding = encoding;
    camera.inputs.push_back(image);
    camera.info_publisher.publish(camera_info(stamp_ns));
    camera.image_publisher.publish(camera.inputs.back());
  }
  bool wait_for(std::size_t i, std::size_t count) {
    const Camera& camera = cameras_[i];
    return mailbox_.wait([&] { return std::min(camera.images.size(), camera.fields.size()) >= count; });
  }

  void expect_deblurred(std::size_t i, std::size_t count) {
    const Camera& camera = cameras_[i];  // nothing comes any more
    ASSERT_EQ(camera.images.size(), count);
    ASSERT_EQ(camera.inputs.size(), count);
    for (std::size_t k = 0; k < count; ++k) {
      EXPECT_EQ(camera.images[k]->header.stamp, camera.inputs[k]->header.stamp);
      EXPECT_EQ(camera.fields[k]->reason, BlurField::REASON_NONE) << camera.fields[k]->reason_text;
      EXPECT_FALSE(camera.images[k]->data == camera.inputs[k]->data);
    }
  }

  /// A thread of the manager's may hold an unloaded nodelet for a moment longer.
  static void expect_no_imu() {
    EXPECT_TRUE(poll_until([] { return SharedImu::count() == 0; }));
  }

  static constexpr TimeNs kPeriod = 100 * kMs;  // long enough for a frame's samples, and for the work on it
  Camera cameras_[2];
};

TEST_F(StereoTest, CamerasShareOneGyroscopeAndPairsStayInStep) {
  ASSERT_EQ(SharedImu::count(), 0u);
  ASSERT_NO_FATAL_FAILURE(load(0));
  ASSERT_NO_FATAL_FAILURE(load(1));
  EXPECT_EQ(SharedImu::count(), 1u);
  EXPECT_EQ(imu_publisher_.getNumSubscribers(), 1u);
  constexpr std::size_t kPairs = 20;
  for (std::size_t k = 0; k < kPairs; ++k) {
    const TimeNs stamp_ns = kStart + static_cast<TimeNs>(k) * kPeriod;
    for (std::size_t i = 0; i < 2; ++i) publish(i, stamp_ns);
    publish_imu(k == 0 ? kStart - 50 * kMs : stamp_ns + kImuPeriod, stamp_ns + kPeriod);
    // Both wait for the same sample.
    for (std::size_t i = 0; i < 2; ++i) ASSERT_TRUE(wait_for(i, k + 1)) << "camera " << i << ", pair " << k;
  }
  for (std::size_t i = 0; i < 2; ++i) expect_deblurred(i, kPairs);
  for (std::size_t k = 0; k < kPairs; ++k) {
    EXPECT_EQ(cameras_[0].images[k]->header.stamp, cameras_[1].images[k]->header.stamp);
  }
  for (std::size_t i = 0; i < 2; ++i) unload(i);
  expect_no_imu();
}

TEST_F(StereoTest, OneCameraGoesOnWhenTheOtherIsUnloaded) {
  for (const std::size_t i : {0u, 1u}) ASSERT_NO_FATAL_FAILURE(load(i));
  publish_imu(kStart - 50 * kMs, kStart + kPeriod);
  for (const std::size_t i : {0u, 1u}) publish(i, kStart);
  for (const std::size_t i : {0u, 1u}) ASSERT_TRUE(wait_for(i, 1));
  unload(0);
  EXPECT_EQ(SharedImu::count(), 1u);
  publish(1, kStart + kPeriod);
  publish_imu(kStart + kPeriod + kImuPeriod, kStart + 2 * kPeriod);
  ASSERT_TRUE(wait_for(1, 2));
  expect_deblurred(1, 2);
  // And the other finds it again, with what has come meanwhile.
  ASSERT_NO_FATAL_FAILURE(load(0));
  EXPECT_EQ(SharedImu::count(), 1u);
  publish(0, kStart + kPeriod);
  ASSERT_TRUE(wait_for(0, 2));
  expect_deblurred(0, 2);
  for (const std::size_t i : {0u, 1u}) unload(i);
  expect_no_imu();
}

TEST_F(StereoTest, TimeJumpOfTheImuIsOneForEachCamera) {
  for (const std::size_t i : {0u, 1u}) ASSERT_NO_FATAL_FAILURE(load(i));
  constexpr std::size_t kLoops = 3, kImages = 3;
  for (std::size_t loop = 0; loop < kLoops; ++loop) {
    const TimeNs end_ns = kStart + kSecond + static_cast<TimeNs>(loop) * kSecond;
    publish_imu(kStart - 50 * kMs, end_ns);
    // The second one leaves only when samples of this loop have come: no loop before has any as late.
    for (const std::size_t i : {0u, 1u}) publish(i, kStart + 500 * kMs);
    for (const std::size_t i : {0u, 1u}) publish(i, end_ns - 2 * kPeriod);
    for (const std::size_t i : {0u, 1u}) ASSERT_TRUE(wait_for(i, kImages * loop + 2)) << "camera " << i;
    for (const std::size_t i : {0u, 1u}) publish(i, end_ns - kPeriod);
    for (const std::size_t i : {0u, 1u}) ASSERT_TRUE(wait_for(i, kImages * (loop + 1))) << "camera " << i;
  }
  for (const std::size_t i : {0u, 1u}) {
    EXPECT_EQ(cameras_[i].images.size(), kImages * kLoops);
    // The first two of a loop may overtake the samples that show it.
    for (std::size_t k = 2; k < kImages * kLoops; k += kImages) {
      EXPECT_EQ(cameras_[i].fields[k]->reason, BlurField::REASON_NONE) << cameras_[i].fields[k]->reason_text;
    }
    unload(i);
  }
}

/// Which images left with other pixels than they came with, and in how many pairs only one image did.
class StereoPairTest : public StereoTest {
 protected:
  void publish(std::size_t i, TimeNs stamp_ns, const cv::Mat& pixels) {
    Camera& camera = cameras_[i];
    const sensor_msgs::ImagePtr like = image_message(stamp_ns);
    camera.inputs.push_back(to_image(pixels, *like));
    camera.info_publisher.publish(camera_info(stamp_ns));
    camera.image_publisher.publish(camera.inputs.back());
  }
  template <typename T>
  void set(std::size_t i, const std::string& parameter, const T& value) {
    nh_.setParam(cameras_[i].ns + "/deblur/" + parameter, value);
  }
  bool changed(std::size_t i, std::size_t k) const {
    return cameras_[i].images[k]->data != cameras_[i].inputs[k]->data;
  }
  /// @param unlike  pairs of which one image is deblurred
  void expect_pairs(std::size_t count, std::size_t unlike) {
    std::size_t found = 0;
    for (std::size_t k = 0; k < count; ++k) {
      ASSERT_EQ(cameras_[0].images[k]->header.stamp, cameras_[1].images[k]->header.stamp);
      found += changed(0, k) != changed(1, k);
    }
    EXPECT_EQ(found, unlike) << "of " << count << " pairs";
  }

  /// One camera may keep a single image waiting, and passes the others of a burst through. The other one is overloaded
  /// only where an image takes longer than half of kPeriod.
  void overload() {
    constexpr std::size_t kPairs = 8;
    set(1, "frame_queue_size", 1);
    for (const std::size_t i : {0u, 1u}) ASSERT_NO_FATAL_FAILURE(load(i));
    for (std::size_t k = 0; k < kPairs; ++k) {
      for (const std::size_t i : {0u, 1u}) StereoTest::publish(i, kStart + static_cast<TimeNs>(k) * kPeriod);
    }
    ASSERT_TRUE(wait_for(1, kPairs - 1));
    publish_imu(kStart - 50 * kMs, kStart + kPairs * kPeriod + kSecond);
    for (const std::size_t i : {0u, 1u}) ASSERT_TRUE(wait_for(i, kPairs));
    for (std::size_t k = 0; k + 1 < kPairs; ++k) EXPECT_EQ(cameras_[1].fields[k]->reason, BlurField::REASON_OVERLOAD);
    for (const std::size_t i : {0u, 1u}) unload(i);
  }

  /// Validation accepts what one camera sees, a soft wall, and rejects what the other one does: edges as sharp as they
  /// cannot be at this rate.
  void see_a_wall() {
    constexpr std::size_t kPairs = 9;
    cv::Mat wall, edges(kHeight, kWidth, CV_8UC1);
    cv::GaussianBlur(texture(), wall, {}, 12);
    for (int x = 0; x < kWidth; ++x) edges.col(x).setTo(x / 8 % 2 == 0 ? 0 : 255);
    for (const std::size_t i : {0u, 1u}) {
      set(i, "validation", std::string("likelihood"));
      ASSERT_NO_FATAL_FAILURE(load(i));
    }
    // The first images of a camera are waited for by nobody: these leave at once.
    for (const std::size_t i : {0u, 1u}) {
      StereoTest::publish(i, kStart - kPeriod, "mono12");
      ASSERT_TRUE(wait_for(i, 1));
    }
    for (std::size_t k = 1; k < kPairs; ++k) {
      const TimeNs stamp_ns = kStart + static_cast<TimeNs>(k - 1) * kPeriod;
      publish(0, stamp_ns, wall);
      publish(1, stamp_ns, edges);
      publish_imu(k == 1 ? kStart - 50 * kMs : stamp_ns + kImuPeriod, stamp_ns + kPeriod);
      for (const std::size_t i : {0u, 1u}) ASSERT_TRUE(wait_for(i, k + 1)) << "camera " << i << ", pair " << k;
    }
    for (std::size_t k = 1; k < kPairs; ++k) {
      EXPECT_EQ(cameras_[1].fields[k]->reason, BlurField::REASON_NONE) << "it is processed";
      EXPECT_FALSE(changed(1, k));
    }
    for (const std::size_t i : {0u, 1u}) unload(i);
  }
};

TEST_F(StereoPairTest, BothPassThroughWhenOneIsOverloaded) {
  ASSERT_NO_FATAL_FAILURE(overload());
  expect_pairs(8, 0);
  for (std::size_t k = 0; k < 7; ++k) {
    EXPECT_EQ(cameras_[0].fields[k]->reason, BlurField::REASON_STEREO_PARTNER);
    EXPECT_NE(
        cameras_[0].fields[k]->reason_text.find(cameras_[1].ns + "/image_raw passes this image through: OVERLOAD"),
        std::string::npos)
        << cameras_[0].fields[k]->reason_text;
    EXPECT_EQ(cameras_[0].images[k].get(), cameras_[0].inputs[k].get());
  }
  EXPECT_TRUE(changed(0, 7)) << "the newest is deblurred by both";
}

TEST_F(StereoPairTest, EachOnItsOwnWhenOneIsOverloaded) {
  for (const std::size_t i : {0u, 1u}) set(i, "stereo_sync_timeout", 0.0);
  ASSERT_NO_FATAL_FAILURE(overload());
  expect_pairs(8, 7);
}

TEST_F(StereoPairTest, BothStayBlurredWhenValidationRejectsTheWholeOfOne) {
  ASSERT_NO_FATAL_FAILURE(see_a_wall());
  expect_pairs(9, 0);
  for (std::size_t k = 1; k < 9; ++k) EXPECT_EQ(cameras_[0].fields[k]->reason, BlurField::REASON_STEREO_PARTNER);
}

TEST_F(StereoPairTest, EachOnItsOwnWhenValidationRejectsTheWholeOfOne) {
  for (const std::size_t i : {0u, 1u}) set(i, "stereo_sync_timeout", 0.0);
  ASSERT_NO_FATAL_FAILURE(see_a_wall());
  expect_pairs(9, 8);
}

TEST_F(StereoPairTest, BadImageTakesItsPartnerAlongWhereBothDropThem) {
  for (const std::size_t i : {0u, 1u}) {
    set(i, "drop_poor", true);
    if (i == 1) set(i, "max_extent", 3.0);  // nothing of it is undone
    ASSERT_NO_FATAL_FAILURE(load(i));
  }
  // The first images of a camera are waited for by nobody: these leave at once.
  for (const std::size_t i : {0u, 1u}) {
    StereoTest::publish(i, kStart - kPeriod, "mono12");
    ASSERT_TRUE(wait_for(i, 1));
  }
  constexpr std::size_t kPairs = 4;
  for (std::size_t k = 1; k <= kPairs; ++k) {
    const TimeNs stamp_ns = kStart + static_cast<TimeNs>(k - 1) * kPeriod;
    for (const std::size_t i : {0u, 1u}) StereoTest::publish(i, stamp_ns);
    publish_imu(k == 1 ? kStart - 50 * kMs : stamp_ns + kImuPeriod, stamp_ns + kPeriod, 3.0);
    for (const Camera& camera : cameras_) {
      ASSERT_TRUE(mailbox_.wait([&] { return camera.fields.size() == k + 1; })) << camera.ns << ", pair " << k;
      // Of the second one nothing is undone, so that the first one is left, too: both are POOR.
      const std::string& text = camera.fields[k]->reason_text;
      EXPECT_EQ(text.find("drop_poor: the image of "), 0u) << text;
      EXPECT_NE(text.find("/image_raw is POOR"), std::string::npos) << text;
    }
  }
  EXPECT_EQ(cameras_[0].fields[1]->status[0], BlurField::REJECTED)
      << "its stereo partner keeps it from being deblurred";
  for (const std::size_t i : {0u, 1u}) {
    unload(i);
    EXPECT_EQ(cameras_[i].images.size(), 1u);
  }
}

TEST_F(StereoTest, OtherLimitsOfStampsAreNotShared) {
  nh_.setParam(cameras_[1].ns + "/deblur/max_gyro_gap", 0.06);
  for (const std::size_t i : {0u, 1u}) ASSERT_NO_FATAL_FAILURE(load(i));
  EXPECT_EQ(SharedImu::count(), 2u);
  publish_imu(kStart - 50 * kMs, kStart + kPeriod);
  for (const std::size_t i : {0u, 1u}) publish(i, kStart);
  for (const std::size_t i : {0u, 1u}) {
    ASSERT_TRUE(wait_for(i, 1));
    expect_deblurred(i, 1);
    unload(i);
  }
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  const gyro_deblur::test::OwnRosHome home;
  ros::init(argc, argv, "test_nodelet_faults");
  ros::AsyncSpinner spinner(2);
  spinner.start();
  return RUN_ALL_TESTS();
}
