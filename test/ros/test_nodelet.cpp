// The nodelet in a manager, and the node, as their users see them. Waits for messages and conditions with a deadline;
// time never decides.
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <diagnostic_msgs/DiagnosticArray.h>
#include <dynamic_reconfigure/Reconfigure.h>
#include <gtest/gtest.h>
#include <nodelet/NodeletList.h>
#include <nodelet/NodeletLoad.h>
#include <nodelet/NodeletUnload.h>
#include <ros/header.h>
#include <ros/master.h>
#include <ros/network.h>
#include <ros/ros.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <rosgraph_msgs/Log.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud.h>
#include <std_msgs/Header.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>
#include <topic_tools/shape_shifter.h>
#include <visualization_msgs/MarkerArray.h>
#include <xmlrpcpp/XmlRpcClient.h>
#include <xmlrpcpp/XmlRpcValue.h>
#include <opencv2/imgcodecs.hpp>

#include "camera_topics.hpp"
#include "driver_messages.hpp"
#include "message_builders.hpp"
#include "ros/messages.hpp"
#include "rotating_camera.hpp"
#include "run_program.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

constexpr char kManager[] = "/manager";
constexpr double kShortTimeoutS = 0.2;

/// True when the node counts this one among the subscribers of the topic (wiki.ros.org/ROS/Slave_API, getBusInfo).
bool publishes_to_us(const std::string& node, const std::string& topic) {
  XmlRpc::XmlRpcValue request, response, uri, info;
  request[0] = ros::this_node::getName();
  request[1] = node;
  std::string host;
  std::uint32_t port = 0;
  if (!ros::master::execute("lookupNode", request, response, uri, false) ||
      !ros::network::splitURI(static_cast<std::string&>(uri), host, port)) {
    return false;
  }
  XmlRpc::XmlRpcClient client(host.c_str(), static_cast<int>(port));
  XmlRpc::XmlRpcValue caller;
  caller[0] = ros::this_node::getName();
  if (!client.execute("getBusInfo", caller, info) || info.size() < 3) return false;
  for (int i = 0; i < info[2].size(); ++i) {
    XmlRpc::XmlRpcValue& connection = info[2][i];
    enum { DESTINATION = 1, DIRECTION = 2, TOPIC = 4 };
    if (static_cast<std::string&>(connection[DESTINATION]) == ros::this_node::getName() &&
        static_cast<std::string&>(connection[DIRECTION]) == "o" &&
        static_cast<std::string&>(connection[TOPIC]) == topic) {
      return true;
    }
  }
  return false;
}

class NodeletTest : public CameraTopicsTest {
 protected:
  NodeletTest() : CameraTopicsTest("/test", 10000) {
    log_subscriber_ = nh_.subscribe<rosgraph_msgs::Log>("/rosout", 1000, [this](const rosgraph_msgs::LogConstPtr& log) {
      mailbox_.put([&] {
        if (log->name == kManager) log_.push_back(log->msg);
      });
    });
    // The manager and the node: lines that are logged before they are connected are lost.
    EXPECT_TRUE(poll_until([this] { return log_subscriber_.getNumPublishers() >= 2; }));
  }

  ~NodeletTest() override {
    if (loaded_) unload();
    nodelet::NodeletList list;
    EXPECT_TRUE(ros::service::call(std::string(kManager) + "/list", list)) << "the manager has to survive everything";
  }

  void load() {
    nodelet::NodeletLoad request;
    request.request.name = name_;
    request.request.type = "gyro_deblur/DeblurNodelet";
    const std::string service = std::string(kManager) + "/load_nodelet";
    ASSERT_TRUE(ros::service::waitForService(service, ros::Duration(30)));
    ASSERT_TRUE(ros::service::call(service, request));
    ASSERT_TRUE(request.response.success);
    loaded_ = true;
  }

  void unload() {
    nodelet::NodeletUnload request;
    request.request.name = name_;
    EXPECT_TRUE(ros::service::call(std::string(kManager) + "/unload_nodelet", request));
    EXPECT_TRUE(request.response.success);
    loaded_ = false;
  }

  /// Subscribes to the outputs and waits until everything is connected.
  void connect() {
    image_subscriber_ = nh_.subscribe<sensor_msgs::Image>(
        ns_ + "/deblurred/image_raw", 100,
        [this](const sensor_msgs::ImageConstPtr& m) { mailbox_.put([&] { images_.push_back(m); }); });
    info_subscriber_ = nh_.subscribe<sensor_msgs::CameraInfo>(
        ns_ + "/deblurred/camera_info", 100,
        [this](const sensor_msgs::CameraInfoConstPtr& m) { mailbox_.put([&] { infos_.push_back(m); }); });
    field_subscriber_ = nh_.subscribe<BlurField>(
        ns_ + "/blur_field", 100, [this](const BlurFieldConstPtr& m) { mailbox_.put([&] { fields_.push_back(m); }); });
    keypoint_subscriber_ = nh_.subscribe<KeypointArray>(
        ns_ + "/keypoints", 100,
        [this](const KeypointArrayConstPtr& m) { mailbox_.put([&] { keypoints_.push_back(m); }); });
    ASSERT_TRUE(poll_until([this] {
      return image_subscriber_.getNumPublishers() > 0 && info_subscriber_.getNumPublishers() > 0 &&
             field_subscriber_.getNumPublishers() > 0 && keypoint_subscriber_.getNumPublishers() > 0 &&
             inputs_connected();
    }));
    // A subscriber may be connected before the publisher counts it; what is published in between is lost.
    for (const ros::Subscriber* subscriber :
         {&image_subscriber_, &info_subscriber_, &field_subscriber_, &keypoint_subscriber_}) {
      ASSERT_TRUE(poll_until([&] { return publishes_to_us(node_, subscriber->getTopic()); })) << subscriber->getTopic();
    }
  }

  /// Somebody who listens to an output and does nothing with it.
  template <typename Message>
  ros::Subscriber ignore(const std::string& output) {
    const boost::function<void(const boost::shared_ptr<const Message>&)> nothing = [](const auto&) {};
    return nh_.subscribe<Message>(ns_ + "/" + output, 1, nothing);
  }

  void start() {
    load();
    connect();
  }

  /// Waits until `count` frames have come out on all topics.
  void expect_frames(std::size_t count) {
    const bool came = mailbox_.wait([&] {
      return std::min({images_.size(), infos_.size(), fields_.size(), keypoints_.size()}) >= count;
    });
    // Thrown, so that the test that looks at the frames next ends here.
    if (!came) throw std::runtime_error(std::to_string(images_.size()) + " of " + std::to_string(count) + " frames");
    // More may be coming.
    mailbox_.look([&] {
      for (std::size_t i = 0; i < count; ++i) {
        EXPECT_EQ(images_[i]->header.stamp, fields_[i]->header.stamp);
        EXPECT_EQ(images_[i]->header.stamp, infos_[i]->header.stamp);
        EXPECT_EQ(images_[i]->header.stamp, keypoints_[i]->header.stamp);
      }
    });
  }
  /// Waits until blur fields of `fields` frames have come out, and all the rest of `leave` of them; no more have.
  void expect_frames_but_dropped(std::size_t fields, std::size_t leave) {
    const bool came = mailbox_.wait([&] {
      return fields_.size() >= fields && std::min({images_.size(), infos_.size(), keypoints_.size()}) >= leave;
    });
    if (!came) throw std::runtime_error(std::to_string(images_.size()) + " of " + std::to_string(leave) + " frames");
    mailbox_.look([&] {
      EXPECT_EQ(images_.size(), leave);
      EXPECT_EQ(infos_.size(), leave);
      EXPECT_EQ(keypoints_.size(), leave);
    });
  }
  /// Waits until all of `count` frames but two have come out: fewer wait than overload takes.
  void keep_up_with(std::size_t count) {
    if (count > 2) expect_frames(count - 2);
  }
  void expect_reason(std::size_t index, PassThroughReason reason) {
    ASSERT_GT(fields_.size(), index);
    EXPECT_STREQ(to_string(static_cast<PassThroughReason>(fields_[index]->reason)), to_string(reason))
        << fields_[index]->reason_text;
  }
  void expect_deblurred(std::size_t index, const sensor_msgs::Image& input) {
    expect_reason(index, PassThroughReason::NONE);
    EXPECT_EQ(images_[index]->header.stamp, input.header.stamp);
    EXPECT_EQ(images_[index]->encoding, input.encoding);
    EXPECT_EQ(images_[index]->data.size(), input.data.size());
    EXPECT_FALSE(images_[index]->data == input.data);
  }
  void expect_identical(std::size_t index, const sensor_msgs::Image& input) {
    ASSERT_GT(images_.size(), index);
    // Everything but header.seq, which roscpp counts for every publisher.
    const sensor_msgs::Image& output = *images_[index];
    EXPECT_EQ(output.header.stamp, input.header.stamp);
    EXPECT_EQ(output.header.frame_id, input.header.frame_id);
    EXPECT_EQ(output.width, input.width);
    EXPECT_EQ(output.height, input.height);
    EXPECT_EQ(output.encoding, input.encoding);
    EXPECT_EQ(output.step, input.step);
    EXPECT_EQ(output.is_bigendian, input.is_bigendian);
    EXPECT_TRUE(output.data == input.data);
  }
  bool wait_for_log(const std::string& part) {
    return mailbox_.wait([&] { return count_log(part) > 0; });
  }
  std::size_t count_log(const std::string& part) const {
    return static_cast<std::size_t>(std::count_if(
        log_.begin(), log_.end(), [&](const std::string& line) { return line.find(part) != std::string::npos; }));
  }

