// Any bytes as serialised messages of the four streams, one after the other: those that can be read are taken, in any
// order, and every image leaves.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <ros/serialization.h>

#include "input_bytes.hpp"
#include "one_camera.hpp"

namespace {

using gyro_deblur::fuzz::InputBytes;

/// True when the bytes announce a longer array than they have. roscpp makes room for it before it looks, which is a
/// std::bad_alloc, or gigabytes of zeros; that is roscpp's to mend, and not looked for here.
/// @param after_encoding  bytes between the message's one string behind the size and its one array
bool announces_too_much(InputBytes bytes, std::size_t after_encoding, std::size_t element_bytes) {
  constexpr std::size_t kSeqAndStamp = 12, kHeightAndWidth = 8;
  bytes.skip(kSeqAndStamp);
  bytes.skip(bytes.take<std::uint32_t>());  // frame_id
  bytes.skip(kHeightAndWidth);
  bytes.skip(bytes.take<std::uint32_t>());  // encoding or distortion_model
  bytes.skip(after_encoding);
  return bytes.take<std::uint32_t>() > bytes.size() / element_bytes;
}
bool announces_too_much(const InputBytes& bytes, const sensor_msgs::Image*) {
  constexpr std::size_t kByteOrderAndStep = 5;
  return announces_too_much(bytes, kByteOrderAndStep, 1);
}
bool announces_too_much(const InputBytes& bytes, const sensor_msgs::CameraInfo*) {
  return announces_too_much(bytes, 0, sizeof(double));
}
bool announces_too_much(const InputBytes&, const void*) { return false; }  // no arrays

/// The next message, or null when the bytes are not one.
template <typename Message>
boost::shared_ptr<Message> take(InputBytes* bytes) {
  const auto size = std::min<std::size_t>(bytes->take<std::uint16_t>(), bytes->size());
  std::vector<std::uint8_t> own(bytes->data(), bytes->data() + size);  // the stream wants them writable
  own.reserve(1);                                                      // and a pointer, also to nothing
  bytes->skip(size);
  auto message = boost::make_shared<Message>();
  if (announces_too_much(InputBytes(own.data(), own.size()), message.get())) return nullptr;
  try {
    ros::serialization::IStream stream(own.data(), static_cast<std::uint32_t>(own.size()));
    ros::serialization::deserialize(stream, *message);
  } catch (const ros::serialization::StreamOverrunException&) {
    return nullptr;
  }
  return message;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  InputBytes bytes(data, size);
  gyro_deblur::fuzz::OneCamera camera;
  camera.add_motion();
  while (!bytes.empty()) {
    switch (bytes.choice(5)) {
      case 0:
        if (const auto imu = take<sensor_msgs::Imu>(&bytes)) camera.processor().add_imu(*imu);
        break;
      case 1:
        if (const auto image = take<sensor_msgs::Image>(&bytes)) camera.add_image(image);
        break;
      case 2:
        if (const auto info = take<sensor_msgs::CameraInfo>(&bytes)) camera.processor().add_camera_info(info);
        break;
      case 3:
        if (const auto exposure = take<gyro_deblur::Exposure>(&bytes)) camera.processor().add_exposure(*exposure);
        break;
      default:
        camera.advance();
        break;
    }
  }
  camera.finish();
  return 0;
}
