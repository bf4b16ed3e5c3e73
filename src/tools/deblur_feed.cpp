#include "tools/deblur_feed.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <optional>
#include <utility>
#include <vector>

#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <tf2_msgs/TFMessage.h>

#include "ros/conversions.hpp"
#include "ros/messages.hpp"
#include "tools/bag_reading.hpp"

namespace gyro_deblur {

ros::Time Slice::read_from() const { return std::max(to_ros_time(begin_ns - lead_ns), ros::TIME_MIN); }

TimeNs lead_ns(const Config& config) {
  // Clocks that are hours apart record their messages at the same time all the same: what an image needs is among the
  // samples that are kept when it comes.
  return config.gyro.buffer_ns + std::min(std::abs(config.gyro.time_offset_ns), config.gyro.buffer_ns) +
         config.gyro_timeout_ns + config.exposure_max_age_ns;
}

DeblurFeed::DeblurFeed(const DeblurTopics& topics, const Config& config, const FrameRequest& request, Log log)
    : topics_(topics),
      driver_messages_(reads_driver_messages(config)),
      log_(std::move(log)),
      adapter_(config.exposure_source),
      processor_(environment(request)) {
  processor_.set_config(config);
}

Processor::Environment DeblurFeed::environment(const FrameRequest& request) {
  Processor::Environment environment;
  environment.clock = [this] { return now_ns_; };
  environment.log = log_;
  environment.extrinsic = [this](const std::string& camera_frame, const std::string& imu_frame) {
    return lookup_R_cam_imu(tf_buffer_, camera_frame, imu_frame);
  };
  environment.exposure_expected = [this] { return !topics_.exposure.empty(); };
  environment.request = [request] { return request; };
  return environment;
}

void DeblurFeed::take_transforms(const rosbag::Bag& bag, const std::string& topic, ros::Time until) {
  const auto take = [this](const tf2_msgs::TFMessage& message) {
    add_transforms(message, &tf_buffer_);
    return true;
  };
  for_each_message<tf2_msgs::TFMessage>(bag, {topic}, take, ros::TIME_MIN, until);
}

void DeblurFeed::catch_up(const rosbag::Bag& bag, ros::Time until) {
  take_transforms(bag, "/tf", until);
  // Where it is published once, or seldom, the last one holds.
  if (!topics_.camera_info.empty()) {
    rosbag::View infos(bag, rosbag::TopicQuery(topics_.camera_info), ros::TIME_MIN, until);
    std::optional<rosbag::MessageInstance> last;
    for (const rosbag::MessageInstance& instance : infos) last.emplace(instance);
    set_clock(to_time_ns(until));
    if (last) take(*last, false);
  }
  if (!driver_messages_ || topics_.exposure.empty()) return;
  // A setting is published when it changes, which may be long before the slice.
  rosbag::View before(bag, rosbag::TopicQuery(topics_.exposure), ros::TIME_MIN, until);
  for (const rosbag::MessageInstance& instance : before) {
    const std::vector<std::uint8_t> bytes = read_bytes(instance);
    try {
      const std::optional<ExposureReading> reading =
          adapter_.read(instance.getDataType(), instance.getMessageDefinition(), bytes.data(), bytes.size());
      if (reading && reading->stamp_ns) break;  // of single frames, not a setting
      if (reading) processor_.add_exposure_setting(reading->exposure_ns);
    } catch (const std::exception&) {
      continue;  // said by the slice that it belongs to
    }
  }
}

bool DeblurFeed::take(const rosbag::MessageInstance& instance, bool with_images) {
  const std::string& topic = instance.getTopic();
  if (topic == topics_.imu) {
    if (const auto message = read_message<sensor_msgs::Imu>(instance)) processor_.add_imu(*message);
  } else if (topic == topics_.camera_info) {
    if (const auto message = read_message<sensor_msgs::CameraInfo>(instance)) processor_.add_camera_info(message);
  } else if (topic == topics_.image) {
    return with_images && take_image(instance);
  } else if (topic == topics_.exposure) {
    take_exposure(instance);
  } else if (topic == "/tf") {
    if (const auto message = read_message<tf2_msgs::TFMessage>(instance)) add_transforms(*message, &tf_buffer_);
  }
  return false;
}

bool DeblurFeed::take_image(const rosbag::MessageInstance& instance) {
  if (topics_.compressed) {
    const auto compressed = read_message<sensor_msgs::CompressedImage>(instance);
    return compressed && processor_.add_compressed_image(*compressed);
  }
  const sensor_msgs::ImageConstPtr image = read_message<sensor_msgs::Image>(instance);
  if (!image) return false;
  processor_.add_image(image);
  return true;
}

void DeblurFeed::take_exposure(const rosbag::MessageInstance& instance) {
  if (driver_messages_) {
    // As in the nodelet: a message without an exposure time costs its frame, not the run.
    adapter_.pass_on(instance.getDataType(), instance.getMessageDefinition(), read_bytes(instance), &processor_);
  } else if (const auto message = read_message<Exposure>(instance)) {
    processor_.add_exposure(*message);
  }
}

}  // namespace gyro_deblur