  std::string node_ = kManager;  // that publishes
  bool loaded_ = false;
  Mailbox mailbox_;
  std::vector<sensor_msgs::ImageConstPtr> images_;
  std::vector<sensor_msgs::CameraInfoConstPtr> infos_;
  std::vector<BlurFieldConstPtr> fields_;
  std::vector<KeypointArrayConstPtr> keypoints_;
  std::vector<std::string> log_;
  ros::Subscriber image_subscriber_, info_subscriber_, field_subscriber_, keypoint_subscriber_, log_subscriber_;
};

TEST_F(NodeletTest, SharpFramesComeOutBitIdenticalInOrder) {
  start();
  std::vector<sensor_msgs::ImagePtr> inputs;
  publish_imu(kStart - 50 * kMs, kStart + kSecond, 0.0);
  for (std::size_t i = 0; i < 20; ++i) {
    inputs.push_back(publish_frame(kStart + static_cast<TimeNs>(i) * 33 * kMs));
    keep_up_with(inputs.size());
  }
  expect_frames(20);
  for (std::size_t i = 0; i < 20; ++i) {
    expect_reason(i, PassThroughReason::NONE);
    expect_identical(i, *inputs[i]);
  }
}

/// The statuses of the nodelet's diagnostics, as they come.
class Diagnostics {
 public:
  Diagnostics(const std::string& name, Mailbox* mailbox) : mailbox_(mailbox) {
    ros::NodeHandle nh;
    subscriber_ = nh.subscribe<diagnostic_msgs::DiagnosticArray>(
        "/diagnostics", 100, [this, name](const diagnostic_msgs::DiagnosticArrayConstPtr& array) {
          mailbox_->put([&] {
            for (const auto& status : array->status) {
              const std::string prefix = name + ": ";
              if (("/" + status.name).rfind(prefix, 0) != 0) continue;
              statuses[("/" + status.name).substr(prefix.size())] = status;
            }
            summarise();
          });
        });
  }
  bool wait_for(const std::string& key, const std::string& value) {
    return mailbox_->wait([&] {
      const auto found = values.find(key);
      return found != values.end() && found->second == value;
    });
  }
  /// Counters that are zero are left out.
  bool wait_without(const std::string& key) {
    return mailbox_->wait([&] { return values.count("output rate [Hz]") > 0 && values.count(key) == 0; });
  }
  std::map<std::string, diagnostic_msgs::DiagnosticStatus> statuses;  // the newest of each name
  std::map<std::string, std::string> values;                          // of all of them
  std::string message;
  int level = -1;  // the highest

 private:
  void summarise() {
    values.clear();
    message.clear();
    level = -1;
    for (const auto& [name, status] : statuses) {
      level = std::max<int>(level, status.level);
      message += status.message + '\n';
      for (const auto& value : status.values) values[value.key] = value.value;
    }
  }

  Mailbox* mailbox_;
  ros::Subscriber subscriber_;
};

TEST_F(NodeletTest, FrameWaitsForALateImu) {
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  publish_imu(kStart - 50 * kMs, kStart + 20 * kMs);
  const auto input = publish_frame(kStart);
  ASSERT_TRUE(diagnostics.wait_for("frames waiting", "1"));
  EXPECT_TRUE(mailbox_.look([this] { return images_.empty(); }));
  publish_imu(kStart + 25 * kMs, kStart + 60 * kMs);
  expect_frames(1);
  expect_deblurred(0, *input);
  EXPECT_FALSE(keypoints_[0]->keypoints.empty());
  ASSERT_TRUE(diagnostics.wait_without("frames waiting"));
  EXPECT_TRUE(mailbox_.wait([&] { return !diagnostics.values["engine"].empty(); }));
}

TEST_F(NodeletTest, HealthyDiagnosticsAreFourShortStatuses) {
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  ASSERT_TRUE(mailbox_.wait([&] { return diagnostics.values.count("output rate [Hz]") > 0; }));
  publish_imu(kStart - 50 * kMs, kStart + 460 * kMs);
  TimeNs stamp_ns = kStart - 40 * kMs;
  std::size_t frames = 0;
  // Until a report has the frames' times.
  ASSERT_TRUE(poll_until([&] {
    stamp_ns += 40 * kMs;
    publish_imu(stamp_ns + 465 * kMs, stamp_ns + 500 * kMs);
    publish_frame(stamp_ns);
    expect_frames(++frames);
    return mailbox_.look([&] { return diagnostics.values.count("deconvolution mean [ms]") > 0; });
  }));
  mailbox_.look([&] {
    EXPECT_EQ(diagnostics.statuses.size(), 4u);
    for (const std::string name : {"image", "IMU", "calibration", "timing"}) {
      ASSERT_EQ(diagnostics.statuses.count(name), 1u) << name;
      const diagnostic_msgs::DiagnosticStatus& status = diagnostics.statuses[name];
      EXPECT_EQ(status.level, diagnostic_msgs::DiagnosticStatus::OK) << name << ": " << status.message;
      EXPECT_GT(status.values.size(), 0u) << name;
      EXPECT_LE(status.values.size(), 15u) << name;
      for (const auto& value : status.values) EXPECT_NE(value.value, "0") << value.key;
    }
    EXPECT_EQ(diagnostics.statuses["image"].values.front().key, "output rate [Hz]");
  });
}

// The nodelet reads the file; the latched topic replaces it, whenever it comes.
TEST_F(NodeletTest, MaskComesFromTheFileThenFromTheTopic) {
  const std::string path = (std::filesystem::temp_directory_path() / "gyro_deblur_test_mask.png").string();
  cv::Mat left(kHeight, kWidth, CV_8UC1, cv::Scalar(0));
  left.colRange(0, kWidth / 2).setTo(255);
  ASSERT_TRUE(cv::imwrite(path, left));
  set("mask", path);
  start();
  std::filesystem::remove(path);
  const auto masked_columns = [this](std::size_t frame) {
    const BlurField& field = *fields_[frame];
    std::vector<bool> masked(field.cols);
    for (std::size_t i = 0; i < masked.size(); ++i) masked[i] = field.status[i] == BlurField::MASKED;
    return masked;
  };
  publish_imu(kStart - 50 * kMs, kStart + 500 * kMs);
  publish_frame(kStart);
  expect_frames(1);
  EXPECT_EQ(masked_columns(0), (std::vector<bool>{false, false, false, true, true, true}));
  for (const auto& keypoint : keypoints_[0]->keypoints) EXPECT_LT(keypoint.x, kWidth / 2);

  ros::Publisher publisher = nh_.advertise<sensor_msgs::Image>(ns_ + "/mask", 1, true);
  sensor_msgs::Image like;
  like.encoding = "mono8";
  publisher.publish(to_image(cv::Mat(255 - left), like));
  // It is taken in some time after it has been sent.
  TimeNs stamp_ns = kStart;
  std::size_t frames = 1;
  const std::vector<bool> swapped{true, true, true, false, false, false};
  ASSERT_TRUE(poll_until([&] {
    stamp_ns += 40 * kMs;  // longer than the exposure
    publish_imu(stamp_ns + 465 * kMs, stamp_ns + 500 * kMs);
    publish_frame(stamp_ns);
    expect_frames(++frames);
    return masked_columns(frames - 1) == swapped;
  }));

  like.encoding = "bgr8";
  publisher.publish(to_image(cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar::all(1)), like));
  EXPECT_TRUE(wait_for_log("its encoding \"bgr8\" is neither mono8 nor 8UC1"));
  like.encoding = "mono8";
  publisher.publish(to_image(cv::Mat(kHeight, 2 * kWidth, CV_8UC1, cv::Scalar(1)), like));
  ASSERT_TRUE(poll_until([&] {
    stamp_ns += 40 * kMs;  // longer than the exposure
    publish_imu(stamp_ns + 465 * kMs, stamp_ns + 500 * kMs);
    publish_frame(stamp_ns);
    expect_frames(++frames);
    return count_log("has 384x128, the images have 192x128") > 0;
  }));
  expect_reason(frames - 1, PassThroughReason::NONE);
}

TEST_F(NodeletTest, RejectedBlocksAreAWarning) {
  set("validation", "gradient");
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  // The warning is in one report only: somebody has to listen before the frame comes.
  ASSERT_TRUE(mailbox_.wait([&] { return diagnostics.level == diagnostic_msgs::DiagnosticStatus::OK; }));
  publish_imu(kStart - 50 * kMs, kStart + 60 * kMs);
  // Edges across the motion, sharper than this blur can leave them.
  cv::Mat edges(kHeight, kWidth, CV_8UC1);
  for (int x = 0; x < kWidth; ++x) edges.col(x).setTo(x / 8 % 2 == 0 ? 0 : 255);
  const auto input = to_image(edges, *image_message(kStart));
  info_publisher_.publish(camera_info(kStart));
  image_publisher_.publish(input);
  expect_frames(1);
  expect_reason(0, PassThroughReason::NONE);
  expect_identical(0, *input);
  const std::string blocks = std::to_string(fields_[0]->status.size());
  EXPECT_TRUE(mailbox_.wait([&] {
    return diagnostics.level == diagnostic_msgs::DiagnosticStatus::WARN &&
           diagnostics.message.find(blocks + " of " + blocks + " blurred blocks rejected") != std::string::npos;
  }));
  EXPECT_TRUE(diagnostics.wait_for("blocks", "REJECTED " + blocks));
  // One report later there is nothing new.
  EXPECT_TRUE(mailbox_.wait([&] { return diagnostics.level == diagnostic_msgs::DiagnosticStatus::OK; }));
}

