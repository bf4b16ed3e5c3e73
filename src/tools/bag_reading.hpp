// Messages of a bag that may be damaged.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include <ros/message_traits.h>
#include <ros/time.h>
#include <rosbag/bag.h>
#include <rosbag/message_instance.h>
#include <rosbag/view.h>
#include <boost/make_shared.hpp>
#include <boost/shared_ptr.hpp>

#include "base/format.hpp"
#include "ros/deserialization.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {

/// A message that cannot be used; what() names its topic, the time at which it was recorded and its type, but not the
/// bag, which rosbag does not report.
class MessageError : public std::runtime_error {
 public:
  MessageError(const rosbag::MessageInstance& instance, const std::exception& cause)
      : std::runtime_error("topic " + instance.getTopic() + ", " + instance.getDataType() + " recorded at " +
                           seconds_text(to_time_ns(instance.getTime())) + " s: cannot be read: " + cause.what()) {}
};

/// The serialised message. Throws MessageError.
inline std::vector<std::uint8_t> read_bytes(const rosbag::MessageInstance& instance) {
  try {
    std::vector<std::uint8_t> bytes(instance.size());
    ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
    instance.write(stream);
    return bytes;
  } catch (const std::exception& error) {
    throw MessageError(instance, error);
  }
}

/// The message; null when it is of another type. Throws MessageError.
template <typename Message>
boost::shared_ptr<Message> read_message(const rosbag::MessageInstance& instance) {
  if (instance.getMD5Sum() != ros::message_traits::md5sum<Message>()) return nullptr;
  const std::vector<std::uint8_t> bytes = read_bytes(instance);
  auto message = boost::make_shared<Message>();
  try {
    deserialize_checked(bytes.data(), bytes.size(), message.get());
  } catch (const std::exception& error) {
    throw MessageError(instance, error);
  }
  return message;
}

/// Calls `take(message)` for the messages of the type on the topics that were recorded in [begin, end], in
/// their order. Throws MessageError.
template <typename Message, typename Take>
void for_each_message(const rosbag::Bag& bag, const std::vector<std::string>& topics, Take take,
                      ros::Time begin = ros::TIME_MIN, ros::Time end = ros::TIME_MAX) {
  rosbag::View view(bag, rosbag::TopicQuery(topics), begin, end);
  for (const rosbag::MessageInstance& instance : view) {
    const boost::shared_ptr<Message> message = read_message<Message>(instance);
    if (message) take(*message);
  }
}

}  // namespace gyro_deblur
