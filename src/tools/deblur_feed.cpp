// Feeds the messages of a bag to a processor.
#include "tools/deblur_feed.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <exception>
#include <optional>
#include <utility>
#include <vector>

#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <tf2_msgs/TFMessage.h>

#include "ros/conversions.hpp"
#include "ros/messages.hpp"
#include "tools/bag_reading.hpp"

namespace gyro_deblur {
namespace {

/// Where it is published once, or seldom, the last one holds. Null: there is none.
template <typename Message>
boost::shared_ptr<const Message> last_before(const rosbag::Bag& bag, const std::string& topic, ros::Time until) {
  if (topic.empty()) return nullptr;
  rosbag::View view(bag, rosbag::TopicQuery(topic), ros::TIME_MIN, until);
  std::optional<rosbag::MessageInstance> last;
  for (const rosbag::MessageInstance& instance : view) last.emplace(instance);
  return last ? read_message<Message>(*last) : nullptr;
}

/// @param stamp  gives the stamp of a message, see MessageStream::Message
/// @param take   is called with the pointer to a message that is delivered
template <typename Message, typename Stamp, typename Take>
MessageStream::Read reader_of(Stamp stamp, Take take) {
  return [stamp, take](const rosbag::MessageInstance& instance, MessageStream::Message* message) {
    const boost::shared_ptr<const Message> content = read_message<Message>(instance);
    if (!content) return false;
    message->stamp_ns = stamp(*content);
    message->deliver = [take, content] { take(content); };
    return true;
  };
}

constexpr auto kHeaderStamp = [](const auto& message) { return to_time_ns(message.header.stamp); };
constexpr auto kNoStamp = [](const auto&) { return std::nullopt; };

}  // namespace

TimeNs lead_ns(const Config& config) {
  // Clocks that are hours apart record their messages at the same time all the same: what an image needs is among the
  // samples that are kept when it comes.
  return config.gyro.buffer_ns + std::min(std::abs(config.gyro.time_offset_ns), config.gyro.buffer_ns) +
         config.input_timeout_ns + config.exposure_max_age_ns;
}

DeblurFeed::DeblurFeed(const rosbag::Bag& bag, const DeblurTopics& topics, const Config& config,
                       const FrameRequest& request, ros::Time from, Log log)
    : bag_(bag),
      topics_(topics),
      from_(from),
      log_(std::move(log)),
      adapter_(config.exposure_source),
      processor_(environment(request)),
      imu_(bag, topics.imu, from, config.time_jump_ns,
           reader_of<sensor_msgs::Imu>(
               [offset_ns = config.gyro.time_offset_ns](const auto& imu) { return kHeaderStamp(imu) - offset_ns; },
               [this](const auto& imu) { processor_.add_imu(*imu); })),
      camera_info_(bag, topics.camera_info, from, config.time_jump_ns,
                   reader_of<sensor_msgs::CameraInfo>(kHeaderStamp,
                                                      [this](const auto& info) { processor_.add_camera_info(info); })),
      exposure_(bag, topics.exposure, from, config.time_jump_ns,
                topics.reads_driver_messages
                    ? driver_reader()
                    : reader_of<Exposure>(kHeaderStamp,
                                          [this](const auto& exposure) { processor_.add_exposure(*exposure); })),
      transforms_(bag, "/tf", from, config.time_jump_ns, transform_reader()),
      mask_(bag, topics.mask, from, config.time_jump_ns,
            reader_of<sensor_msgs::Image>(kNoStamp, [this](const auto& mask) { processor_.add_mask(*mask); })) {
  processor_.set_config(config);
  // Latched transforms of the whole bag: a node would have them from the start.
  take_transforms(Transforms::Topic::TF_STATIC, ros::TIME_MAX);
}

Processor::Environment DeblurFeed::environment(const FrameRequest& request) {
  Processor::Environment environment;
  environment.clock = [this] { return now_ns_; };
  environment.log = log_;
  environment.extrinsic = [this](const std::string& camera_frame, const std::string& imu_frame) {
    return tf_.R_cam_imu(camera_frame, imu_frame);
  };
  environment.exposure_expected = [this] { return !topics_.exposure.empty(); };
  environment.request = [request] { return request; };
  return environment;
}

void DeblurFeed::take_transforms(Transforms::Topic topic, ros::Time until) {
  const auto take = [this, topic](const tf2_msgs::TFMessage& message) { tf_.add(message, topic); };
  const char* const name = topic == Transforms::Topic::TF_STATIC ? "/tf_static" : "/tf";
  for_each_message<tf2_msgs::TFMessage>(bag_, {name}, take, ros::TIME_MIN, until);
}

void DeblurFeed::catch_up() {
  take_transforms(Transforms::Topic::TF, from_);
  now_ns_ = to_time_ns(from_);
  if (const auto info = last_before<sensor_msgs::CameraInfo>(bag_, topics_.camera_info, from_)) {
    processor_.add_camera_info(info);
  }
  if (const auto mask = last_before<sensor_msgs::Image>(bag_, topics_.mask, from_)) processor_.add_mask(*mask);
  if (!topics_.reads_driver_messages || topics_.exposure.empty()) return;
  // A setting is published when it changes, which may be long before the slice.
  rosbag::View before(bag_, rosbag::TopicQuery(topics_.exposure), ros::TIME_MIN, from_);
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

MessageStream::Read DeblurFeed::driver_reader() {
  return [this](const rosbag::MessageInstance& instance, MessageStream::Message* message) {
    const std::vector<std::uint8_t> bytes = read_bytes(instance);
    const std::string type = instance.getDataType(), definition = instance.getMessageDefinition();
    try {
      const std::optional<ExposureReading> reading = adapter_.read(type, definition, bytes.data(), bytes.size());
      if (reading) message->stamp_ns = reading->stamp_ns;
    } catch (const std::exception&) {
      // Reported when it is delivered, when it was recorded.
    }
    message->deliver = [this, type, definition, bytes] { adapter_.pass_on(type, definition, bytes, &processor_); };
    return true;
  };
}

MessageStream::Read DeblurFeed::transform_reader() {
  return [this](const rosbag::MessageInstance& instance, MessageStream::Message* message) {
    const auto transforms = read_message<tf2_msgs::TFMessage>(instance);
    if (!transforms || transforms->transforms.empty()) return false;
    message->stamp_ns = to_time_ns(transforms->transforms.front().header.stamp);
    message->deliver = [this, transforms] { tf_.add(*transforms, Transforms::Topic::TF); };
    return true;
  };
}

TimeNs DeblurFeed::BagImage::stamp_ns() const { return to_time_ns(raw ? raw->header.stamp : compressed->header.stamp); }

void DeblurFeed::add(const rosbag::MessageInstance& instance, const Expect& expect, const Processor::Sink& sink) {
  BagImage image;
  image.recorded = instance.getTime();
  if (topics_.image.compressed) {
    image.compressed = read_message<sensor_msgs::CompressedImage>(instance);
  } else {
    image.raw = read_message<sensor_msgs::Image>(instance);
  }
  if (!image.raw && !image.compressed) return;
  images_.push_back(std::move(image));
  constexpr std::size_t kCompared = 2;  // that follow an image: one of them may have a wrong stamp
  if (images_.size() > kCompared) pass_front(expect, sink);
}

void DeblurFeed::finish(const Expect& expect, const Processor::Sink& sink) {
  while (!images_.empty()) pass_front(expect, sink);
}

TimeNs DeblurFeed::until_ns() const {
  // An image whose stamp is ahead of those that follow must not use up what they need.
  constexpr TimeNs kAheadNs = 1'000'000'000;  // stores hold some seconds
  if (images_.size() < 2) return images_.front().stamp_ns() + kAheadNs;
  TimeNs following_ns = images_[1].stamp_ns();
  for (std::size_t i = 2; i < images_.size(); ++i) following_ns = std::max(following_ns, images_[i].stamp_ns());
  return std::min(images_.front().stamp_ns(), following_ns) + kAheadNs;
}

void DeblurFeed::pass_front(const Expect& expect, const Processor::Sink& sink) {
  const TimeNs until = until_ns();
  const BagImage image = std::move(images_.front());
  images_.pop_front();
  now_ns_ = to_time_ns(image.recorded);
  deliver_due(until);
  if (image.raw) {
    processor_.add_image(image.raw);
  } else if (!processor_.add_compressed_image(*image.compressed)) {
    return;
  }
  expect(image.recorded);
  processor_.advance(sink);
  // In the order of Awaited. A bag has no stereo partner.
  const std::array<MessageStream*, 6> streams{nullptr, &camera_info_, &exposure_, &imu_, &transforms_, nullptr};
  static_assert(static_cast<std::size_t>(Awaited::STEREO_PARTNER) + 1 == streams.size());
  while (processor_.waiting() > 0) {
    MessageStream* const stream = streams.at(static_cast<std::size_t>(processor_.awaited()));
    const bool more = stream != nullptr && stream->deliver_ahead(image.stamp_ns(), until);
    if (!more) {
      // Without more of what it waits for, the frame makes do with what is there: with all that the other streams have.
      for (MessageStream* const other : {&imu_, &camera_info_, &exposure_, &transforms_}) {
        while (other->deliver_ahead(image.stamp_ns(), until)) continue;
      }
    }
    more ? processor_.advance(sink) : processor_.finish(sink);
  }
}

void DeblurFeed::deliver_due(TimeNs until_ns) {
  while (true) {
    MessageStream* earliest = nullptr;
    TimeNs recorded_ns = 0;
    for (MessageStream* const stream : {&imu_, &camera_info_, &exposure_, &transforms_, &mask_}) {
      const MessageStream::Message* message = stream->due(now_ns_, until_ns);
      if (message == nullptr || (earliest != nullptr && message->recorded_ns >= recorded_ns)) continue;
      earliest = stream;
      recorded_ns = message->recorded_ns;
    }
    if (earliest == nullptr) return;
    earliest->deliver_due();
  }
}

}  // namespace gyro_deblur