TEST_F(NodeletTest, MissingImuPassesThroughWithItsReason) {
  set("input_timeout", kShortTimeoutS);
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  const auto input = publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::NO_GYRO);
  expect_identical(0, *input);
  EXPECT_TRUE(diagnostics.wait_for("passed through, NO_GYRO", "1"));
  EXPECT_TRUE(wait_for_log("NO_GYRO"));
}

TEST_F(NodeletTest, CameraIsSubscribedWhileSomebodyListens) {
  load();
  ASSERT_TRUE(poll_until([this] { return imu_publisher_.getNumSubscribers() == 1; })) << "always, to fill the buffer";
  EXPECT_EQ(image_publisher_.getNumSubscribers(), 0u);
  const auto listens = [this](ros::Subscriber subscriber) {
    EXPECT_TRUE(poll_until([this] {
      return image_publisher_.getNumSubscribers() == 1 && info_publisher_.getNumSubscribers() == 1;
    })) << subscriber.getTopic();
    const std::string topic = subscriber.getTopic();
    subscriber.shutdown();
    EXPECT_TRUE(poll_until([this] {
      return image_publisher_.getNumSubscribers() == 0 && info_publisher_.getNumSubscribers() == 0;
    })) << topic;
  };
  listens(ignore<sensor_msgs::Image>("deblurred/image_raw"));
  listens(ignore<sensor_msgs::CameraInfo>("deblurred/camera_info"));
  listens(ignore<KeypointArray>("keypoints"));
  listens(ignore<BlurField>("blur_field"));
  listens(ignore<ImageQuality>("image_quality"));
  listens(ignore<sensor_msgs::Image>("trust_mask"));
  listens(ignore<sensor_msgs::Image>("blur_overlay"));
  listens(ignore<visualization_msgs::MarkerArray>("blur_markers"));
  listens(ignore<sensor_msgs::PointCloud>("feature_tracks"));
  listens(ignore<sensor_msgs::Image>("global_shutter/image_raw"));
  listens(ignore<sensor_msgs::CameraInfo>("global_shutter/camera_info"));
  EXPECT_EQ(imu_publisher_.getNumSubscribers(), 1u);
}

TEST_F(NodeletTest, OverlayAndMarkersComeInTheImagesFrame) {
  start();
  std::vector<sensor_msgs::ImageConstPtr> overlays;
  std::vector<visualization_msgs::MarkerArrayConstPtr> markers;
  const ros::Subscriber overlay_subscriber = nh_.subscribe<sensor_msgs::Image>(
      ns_ + "/blur_overlay", 10,
      [&](const sensor_msgs::ImageConstPtr& m) { mailbox_.put([&] { overlays.push_back(m); }); });
  const ros::Subscriber marker_subscriber = nh_.subscribe<visualization_msgs::MarkerArray>(
      ns_ + "/blur_markers", 10,
      [&](const visualization_msgs::MarkerArrayConstPtr& m) { mailbox_.put([&] { markers.push_back(m); }); });
  ASSERT_TRUE(poll_until(
      [&] { return overlay_subscriber.getNumPublishers() > 0 && marker_subscriber.getNumPublishers() > 0; }));
  publish_imu(kStart - 50 * kMs, kStart + 4 * kSecond);
  // The publishers may learn of their subscribers later than these do: frames go on until both have come.
  for (TimeNs t_ns = kStart; t_ns < kStart + 3900 * kMs; t_ns += 100 * kMs) {
    publish_frame(t_ns);
    const auto frame = static_cast<std::size_t>((t_ns - kStart) / (100 * kMs)) + 1;
    expect_frames(frame);
    if (mailbox_.look([&] { return !overlays.empty() && !markers.empty(); })) break;
  }
  ASSERT_TRUE(mailbox_.wait([&] { return !overlays.empty() && !markers.empty(); }));
  EXPECT_EQ(overlays[0]->encoding, "bgr8");
  EXPECT_EQ(overlays[0]->width, static_cast<unsigned>(kWidth));
  ASSERT_EQ(markers[0]->markers.size(), 1u);
  EXPECT_EQ(markers[0]->markers[0].header.frame_id, kCameraFrame);
  EXPECT_FALSE(markers[0]->markers[0].points.empty());
}

TEST_F(NodeletTest, QualityAndTrustMaskComeWithEveryFrame) {
  start();
  std::vector<ImageQualityConstPtr> qualities;
  std::vector<sensor_msgs::ImageConstPtr> masks;
  const ros::Subscriber quality_subscriber = nh_.subscribe<ImageQuality>(
      ns_ + "/image_quality", 10,
      [&](const ImageQualityConstPtr& m) { mailbox_.put([&] { qualities.push_back(m); }); });
  const ros::Subscriber mask_subscriber = nh_.subscribe<sensor_msgs::Image>(
      ns_ + "/trust_mask", 10, [&](const sensor_msgs::ImageConstPtr& m) { mailbox_.put([&] { masks.push_back(m); }); });
  for (const ros::Subscriber* each : {&quality_subscriber, &mask_subscriber}) {
    ASSERT_TRUE(poll_until([&] { return publishes_to_us(node_, each->getTopic()); })) << each->getTopic();
  }
  publish_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  publish_frame(kStart);
  expect_frames(1);
  ASSERT_TRUE(mailbox_.wait([&] { return !qualities.empty() && !masks.empty(); }));
  EXPECT_EQ(qualities[0]->header.stamp, images_[0]->header.stamp);
  EXPECT_EQ(qualities[0]->grade, ImageQuality::DEBLURRED);
  EXPECT_EQ(qualities[0]->deblurred, 1.f);
  EXPECT_GT(qualities[0]->score, 0.25f);
  EXPECT_GT(qualities[0]->extent_median, 3.f);
  EXPECT_EQ(qualities[0]->residual_extent_p95, 0.f);
  EXPECT_EQ(masks[0]->header.stamp, images_[0]->header.stamp);
  EXPECT_EQ(masks[0]->header.frame_id, kCameraFrame);
  EXPECT_EQ(masks[0]->encoding, "mono8");
  EXPECT_EQ(masks[0]->width, static_cast<unsigned>(kWidth));
  EXPECT_EQ(masks[0]->height, static_cast<unsigned>(kHeight));
  EXPECT_EQ(masks[0]->data[kHeight / 2 * kWidth + kWidth / 2], 255);
}

TEST_F(NodeletTest, GlobalShutterImageComesWithItsCameraInfoToWhoListens) {
  start();
  std::vector<sensor_msgs::ImageConstPtr> images;
  std::vector<sensor_msgs::CameraInfoConstPtr> infos;
  const ros::Subscriber subscriber = nh_.subscribe<sensor_msgs::Image>(
      ns_ + "/global_shutter/image_raw", 10,
      [&](const sensor_msgs::ImageConstPtr& m) { mailbox_.put([&] { images.push_back(m); }); });
  const ros::Subscriber info_subscriber = nh_.subscribe<sensor_msgs::CameraInfo>(
      ns_ + "/global_shutter/camera_info", 10,
      [&](const sensor_msgs::CameraInfoConstPtr& m) { mailbox_.put([&] { infos.push_back(m); }); });
  for (const ros::Subscriber* each : {&subscriber, &info_subscriber}) {
    ASSERT_TRUE(poll_until([&] { return publishes_to_us(node_, each->getTopic()); })) << each->getTopic();
  }
  publish_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  publish_frame(kStart);
  expect_frames(1);
  ASSERT_TRUE(mailbox_.wait([&] { return !images.empty() && !infos.empty(); }));
  // Row (N - 1) / 2 begins half a row before the middle of the readout.
  const TimeNs instant_ns = kStart + kReadout * (kHeight - 1) / (2 * kHeight) + kExposure / 2;
  EXPECT_EQ(to_time_ns(images[0]->header.stamp), instant_ns);
  EXPECT_EQ(to_time_ns(infos[0]->header.stamp), instant_ns);
  EXPECT_EQ(images[0]->header.frame_id, kCameraFrame);
  EXPECT_EQ(infos[0]->K, infos_[0]->K);
  EXPECT_EQ(images[0]->encoding, images_[0]->encoding);
  EXPECT_NE(images[0]->data, images_[0]->data);
}

dynamic_reconfigure::Config reconfigure(const std::string& name, const dynamic_reconfigure::Config& change) {
  dynamic_reconfigure::Reconfigure request;
  request.request.config = change;
  EXPECT_TRUE(ros::service::waitForService(name + "/set_parameters", ros::Duration(30)));
  EXPECT_TRUE(ros::service::call(name + "/set_parameters", request));
  return request.response.config;
}

dynamic_reconfigure::Config with_double(const std::string& key, double value) {
  dynamic_reconfigure::Config config;
  config.doubles.emplace_back();
  config.doubles.back().name = key;
  config.doubles.back().value = value;
  return config;
}

