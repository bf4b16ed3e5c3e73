// An image whose header says anything about its pixels, with a camera_info that says anything about the lens.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include <sensor_msgs/image_encodings.h>

#include "input_bytes.hpp"
#include "one_camera.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace encodings = sensor_msgs::image_encodings;
  using namespace gyro_deblur::fuzz;
  InputBytes bytes(data, size);
  OneCamera camera;
  camera.add_motion();

  const auto info = good_camera_info();
  const auto image = good_image();
  const std::string names[] = {
      encodings::MONO8,        encodings::MONO16,     encodings::BGR8,     encodings::RGBA8,     encodings::BAYER_RGGB8,
      encodings::BAYER_GBRG16, encodings::RGB16,      encodings::BGRA16,   encodings::TYPE_8UC1, encodings::TYPE_16UC1,
      encodings::YUV422,       encodings::TYPE_32FC1, encodings::TYPE_8UC3};
  constexpr std::uint32_t kLargest = 64;  // any larger image is the same to the code, but slower
  const std::uint8_t which = bytes.take<std::uint8_t>();
  if (which & 1) image->width = info->width = bytes.take<std::uint8_t>() % kLargest;
  if (which & 2) image->height = info->height = bytes.take<std::uint8_t>() % kLargest;
  image->encoding = which & 4 ? names[bytes.choice(std::size(names))] : bytes.text(20);
  image->is_bigendian = bytes.take<std::uint8_t>() & 1;
  image->step = which & 8 ? bytes.take<std::uint32_t>() : bytes.take<std::uint8_t>() * 4u;
  if (which & 16) image->width = bytes.take<std::uint32_t>();
  if (which & 32) image->height = bytes.take<std::uint32_t>();
  image->data.resize(which & 64 ? bytes.take<std::uint16_t>()
                                : std::size_t{image->step % 1024} * (image->height % 1024));
  if (which & 128) {
    const std::string models[] = {"plumb_bob", "rational_polynomial", "equidistant", "", bytes.text(20)};
    info->distortion_model = models[bytes.choice(std::size(models))];
    info->D.resize(bytes.choice(10));
    for (double& coefficient : info->D) coefficient = bytes.take<double>();
    for (const std::size_t i : {0, 2, 4, 5}) info->K[i] = bytes.take<float>();
    info->binning_x = bytes.take<std::uint8_t>();
    info->binning_y = bytes.take<std::uint32_t>();
    info->roi.x_offset = bytes.take<std::uint32_t>();
    info->roi.y_offset = bytes.take<std::uint32_t>();
    info->roi.width = bytes.take<std::uint16_t>();
    info->roi.height = bytes.take<std::uint16_t>();
  }
  const std::size_t pixels = std::min(image->data.size(), bytes.size());
  std::copy_n(bytes.data(), pixels, image->data.begin());

  camera.processor().add_camera_info(info);
  camera.add_image(image);
  camera.advance();
  camera.finish();
  return 0;
}
