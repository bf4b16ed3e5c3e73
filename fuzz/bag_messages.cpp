// Any bytes as serialised messages of the four streams, one after the other: those that can be read are taken, in any
// order, and every image leaves.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "input_bytes.hpp"
#include "one_camera.hpp"
#include "ros/deserialization.hpp"

namespace {

using gyro_deblur::fuzz::InputBytes;

/// The next message, or null when the bytes are not one.
template <typename Message>
boost::shared_ptr<Message> take(InputBytes* bytes) {
  const auto size = std::min<std::size_t>(bytes->take<std::uint16_t>(), bytes->size());
  std::vector<std::uint8_t> own;
  own.reserve(size + 1);  // the stream wants a pointer, also to nothing
  own.assign(bytes->data(), bytes->data() + size);
  bytes->skip(size);
  auto message = boost::make_shared<Message>();
  try {
    gyro_deblur::deserialize_checked(own.data(), own.size(), message.get());
  } catch (const std::exception&) {  // std::bad_alloc too is one: what is announced is there
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