dynamic_reconfigure::Config with_int(const std::string& key, int value) {
  dynamic_reconfigure::Config config;
  config.ints.emplace_back();
  config.ints.back().name = key;
  config.ints.back().value = value;
  return config;
}

dynamic_reconfigure::Config with_string(const std::string& key, const std::string& value) {
  dynamic_reconfigure::Config config;
  config.strs.emplace_back();
  config.strs.back().name = key;
  config.strs.back().value = value;
  return config;
}

template <typename List>
auto value_of(const List& list, const std::string& key) {
  const auto found = std::find_if(list.begin(), list.end(), [&](const auto& entry) { return entry.name == key; });
  if (found == list.end()) throw std::out_of_range(key);
  return found->value;
}

TEST_F(NodeletTest, BadParameterPassesFramesThroughUntilItIsCorrected) {
  set("noise_to_signal_ratio", -1.0);
  start();
  EXPECT_TRUE(wait_for_log("noise_to_signal_ratio = -1"));
  publish_imu(kStart - 50 * kMs, kStart + 500 * kMs);
  const auto first = publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::BAD_CONFIGURATION);
  EXPECT_NE(fields_[0]->reason_text.find("noise_to_signal_ratio = -1"), std::string::npos) << fields_[0]->reason_text;
  EXPECT_NE(fields_[0]->reason_text.find("1e-05"), std::string::npos) << "the range: " << fields_[0]->reason_text;
  expect_identical(0, *first);

  const auto config = reconfigure(name_, with_double("noise_to_signal_ratio", 0.02));
  EXPECT_EQ(value_of(config.doubles, "noise_to_signal_ratio"), 0.02);
  EXPECT_EQ(value_of(config.ints, "block_size"), 32);
  const auto second = publish_frame(kStart + 33 * kMs);
  expect_frames(2);
  expect_deblurred(1, *second);
}

TEST_F(NodeletTest, RefusedParameterIsStillRefusedAfterReloading) {
  set("noise_to_signal_ratio", 5.0);
  load();
  EXPECT_TRUE(wait_for_log("noise_to_signal_ratio = 5"));
  unload();
  double ratio = 0;
  EXPECT_TRUE(nh_.getParam(name_ + "/noise_to_signal_ratio", ratio));
  EXPECT_EQ(ratio, 5.0) << "what the user wrote stays on the parameter server";
  start();
  publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::BAD_CONFIGURATION);
}

TEST_F(NodeletTest, TracksGoOnFromFrameToFrame) {
  start();
  std::vector<sensor_msgs::PointCloudConstPtr> tracks;
  const ros::Subscriber subscriber = nh_.subscribe<sensor_msgs::PointCloud>(
      ns_ + "/feature_tracks", 100,
      [&](const sensor_msgs::PointCloudConstPtr& m) { mailbox_.put([&] { tracks.push_back(m); }); });
  ASSERT_TRUE(poll_until([&] { return subscriber.getNumPublishers() > 0; }));
  publish_imu(kStart - 50 * kMs, kStart + 4 * kSecond, 0.0);
  // The publisher may learn of its subscriber later than this does: frames go on until three have come.
  for (TimeNs t_ns = kStart; t_ns < kStart + 3900 * kMs; t_ns += 100 * kMs) {
    publish_frame(t_ns);
    expect_frames(static_cast<std::size_t>((t_ns - kStart) / (100 * kMs)) + 1);
    if (mailbox_.look([&] { return tracks.size() >= 3; })) break;
  }
  ASSERT_TRUE(mailbox_.wait([&] { return tracks.size() >= 3; }));
  EXPECT_TRUE(tracks[0]->points.empty()) << "nothing has been seen twice yet";
  ASSERT_FALSE(tracks[2]->points.empty());
  ASSERT_EQ(tracks[2]->channels.size(), 8u);
  for (const std::size_t variance : {5u, 7u}) {
    for (const float value_px2 : tracks[2]->channels[variance].values) EXPECT_TRUE(value_px2 > 0 && value_px2 < 100);
  }
  EXPECT_EQ(tracks[2]->header.frame_id, kCameraFrame);
  // The same image: the same corners, and perhaps some that were found later.
  const std::vector<float>&before = tracks[1]->channels[0].values, &after = tracks[2]->channels[0].values;
  ASSERT_GE(after.size(), before.size());
  EXPECT_TRUE(std::equal(before.begin(), before.end(), after.begin()));
}

TEST_F(NodeletTest, CompressedImagesNeedNoPlugin) {
  set("image_transport", std::string("compressed"));
  const ros::Publisher publisher = nh_.advertise<sensor_msgs::CompressedImage>(ns_ + "/image_raw/compressed", 10);
  load();
  const ros::Subscriber subscriber = nh_.subscribe<sensor_msgs::Image>(
      ns_ + "/deblurred/image_raw", 10,
      [this](const sensor_msgs::ImageConstPtr& m) { mailbox_.put([&] { images_.push_back(m); }); });
  ASSERT_TRUE(poll_until([&] {
    return subscriber.getNumPublishers() > 0 && publisher.getNumSubscribers() == 1 &&
           info_publisher_.getNumSubscribers() == 1 && imu_publisher_.getNumSubscribers() == 1;
  }));
  publish_imu(kStart - 50 * kMs, kStart + 200 * kMs, 0.0);
  const auto image = image_message(kStart);
  sensor_msgs::CompressedImage compressed;
  compressed.header = image->header;
  compressed.format = "mono8; png compressed ";
  cv::imencode(".png", view_image(*image).image, compressed.data);
  info_publisher_.publish(camera_info(kStart));
  publisher.publish(compressed);
  ASSERT_TRUE(mailbox_.wait([&] { return !images_.empty(); }));
  expect_identical(0, *image);
}

TEST_F(NodeletTest, CompressedImagesThatCannotBeDecodedAreLeftOutAndCounted) {
  set("image_transport", std::string("compressed"));
  const ros::Publisher publisher = nh_.advertise<sensor_msgs::CompressedImage>(ns_ + "/image_raw/compressed", 10);
  image_publisher_ = publisher;
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  ASSERT_TRUE(mailbox_.wait([&] { return diagnostics.level == diagnostic_msgs::DiagnosticStatus::OK; }));
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  constexpr int kFrames = 6, kGarbage = 1, kCut = 3;
  for (int i = 0; i < kFrames; ++i) {
    const TimeNs stamp_ns = kStart + i * 33 * kMs;
    sensor_msgs::CompressedImage compressed;
    compressed.header = image_message(stamp_ns)->header;
    compressed.format = "rgb8; jpeg compressed bgr8";
    cv::imencode(".jpg", texture(CV_8UC3), compressed.data);
    if (i == kGarbage) std::fill(compressed.data.begin(), compressed.data.end(), 7);
    if (i == kCut) compressed.data.resize(compressed.data.size() / 2);
    const auto info = camera_info(stamp_ns);
    info->D[0] = 1e-3 * i;  // each image's own
    info_publisher_.publish(info);
    publisher.publish(compressed);
  }
  expect_frames(kFrames - 1);
  const int numbers[] = {0, 2, 3, 4, 5};
  for (std::size_t i = 0; i < kFrames - 1; ++i) {
    EXPECT_EQ(to_time_ns(images_[i]->header.stamp), kStart + numbers[i] * 33 * kMs);
    EXPECT_EQ(images_[i]->width, static_cast<unsigned>(kWidth));
    EXPECT_EQ(images_[i]->height, static_cast<unsigned>(kHeight));
    EXPECT_EQ(images_[i]->encoding, "rgb8");
    EXPECT_EQ(infos_[i]->D[0], 1e-3 * numbers[i]);
    expect_reason(i, numbers[i] == kCut ? PassThroughReason::BAD_IMAGE : PassThroughReason::NONE);
  }
  EXPECT_TRUE(wait_for_log("compressed image 100.033000000 is left out"));
  EXPECT_TRUE(diagnostics.wait_for("compressed images left out, not decodable", "1"));
  EXPECT_TRUE(diagnostics.wait_for("frames in", std::to_string(kFrames - 1)));
}

/// A way of drivers to send camera_info.
struct InfoHabit {
  const char* name;
  std::function<void(sensor_msgs::CameraInfo*)> change;
  const char* log;  ///< line that reports it; null: none
  bool latched = false, with_file = false;
};

