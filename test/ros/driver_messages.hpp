// Messages of drivers whose packages are not there, as they come over the wire.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "gyro_deblur/time.hpp"
#include "message_builders.hpp"
#include "ros/conversions.hpp"

namespace gyro_deblur::test {

/// Bytes of a message as ROS serialises it, put together by hand: no generated code is there.
class Bytes {
 public:
  template <typename T>
  Bytes& add(T value) {
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(&value);
    data.insert(data.end(), bytes, bytes + sizeof(T));
    return *this;
  }
  Bytes& text(const std::string& value) {
    add<std::uint32_t>(static_cast<std::uint32_t>(value.size()));
    data.insert(data.end(), value.begin(), value.end());
    return *this;
  }
  Bytes& header(TimeNs stamp_ns) {
    const ros::Time stamp = to_ros_time(stamp_ns);
    return add<std::uint32_t>(7).add(stamp.sec).add(stamp.nsec).text(kCameraFrame);
  }

  std::vector<std::uint8_t> data;
};

inline const std::string kHeader =
    "================================================================================\nMSG: std_msgs/Header\n"
    "# comment\nuint32 seq\ntime stamp\nstring frame_id\n";

// wiki.ros.org/image_exposure_msgs, docs.ros.org/en/noetic/api/realsense2_camera.
inline const std::string kSequence =
    "Header header\nuint32[] shutter # several\nfloat32 gain\nuint16 white_balance_blue\nuint16 white_balance_red\n" +
    kHeader;
inline const std::string kMetadata = "std_msgs/Header header\nstring json_data\n" + kHeader;
/// Of realsense2_camera/Metadata.
inline Bytes metadata(TimeNs stamp_ns, const std::string& json) { return Bytes().header(stamp_ns).text(json); }

}  // namespace gyro_deblur::test
