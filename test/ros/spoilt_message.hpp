// Messages whose bytes are damaged, for bags.
#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <stdexcept>
#include <vector>

#include <ros/message_traits.h>
#include <ros/serialization.h>
#include <topic_tools/shape_shifter.h>

namespace gyro_deblur::test {

/// Does damage to a serialised message.
using Spoil = std::function<void(std::vector<std::uint8_t>*)>;

template <typename Message>
std::vector<std::uint8_t> bytes_of(const Message& message) {
  std::vector<std::uint8_t> bytes(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ros::serialization::serialize(stream, message);
  return bytes;
}

/// The message's last array says that it has `announced` elements.
/// @param elements  that it has
template <typename Element>
Spoil announce(std::uint32_t elements, std::uint32_t announced) {
  return [elements, announced](std::vector<std::uint8_t>* bytes) {
    for (std::size_t at = bytes->size() - sizeof(elements) + 1; at-- > 0;) {
      std::uint32_t length = 0;
      std::memcpy(&length, bytes->data() + at, sizeof(length));
      if (length != elements || at + sizeof(length) + elements * sizeof(Element) > bytes->size()) continue;
      std::memcpy(bytes->data() + at, &announced, sizeof(announced));
      return;
    }
    throw std::logic_error("the message has no such array");
  };
}

/// A message for rosbag::Bag::write that has the type of `message`, but not its bytes.
template <typename Message>
topic_tools::ShapeShifter spoilt(const Message& message, const Spoil& spoil) {
  namespace traits = ros::message_traits;
  std::vector<std::uint8_t> bytes = bytes_of(message);
  spoil(&bytes);
  topic_tools::ShapeShifter result;
  result.morph(traits::md5sum<Message>(), traits::datatype<Message>(), traits::definition<Message>(), "0");
  ros::serialization::IStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  result.read(stream);
  return result;
}

}  // namespace gyro_deblur::test