TEST_F(NodeletTest, CameraInfoOfEveryHabitServes) {
  const std::string file = (std::filesystem::temp_directory_path() / "nodelet_camchain.yaml").string();
  const sensor_msgs::CameraInfoPtr described = camera_info(kStart);
  std::ofstream(file) << "cam0:\n  camera_model: pinhole\n  intrinsics: [" << kFocalPx << ", " << kFocalPx << ", "
                      << described->K[2] << ", " << described->K[5]
                      << "]\n  distortion_model: none\n  distortion_coeffs: []\n  resolution: [" << kWidth << ", "
                      << kHeight << "]\n";
  const InfoHabit habits[] = {
      {"not calibrated, with a file",
       [](sensor_msgs::CameraInfo* info) {
         info->K.fill(0);
         info->P.fill(0);
         info->R.fill(0);
         info->D.clear();
         info->distortion_model.clear();
       },
       nullptr, false, true},
      {"stamp 0", [](sensor_msgs::CameraInfo* info) { info->header.stamp = ros::Time(); },
       "camera_info has the stamp 0"},
      {"latched", [](sensor_msgs::CameraInfo* info) { info->header.stamp = ros::Time(5); },
       "images no longer wait for it", true},
      {"no size", [](sensor_msgs::CameraInfo* info) { info->width = info->height = 0; },
       "camera_info has width and height 0"},
  };
  set("input_timeout", kShortTimeoutS);
  set("drop_poor", true);
  constexpr std::size_t kFrames = 8;
  for (const InfoHabit& habit : habits) {
    SCOPED_TRACE(habit.name);
    set("calibration_file", habit.with_file ? file : std::string());
    info_publisher_.shutdown();  // or the next one would be latched as it was
    info_publisher_ = nh_.advertise<sensor_msgs::CameraInfo>(ns_ + "/camera_info", 10, habit.latched);
    const auto info_of = [&](TimeNs stamp_ns) {
      const auto info = camera_info(stamp_ns);
      habit.change(info.get());
      return info;
    };
    if (habit.latched) info_publisher_.publish(info_of(kStart));
    mailbox_.put([this] { images_.clear(), infos_.clear(), fields_.clear(), keypoints_.clear(); });
    start();
    publish_imu(kStart - 50 * kMs, kStart + kSecond);
    std::vector<sensor_msgs::ImagePtr> inputs;
    for (std::size_t i = 0; i < kFrames; ++i) {
      inputs.push_back(image_message(kStart + static_cast<TimeNs>(i) * 33 * kMs));
      if (!habit.latched) info_publisher_.publish(info_of(to_time_ns(inputs.back()->header.stamp)));
      image_publisher_.publish(inputs.back());
      // Of a latched one the first three images show that there is no other.
      if (!habit.latched || i >= 2) expect_frames(i + 1);
    }
    for (std::size_t i = 0; i < kFrames; ++i) expect_deblurred(i, *inputs[i]);
    if (habit.log) {
      EXPECT_TRUE(wait_for_log(habit.log));
    }
    unload();
  }
  std::filesystem::remove(file);
}

TEST_F(NodeletTest, ImagesWithoutAStampPassInOrder) {
  set("drop_poor", true);
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  publish_imu(kStart - 50 * kMs, kStart + 2 * kSecond);
  std::vector<sensor_msgs::ImagePtr> inputs;
  constexpr std::size_t kFrames = 20, kEvery = 10, kFirst = 4;
  for (std::size_t i = 0; i < kFrames; ++i) {
    inputs.push_back(image_message(i % kEvery == kFirst ? 0 : kStart + static_cast<TimeNs>(i) * 33 * kMs));
    info_publisher_.publish(camera_info(to_time_ns(inputs.back()->header.stamp)));
    image_publisher_.publish(inputs.back());
    keep_up_with(inputs.size());
  }
  expect_frames(kFrames);
  for (std::size_t i = 0; i < kFrames; ++i) {
    if (i % kEvery == kFirst) {
      expect_reason(i, PassThroughReason::NO_STAMP);
      expect_identical(i, *inputs[i]);
    } else {
      expect_deblurred(i, *inputs[i]);
    }
  }
  EXPECT_TRUE(diagnostics.wait_for("passed through, NO_STAMP", "2"));
  EXPECT_TRUE(diagnostics.wait_without("time jumps"));
}

TEST_F(NodeletTest, UnknownTransportLeavesTheManagerAlive) {
  set("image_transport", std::string("pigeon"));
  load();
  const ros::Subscriber listener = ignore<sensor_msgs::Image>("deblurred/image_raw");
  EXPECT_TRUE(wait_for_log("pigeon"));
}

TEST_F(NodeletTest, BadParametersOfEveryKindAreNamed) {
  set("R_cam_imu", std::vector<double>{1, 0, 0, 0, 1, 0, 0, 0, -1});
  start();
  publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::BAD_CONFIGURATION);
  EXPECT_NE(fields_[0]->reason_text.find("R_cam_imu"), std::string::npos) << fields_[0]->reason_text;
  const auto& key_and_value = std::vector<std::pair<std::string, double>>{
      {"noise_to_signal_ratio", -3}, {"min_extent", 1000}, {"time_offset", 1e10}, {"exposure_time", -0.01}};
  for (const auto& [key, value] : key_and_value) {
    unload();
    set("R_cam_imu", std::vector<double>{1, 0, 0, 0, 1, 0, 0, 0, 1});
    set(key, value);
    mailbox_.put([this] { images_.clear(), infos_.clear(), fields_.clear(), keypoints_.clear(); });
    start();
    publish_frame(kStart);
    expect_frames(1);
    expect_reason(0, PassThroughReason::BAD_CONFIGURATION);
    EXPECT_NE(fields_[0]->reason_text.find(key), std::string::npos) << fields_[0]->reason_text;
    nh_.deleteParam(name_ + "/" + key);
  }
}

TEST_F(NodeletTest, ParametersChangeWhileRunning) {
  start();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  const auto first = publish_frame(kStart);
  expect_frames(1);
  expect_deblurred(0, *first);
  EXPECT_EQ(value_of(reconfigure(name_, with_double("max_extent", 3)).doubles, "max_extent"), 3);
  const auto second = publish_frame(kStart + 33 * kMs);
  expect_frames(2);
  expect_reason(1, PassThroughReason::NONE);
  EXPECT_EQ(fields_[1]->status[0], BlurField::TOO_LARGE);
  expect_identical(1, *second);
  EXPECT_EQ(value_of(reconfigure(name_, with_int("block_size", 64)).ints, "block_size"), 64);
  publish_frame(kStart + 66 * kMs);
  expect_frames(3);
  EXPECT_EQ(fields_[2]->block_width, 64u);
}

// rosparam reads 2e-2 and 3e0 as strings.
TEST_F(NodeletTest, NumbersThatCameAsStringsAreNumbers) {
  set("exposure_time", std::string("2e-2"));
  set("max_extent", std::string("3e0"));
  start();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::NONE);
  EXPECT_EQ(fields_[0]->exposure_time.toNSec(), 20 * kMs);
  EXPECT_EQ(fields_[0]->status[0], BlurField::TOO_LARGE);
  // A change of another parameter leaves it as it is.
  const auto values = reconfigure(name_, with_int("block_size", 64));
  EXPECT_EQ(value_of(values.ints, "block_size"), 64);
  EXPECT_EQ(value_of(values.doubles, "max_extent"), 3);
}

TEST_F(NodeletTest, BadImagesAreDroppedWhereTheUserSaysSo) {
  set("max_extent", 3.0);
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  // The warning is in one report only: somebody has to listen before the frame comes.
  ASSERT_TRUE(mailbox_.wait([&] { return diagnostics.level == diagnostic_msgs::DiagnosticStatus::OK; }));
  publish_imu(kStart - 50 * kMs, kStart + kSecond, 3.0);
  publish_frame(kStart);
  expect_frames(1);
  dynamic_reconfigure::Config drop_poor;
  drop_poor.bools.resize(1);
  drop_poor.bools[0].name = "drop_poor";
  drop_poor.bools[0].value = true;
  reconfigure(name_, drop_poor);
  // Without listeners of image_quality.
  const auto bad = publish_frame(kStart + 33 * kMs);
  ASSERT_TRUE(mailbox_.wait([&] { return fields_.size() == 2; }));
  EXPECT_EQ(fields_[1]->header.stamp, bad->header.stamp);
  EXPECT_EQ(fields_[1]->reason, BlurField::REASON_NONE);
  EXPECT_NE(fields_[1]->reason_text.find("drop_poor: "), std::string::npos) << fields_[1]->reason_text;
  // All in one report: the next one warns no more.
  EXPECT_TRUE(mailbox_.wait([&] {
    const auto dropped = diagnostics.values.find("images dropped, POOR");
    return dropped != diagnostics.values.end() && dropped->second == "1" &&
           diagnostics.level == diagnostic_msgs::DiagnosticStatus::WARN &&
           diagnostics.message.find("1 images dropped by drop_poor") != std::string::npos;
  }));
  drop_poor.bools[0].value = false;
  reconfigure(name_, drop_poor);
  const auto next = publish_frame(kStart + 66 * kMs);
  expect_frames_but_dropped(3, 2);
  EXPECT_EQ(images_[1]->header.stamp, next->header.stamp);
  EXPECT_TRUE(diagnostics.wait_for("frames out", "2"));
}

TEST_F(NodeletTest, RefusedChangeRestoresTheFormerValues) {
  start();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  EXPECT_EQ(value_of(reconfigure(name_, with_int("block_size", 33)).ints, "block_size"), 32);
  EXPECT_EQ(value_of(reconfigure(name_, with_string("keypoint_detector", "nonsense")).strs, "keypoint_detector"),
            "FAST");
  EXPECT_TRUE(wait_for_log("block_size = 33"));
  EXPECT_TRUE(wait_for_log("nonsense"));
  const auto input = publish_frame(kStart);
  expect_frames(1);
  expect_deblurred(0, *input);
  EXPECT_EQ(fields_[0]->block_width, 32u);
}

