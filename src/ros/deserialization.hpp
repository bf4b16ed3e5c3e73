// Messages from bytes that may be damaged.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include <ros/serialization.h>

namespace gyro_deblur {

/// What ros::serialization::IStream is, but an array that is longer than the bytes that remain is refused before memory
/// is allocated for it. roscpp allocates first: a damaged length costs up to 32 GiB then, and in 32 bits the bytes of
/// 2^29 + 1 doubles are 8, so that the message even counts as whole.
class CheckedStream : public ros::serialization::Stream {
 public:
  static const ros::serialization::StreamType stream_type = ros::serialization::stream_types::Input;

  CheckedStream(std::uint8_t* data, std::uint32_t size) : Stream(data, size) {}

  template <typename T>
  void next(T& value) {
    ros::serialization::deserialize(*this, value);
  }

  /// Throws std::length_error with both numbers.
  template <typename T, typename Allocator>
  void next(std::vector<T, Allocator>& values) {
    std::uint32_t announced = 0;
    if (getLength() >= sizeof(announced)) {  // else deserialize finds that there is no length
      std::memcpy(&announced, getData(), sizeof(announced));
      const std::size_t left = getLength() - sizeof(announced);
      // Messages in an array have at least one byte each.
      constexpr std::size_t kElementBytes = std::is_arithmetic_v<T> ? sizeof(T) : 1;
      if (announced > left / kElementBytes) {
        throw std::length_error("an array of " + std::to_string(announced) + " elements is announced where " +
                                std::to_string(left) + " bytes are left");
      }
    }
    ros::serialization::deserialize(*this, values);
  }
};

/// Reads `message` from its serialisation. Throws std::length_error or ros::serialization::StreamOverrunException (a
/// std::runtime_error) when the bytes are not one; `message` may have changed then.
template <typename Message>
void deserialize_checked(const std::uint8_t* bytes, std::size_t size, Message* message) {
  // The stream takes a pointer to what it may write to, but reading does not.
  CheckedStream stream(const_cast<std::uint8_t*>(bytes), static_cast<std::uint32_t>(size));
  ros::serialization::deserialize(stream, *message);
}

}  // namespace gyro_deblur