TEST_F(NodeletTest, ExposureFromMessageElseParameterElseNone) {
  set("input_timeout", kShortTimeoutS);
  start();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  publish_frame(kStart);
  expect_frames(1);
  EXPECT_EQ(fields_[0]->exposure_time.toNSec(), kExposure) << "nobody publishes: the parameter";

  ros::Publisher publisher = nh_.advertise<Exposure>(ns_ + "/exposure", 10);
  ASSERT_TRUE(poll_until([&] { return publisher.getNumSubscribers() > 0; }));
  Exposure exposure;
  exposure.header.stamp = to_ros_time(kStart + 33 * kMs);
  exposure.exposure_time.fromNSec(20 * kMs);
  publisher.publish(exposure);
  publish_frame(kStart + 33 * kMs);
  expect_frames(2);
  EXPECT_EQ(fields_[1]->exposure_time.toNSec(), 20 * kMs);
  publish_frame(kStart + 66 * kMs);
  expect_frames(3);
  EXPECT_EQ(fields_[2]->exposure_time.toNSec(), kExposure) << "message missing: the parameter";
}

#ifdef DEBLUR_BAG
/// A driver's message, and how it is read.
struct DriverCase {
  std::string name, source, field, type, md5, definition;
  std::function<Bytes(TimeNs stamp_ns, std::uint32_t exposure_us)> message;
};

void PrintTo(const DriverCase& driver, std::ostream* stream) { *stream << driver.name; }

class DriverExposureTest : public NodeletTest, public testing::WithParamInterface<DriverCase> {};

TEST_P(DriverExposureTest, DrivesTheNodeletAndTheBagToolInTheSameWay) {
  const DriverCase& driver = GetParam();
  set("exposure_time", 0.0);  // without the driver's there is none
  set("exposure_source", driver.source);
  set("exposure_field", driver.field);
  topic_tools::ShapeShifter shape;
  shape.morph(driver.md5, driver.type, driver.definition, "");
  ros::Publisher publisher = shape.advertise(nh_, ns_ + "/exposure", 10);
  start();
  ASSERT_TRUE(poll_until([&] { return publisher.getNumSubscribers() > 0; }));

  namespace fs = std::filesystem;
  std::string pattern = (fs::temp_directory_path() / "driver_exposure_XXXXXX").string();
  ASSERT_NE(mkdtemp(pattern.data()), nullptr);
  const fs::path folder = pattern;
  const auto path = [&folder](const std::string& file) { return (folder / file).string(); };
  rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Write);
  constexpr TimeNs kPeriod = 100 * kMs;
  const std::vector<std::uint32_t> exposures_us{8000, 15000, 25000};
  const TimeNs end_ns = kStart + static_cast<TimeNs>(exposures_us.size()) * kPeriod;
  publish_imu(kStart - 50 * kMs, end_ns);
  for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= end_ns; t_ns += kImuPeriod) {
    bag.write(ns_ + "/imu", to_ros_time(t_ns), imu_message(t_ns, kFastRadS));
  }
  for (std::size_t i = 0; i < exposures_us.size(); ++i) {
    const TimeNs stamp_ns = kStart + static_cast<TimeNs>(i) * kPeriod;
    const auto image = publish_frame(stamp_ns);
    // Drivers send it after the image.
    Bytes bytes = driver.message(stamp_ns, exposures_us[i]);
    ros::serialization::OStream stream(bytes.data.data(), static_cast<std::uint32_t>(bytes.data.size()));
    shape.read(stream);
    publisher.publish(shape);
    bag.write(ns_ + "/image_raw", to_ros_time(stamp_ns), *image);
    bag.write(ns_ + "/camera_info", to_ros_time(stamp_ns), *camera_info(stamp_ns));
    bag.write(ns_ + "/exposure", to_ros_time(stamp_ns + 60 * kMs), shape);
  }
  bag.close();
  expect_frames(exposures_us.size());

  std::ofstream(path("config.yaml")) << "exposure_time: 0\nreadout_time: " << to_seconds(kReadout)
                                     << "\nR_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nblock_size: 32\nvalidation: none\n"
                                        "keypoint_detector: FAST\nkeypoint_descriptor: ORB\nexposure_source: "
                                     << driver.source << "\nexposure_field: '" << driver.field << "'\n";
  const ProgramResult result = run_program({DEBLUR_BAG, path("in.bag"), path("out.bag"), "--config",
                                            path("config.yaml"), "--exposure-topic", ns_ + "/exposure"});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  std::vector<sensor_msgs::ImageConstPtr> images;
  std::vector<BlurFieldConstPtr> fields;
  rosbag::Bag out(path("out.bag"), rosbag::bagmode::Read);
  for (const rosbag::MessageInstance& instance : rosbag::View(out)) {
    if (instance.getTopic() == ns_ + "/deblurred/image_raw")
      images.push_back(instance.instantiate<sensor_msgs::Image>());
    if (instance.getTopic() == ns_ + "/blur_field") fields.push_back(instance.instantiate<BlurField>());
  }
  ASSERT_EQ(images.size(), exposures_us.size());
  ASSERT_EQ(fields.size(), exposures_us.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    expect_reason(i, PassThroughReason::NONE);
    EXPECT_EQ(fields_[i]->exposure_time.toNSec(), 1000 * static_cast<TimeNs>(exposures_us[i]));
    EXPECT_EQ(fields[i]->exposure_time, fields_[i]->exposure_time);
    EXPECT_EQ(fields[i]->extent, fields_[i]->extent);
    expect_identical(i, *images[i]);
  }
  out.close();
  fs::remove_all(folder);
}

INSTANTIATE_TEST_SUITE_P(
    Drivers, DriverExposureTest,
    testing::Values(DriverCase{"RealSenseMetadata", "realsense_metadata_us", "", "realsense2_camera/Metadata",
                               "4966ca002be16ee67fe4dbfb2f354787", kMetadata,
                               [](TimeNs stamp_ns, std::uint32_t exposure_us) {
                                 return metadata(stamp_ns, "{\"frame_number\":12,\"actual_exposure\":" +
                                                               std::to_string(exposure_us) + ",\"gain_level\":16}");
                               }},
                    DriverCase{"FieldNextToAHeader", "field_us", "shutter[0]", "image_exposure_msgs/ExposureSequence",
                               "81d98e1e20eab8beb4bd07beeba6a398", kSequence,
                               [](TimeNs stamp_ns, std::uint32_t exposure_us) {
                                 return Bytes()
                                     .header(stamp_ns)
                                     .add<std::uint32_t>(1)
                                     .add(exposure_us)
                                     .add(3.f)
                                     .add<std::uint16_t>(1)
                                     .add<std::uint16_t>(2);
                               }}),
    [](const auto& driver) { return driver.param.name; });
#endif

TEST_F(NodeletTest, NoExposureTime) {
  set("exposure_time", 0.0);
  set("input_timeout", kShortTimeoutS);
  start();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  const auto input = publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::NO_EXPOSURE_TIME);
  expect_identical(0, *input);
}

TEST_F(NodeletTest, InputsThatDoNotComeAreReportedBeforeFramesArePublished) {
  set("exposure_time", 0.0);
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  image_publisher_.publish(image_message(kStart));
  for (const std::string part : {"exposure_time is not set, and no exposure message has come",
                                 "no camera_info has come", "no IMU message with angular rates has come"}) {
    EXPECT_TRUE(wait_for_log(part)) << part;
    EXPECT_TRUE(mailbox_.wait([&] { return diagnostics.message.find(part) != std::string::npos; })) << part;
  }
  EXPECT_TRUE(mailbox_.look([this] { return images_.empty(); })) << "the frame waits for ten seconds";
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  EXPECT_TRUE(mailbox_.wait([&] { return diagnostics.message.find("no IMU message") == std::string::npos; }));
}

TEST_F(NodeletTest, WrongUnitAndClockOfTheImuAreTold) {
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  constexpr TimeNs kYear = 31'536'000 * kSecond;
  publish_imu(kStart + kYear, kStart + kYear + kSecond, 160);
  EXPECT_TRUE(wait_for_log("are they in degrees/s"));
  // Both streams go on until the report has come.
  TimeNs passed_ns = kSecond;
  EXPECT_TRUE(poll_until([&] {
    publish_frame(kStart + passed_ns);
    publish_imu(kStart + kYear + passed_ns + kImuPeriod, kStart + kYear + passed_ns + 50 * kMs, 160);
    passed_ns += 50 * kMs;
    return mailbox_.look([this] { return count_log("do not overlap") > 0; });
  }));
  for (const std::string part : {"are they in degrees/s", "time_offset: 31536000."}) {
    EXPECT_TRUE(mailbox_.wait([&] { return diagnostics.message.find(part) != std::string::npos; })) << part;
  }
}

TEST_F(NodeletTest, TransformMayComeLater) {
  nh_.deleteParam(name_ + "/R_cam_imu");
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  const std::string camera = "camera_of" + ns_.substr(1), imu = "imu_of" + ns_.substr(1);
  for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= kStart + 100 * kMs; t_ns += kImuPeriod) {
    sensor_msgs::Imu message = imu_message(t_ns, kFastRadS);
    message.header.frame_id = imu;
    imu_publisher_.publish(message);
  }
  auto input = image_message(kStart);
  input->header.frame_id = camera;
  info_publisher_.publish(camera_info(kStart));
  image_publisher_.publish(input);
  ASSERT_TRUE(diagnostics.wait_for("frames waiting", "1"));
  EXPECT_TRUE(mailbox_.look([this] { return images_.empty(); }));

  constexpr bool kLatch = true;
  ros::Publisher publisher = nh_.advertise<tf2_msgs::TFMessage>("/tf_static", 1, kLatch);
  tf2_msgs::TFMessage transforms;
  transforms.transforms.resize(1);
  transforms.transforms[0].header.frame_id = imu;
  transforms.transforms[0].header.stamp = ros::Time::now();
  transforms.transforms[0].child_frame_id = camera;
  transforms.transforms[0].transform.rotation.w = 1;
  publisher.publish(transforms);
  expect_frames(1);
  expect_deblurred(0, *input);
}

TEST_F(NodeletTest, NoTransformPassesThroughWithItsReason) {
  nh_.deleteParam(name_ + "/R_cam_imu");
  set("input_timeout", kShortTimeoutS);
  start();
  publish_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  const auto input = publish_frame(kStart);
  expect_frames(1);
  expect_reason(0, PassThroughReason::NO_EXTRINSIC);
  expect_identical(0, *input);
}

TEST_F(NodeletTest, TimeGoingBackwardsIsOneMessageAndFramesKeepComing) {
  start();
  for (std::size_t loop = 0; loop < 3; ++loop) {
    publish_imu(kStart - 50 * kMs, kStart + kSecond);
    for (int i = 0; i < 5; ++i) publish_frame(kStart + i * 150 * kMs);
    expect_frames(5 * (loop + 1));
  }
  for (std::size_t i = 0; i < 15; ++i) {
    const bool maybe_early = i % 5 == 0 && i > 0;  // may overtake the first IMU sample of its loop
    if (!maybe_early) expect_reason(i, PassThroughReason::NONE);
    EXPECT_EQ(to_time_ns(images_[i]->header.stamp), kStart + static_cast<TimeNs>(i % 5) * 150 * kMs);
  }
  ASSERT_TRUE(mailbox_.wait([this] { return count_log("time went backwards") >= 2; }));
  // Logging keeps its order: after this line all earlier ones have come.
  reconfigure(name_, with_string("keypoint_detector", "nonsense"));
  ASSERT_TRUE(wait_for_log("nonsense"));
  EXPECT_EQ(count_log("time went backwards"), 2u);
}

TEST_F(NodeletTest, CameraInfoAbsentOrUnusable) {
  set("input_timeout", kShortTimeoutS);
  start();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  std::vector<sensor_msgs::ImagePtr> inputs;
  std::vector<sensor_msgs::CameraInfoPtr> unusable(4);
  for (std::size_t i = 0; i < 4; ++i) unusable[i] = camera_info(kStart + static_cast<TimeNs>(i) * 33 * kMs);
  unusable[1]->K.fill(0);
  unusable[2]->distortion_model = "nonsense";
  unusable[3] = camera_info(kStart + 99 * kMs, 640, 480);
  for (std::size_t i = 0; i < 4; ++i) {
    inputs.push_back(image_message(kStart + static_cast<TimeNs>(i) * 33 * kMs));
    if (i > 0) info_publisher_.publish(unusable[i]);
    image_publisher_.publish(inputs.back());
  }
  expect_frames(4);
  for (std::size_t i = 0; i < 4; ++i) {
    expect_reason(i, PassThroughReason::NO_CALIBRATION);
    expect_identical(i, *inputs[i]);
  }
}

TEST_F(NodeletTest, LostCameraInfosLoseNoFrame) {
  constexpr std::size_t kFrames = 300, kEvery = 10;
  constexpr TimeNs kPeriod = 35 * kMs;
  static_assert(kPeriod % kImuPeriod == 0);
  start();
  publish_imu(kStart - 50 * kMs, kStart + 100 * kMs, 0.0);
  // As a camera does: the next image comes whatever became of those before it. The timeout is long: what leaves does
  // not leave for it.
  for (std::size_t i = 0; i < kFrames; ++i) {
    const TimeNs stamp_ns = kStart + static_cast<TimeNs>(i) * kPeriod;
    if (i % kEvery != 3) info_publisher_.publish(camera_info(stamp_ns));
    image_publisher_.publish(image_message(stamp_ns));
    publish_imu(stamp_ns + 100 * kMs + kImuPeriod, stamp_ns + 100 * kMs + kPeriod, 0.0);
    keep_up_with(i + 1);
  }
  expect_frames(kFrames);
  EXPECT_EQ(images_.size(), kFrames);
  for (std::size_t i = 0; i < kFrames; ++i) {
    expect_reason(i, PassThroughReason::NONE);
    EXPECT_EQ(to_time_ns(images_[i]->header.stamp), kStart + static_cast<TimeNs>(i) * kPeriod);
    EXPECT_EQ(infos_[i]->K[0], kFocalPx) << i;
  }
}

/// A subscriber in another process that does not read for a while (wiki.ros.org/ROS/TCPROS).
class StalledSubscriber {
 public:
  /// Throws std::runtime_error when it cannot be connected.
  template <typename Message>
  static StalledSubscriber to(const std::string& node, const std::string& topic) {
    return StalledSubscriber(node, topic, ros::message_traits::datatype<Message>(),
                             ros::message_traits::md5sum<Message>());
  }
  ~StalledSubscriber() { close(socket_); }
  StalledSubscriber(const StalledSubscriber&) = delete;
  StalledSubscriber& operator=(const StalledSubscriber&) = delete;

  /// Reads on, until the message with this stamp. @return how many messages came
  std::size_t read_until(const ros::Time& last) {
    for (std::size_t count = 1;; ++count) {
      std::vector<std::uint8_t> bytes = read_block();
      std_msgs::Header header;
      ros::serialization::IStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
      ros::serialization::deserialize(stream, header);
      if (header.stamp == last) return count;
    }
  }

 private:
  StalledSubscriber(const std::string& node, const std::string& topic, const std::string& type,
                    const std::string& md5) {
    XmlRpc::XmlRpcValue request, response, uri, asked, answer;
    request[0] = asked[0] = kCaller;
    request[1] = node;
    std::string host;
    std::uint32_t port = 0;
    if (!ros::master::execute("lookupNode", request, response, uri, false) ||
        !ros::network::splitURI(static_cast<std::string&>(uri), host, port)) {
      throw std::runtime_error("no node " + node);
    }
    XmlRpc::XmlRpcClient client(host.c_str(), static_cast<int>(port));
    asked[1] = topic;
    asked[2][0][0] = std::string("TCPROS");
    if (!client.execute("requestTopic", asked, answer) || answer.size() < 3 || answer[2].size() < 3) {
      throw std::runtime_error("no topic " + topic);
    }
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(static_cast<int>(answer[2][2])));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socket_ = socket(AF_INET, SOCK_STREAM, 0);
    if (socket_ < 0 || connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
      throw std::runtime_error("no connection to " + topic);
    }
    const ros::M_string fields{
        {"callerid", kCaller}, {"topic", topic}, {"type", type}, {"md5sum", md5}, {"tcp_nodelay", "1"}};
    boost::shared_array<std::uint8_t> header;
    std::uint32_t length = 0;
    ros::Header::write(fields, header, length);
    if (send(socket_, &length, sizeof(length), 0) != sizeof(length) ||
        send(socket_, header.get(), length, 0) != static_cast<ssize_t>(length)) {
      throw std::runtime_error("no header to " + topic);
    }
    read_block();  // the publisher's header: it counts this as a subscriber now
  }

  void read(void* to, std::size_t bytes) {
    if (recv(socket_, to, bytes, MSG_WAITALL) != static_cast<ssize_t>(bytes)) throw std::runtime_error("cut off");
  }
  std::vector<std::uint8_t> read_block() {
    std::uint32_t length = 0;
    read(&length, sizeof(length));
    std::vector<std::uint8_t> bytes(length);
    read(bytes.data(), bytes.size());
    return bytes;
  }

  static constexpr char kCaller[] = "/stalled_subscriber";
  int socket_ = -1;
};

TEST_F(NodeletTest, AllThatLeavesAtOnceReachesASubscriber) {
  // Of 300 KiB each, far more than the kernel keeps for a connection.
  constexpr int kFrames = 60;
  set("frame_queue_size", kFrames);
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  auto recorder = StalledSubscriber::to<sensor_msgs::Image>(node_, ns_ + "/deblurred/image_raw");
  for (int i = 0; i < kFrames; ++i) {
    image_publisher_.publish(image_message(kStart + i * 33 * kMs, "mono8", 640, 480));
  }
  ASSERT_TRUE(diagnostics.wait_for("frames waiting", std::to_string(kFrames)));
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros::service::call(name_ + "/reset", reset));
  expect_frames(kFrames);
  EXPECT_EQ(recorder.read_until(images_.back()->header.stamp), static_cast<std::size_t>(kFrames));
}

TEST_F(NodeletTest, EncodingsGoodAndBadComeOutInOrder) {
  start();
  publish_imu(kStart - 50 * kMs, kStart + 2 * kSecond);
  const std::vector<std::string> good{"mono8",        "mono16", "8UC1",       "8UC3",        "bgr8",
                                      "rgb8",         "bgra8",  "rgba8",      "bayer_rggb8", "bayer_gbrg8",
                                      "bayer_bggr16", "yuv422", "yuv422_yuy2"};
  std::vector<sensor_msgs::ImagePtr> inputs;
  for (const std::string& encoding : good) {
    inputs.push_back(publish_frame(kStart + static_cast<TimeNs>(inputs.size()) * 33 * kMs, encoding));
    keep_up_with(inputs.size());
  }
  for (const std::string& bad : {std::string("32FC1"), std::string("8UC4"), std::string("nonsense")}) {
    auto image = image_message(kStart + static_cast<TimeNs>(inputs.size()) * 33 * kMs);
    image->encoding = bad;
    image_publisher_.publish(image);
    inputs.push_back(image);
  }
  auto empty = boost::make_shared<sensor_msgs::Image>();
  empty->header.stamp = to_ros_time(kStart + static_cast<TimeNs>(inputs.size()) * 33 * kMs);
  empty->encoding = "mono8";
  image_publisher_.publish(empty);
  inputs.push_back(empty);
  auto cut = image_message(kStart + static_cast<TimeNs>(inputs.size()) * 33 * kMs);
  cut->data.resize(17);
  image_publisher_.publish(cut);
  inputs.push_back(cut);
  const TimeNs last_ns = kStart + static_cast<TimeNs>(inputs.size()) * 33 * kMs;
  const auto pixel = image_message(last_ns, "mono8", 1, 1);
  info_publisher_.publish(camera_info(last_ns, 1, 1));
  image_publisher_.publish(pixel);
  inputs.push_back(pixel);

  expect_frames(inputs.size());
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    EXPECT_EQ(images_[i]->header.stamp, inputs[i]->header.stamp);
    if (i < good.size()) {
      expect_deblurred(i, *inputs[i]);
    } else if (i < good.size() + 3) {
      expect_reason(i, PassThroughReason::UNSUPPORTED_ENCODING);
      expect_identical(i, *inputs[i]);
    } else if (i < good.size() + 5) {
      expect_reason(i, PassThroughReason::BAD_IMAGE);
      expect_identical(i, *inputs[i]);
    } else {
      expect_reason(i, PassThroughReason::NONE);
    }
  }
}

TEST_F(NodeletTest, BadImuSamplesAreDroppedAndCounted) {
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  for (TimeNs t_ns = kStart - 50 * kMs; t_ns <= kStart + 100 * kMs; t_ns += kImuPeriod) {
    imu_publisher_.publish(imu_message(t_ns, kFastRadS));
    imu_publisher_.publish(imu_message(t_ns, 50));               // duplicate
    imu_publisher_.publish(imu_message(t_ns - kImuPeriod, 50));  // late
    imu_publisher_.publish(imu_message(t_ns + kMs, std::numeric_limits<double>::quiet_NaN()));
  }
  const auto input = publish_frame(kStart);
  expect_frames(1);
  expect_deblurred(0, *input);
  const std::size_t center = fields_[0]->cols * (fields_[0]->rows / 2) + fields_[0]->cols / 2;
  EXPECT_NEAR(fields_[0]->extent[center], kFocalPx * kFastRadS * to_seconds(kExposure), 0.5);
  EXPECT_TRUE(diagnostics.wait_for("imu dropped, not finite", "31"));
  EXPECT_TRUE(diagnostics.wait_for("imu dropped, duplicate", "31"));
  EXPECT_TRUE(diagnostics.wait_for("imu dropped, out of order", "31"));
}

TEST_F(NodeletTest, ResetForgetsSamples) {
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  publish_imu(kStart - 1200 * kMs, kStart + 100 * kMs);
  ASSERT_TRUE(mailbox_.wait([&] { return diagnostics.values["gyroscope buffer [s]"] == "1.300"; }));
  std_srvs::Trigger reset;
  ASSERT_TRUE(ros::service::call(name_ + "/reset", reset));
  EXPECT_TRUE(reset.response.success);
  EXPECT_TRUE(diagnostics.wait_for("gyroscope buffer [s]", "empty"));
}

/// A camera of which nothing is known but its intrinsics and exposure time.
class UnknownCalibrationTest : public NodeletTest {
 protected:
  UnknownCalibrationTest() {
    for (const char* key : {"R_cam_imu", "readout_time"}) nh_.deleteParam(name_ + "/" + key);
    set("exposure_time", to_seconds(RotatingCamera::kShownFor));
    // Images that wait for a transform leave one after the other.
    set("input_timeout", 0.02);
  }

  /// Plays images until the condition holds.
  bool play_until(const std::function<bool()>& condition) {
    for (int i = 0; i < RotatingCamera::kFrames; ++i) {
      for (const sensor_msgs::Imu& imu : camera_.samples_before(i)) imu_publisher_.publish(imu);
      info_publisher_.publish(camera_.info(i));
      image_publisher_.publish(camera_.image(i));
      expect_frames(static_cast<std::size_t>(i) + 1);
      if (mailbox_.look(condition)) return true;
    }
    return mailbox_.wait(condition);
  }

  RotatingCamera camera_;
};

TEST_F(UnknownCalibrationTest, RotationIsFoundAndUsed) {
  start();
  Diagnostics diagnostics(name_, &mailbox_);
  ASSERT_TRUE(play_until([this] { return !fields_.empty() && fields_.back()->reason == 0; }));
  mailbox_.look([this] {
    expect_reason(0, PassThroughReason::NO_EXTRINSIC);
    EXPECT_NE(fields_[0]->reason_text.find("not estimated from images yet"), std::string::npos)
        << fields_[0]->reason_text;
    EXPECT_GT(fields_.size(), 2 * RotatingCamera::kFramesPerS) << "it takes two seconds of motion";
  });
  EXPECT_TRUE(mailbox_.wait([&] { return diagnostics.values["R_cam_imu"].find("by the images") != std::string::npos; }))
      << diagnostics.values["R_cam_imu"];
  EXPECT_TRUE(mailbox_.wait([this] { return count_log("R_cam_imu is estimated from the images and used") == 1; }));
}

TEST_F(UnknownCalibrationTest, IsStoredUntilTheNextStart) {
  start();
  std_srvs::Trigger save, reset;
  ASSERT_TRUE(ros::service::call(name_ + "/save_calibration", save));
  EXPECT_FALSE(save.response.success) << save.response.message;
  ASSERT_TRUE(play_until([this] { return !fields_.empty() && fields_.back()->reason == 0; }));
  ASSERT_TRUE(ros::service::call(name_ + "/save_calibration", save));
  EXPECT_TRUE(save.response.success) << save.response.message;
  EXPECT_NE(save.response.message.find("256x192.json"), std::string::npos) << save.response.message;
  const auto load_again = [this] {
    unload();
    mailbox_.look([this] {
      images_.clear();
      infos_.clear();
      fields_.clear();
      keypoints_.clear();
    });
    camera_.rewind();
    start();
  };
  load_again();
  play_until([this] { return fields_.size() >= 3; });
  mailbox_.look([this] { expect_reason(0, PassThroughReason::NONE); });

  ASSERT_TRUE(ros::service::call(name_ + "/reset_calibration", reset));
  EXPECT_TRUE(reset.response.success) << reset.response.message;
  load_again();
  play_until([this] { return fields_.size() >= 3; });
  mailbox_.look([this] { expect_reason(0, PassThroughReason::NO_EXTRINSIC); });
}

TEST_F(UnknownCalibrationTest, WrongRotationIsNamedAndKept) {
  set("R_cam_imu", std::vector<double>{1, 0, 0, 0, 1, 0, 0, 0, 1});
  start();
  ASSERT_TRUE(play_until([this] { return count_log("R_cam_imu (parameter) contradicts the images") > 0; }));
  mailbox_.look([this] {
    for (const BlurFieldConstPtr& field : fields_) EXPECT_EQ(field->reason, 0) << field->reason_text;
  });
}

TEST_F(NodeletTest, UnloadsAndReloadsWhileFramesFlow) {
  set("input_timeout", kShortTimeoutS);
  std::mutex mutex;
  bool stop = false;
  std::thread camera([&] {
    ros::WallRate rate(50);
    for (TimeNs t_ns = kStart;; t_ns += 20 * kMs) {
      {
        const std::lock_guard<std::mutex> lock(mutex);
        if (stop) return;
      }
      publish_imu(t_ns, t_ns + 19 * kMs);
      publish_frame(t_ns - 100 * kMs);
      rate.sleep();
    }
  });
  for (int i = 0; i < 20; ++i) {
    load();
    if (!loaded_) break;
    connect();
    const std::size_t before = mailbox_.look([this] { return images_.size(); });
    EXPECT_TRUE(mailbox_.wait([&] { return images_.size() > before; })) << "reload " << i;
    unload();
    // The next one must be seen to connect anew.
    EXPECT_TRUE(poll_until([this] { return image_publisher_.getNumSubscribers() == 0; }));
  }
  {
    const std::lock_guard<std::mutex> lock(mutex);
    stop = true;
  }
  camera.join();
}

TEST_F(NodeletTest, NodeDoesTheSame) {
  ns_ = "/standalone";
  name_ = ns_ + "/deblur";
  node_ = name_;
  image_publisher_ = nh_.advertise<sensor_msgs::Image>(ns_ + "/image_raw", 100);
  info_publisher_ = nh_.advertise<sensor_msgs::CameraInfo>(ns_ + "/camera_info", 100);
  imu_publisher_ = nh_.advertise<sensor_msgs::Imu>(ns_ + "/imu", 10000);
  connect();
  publish_imu(kStart - 50 * kMs, kStart + kSecond);
  const auto input = publish_frame(kStart);
  expect_frames(1);
  expect_deblurred(0, *input);
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "test_nodelet");
  ros::AsyncSpinner spinner(2);
  spinner.start();
  return RUN_ALL_TESTS();
}
