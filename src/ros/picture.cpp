#include "ros/picture.hpp"

#include <cstddef>
#include <cstdint>
#include <cstring>

#include <sensor_msgs/image_encodings.h>

namespace gyro_deblur {

bool show_same_pixels(const sensor_msgs::Image& a, const sensor_msgs::Image& b) {
  if (a.width != b.width || a.height != b.height || a.encoding != b.encoding || a.is_bigendian != b.is_bigendian) {
    return false;
  }
  namespace encodings = sensor_msgs::image_encodings;
  constexpr int kBitsOfByte = 8;
  const auto pixel_bytes =
      static_cast<std::size_t>(encodings::numChannels(a.encoding) * encodings::bitDepth(a.encoding) / kBitsOfByte);
  const std::size_t row_bytes = a.width * pixel_bytes;
  if (a.step == row_bytes && b.step == row_bytes) {
    return std::memcmp(a.data.data(), b.data.data(), row_bytes * a.height) == 0;
  }
  for (std::size_t y = 0; y < a.height; ++y) {
    if (std::memcmp(a.data.data() + y * a.step, b.data.data() + y * b.step, row_bytes) != 0) return false;
  }
  return true;
}

PictureTracker::Shown PictureTracker::add(const sensor_msgs::ImageConstPtr& image, TimeNs stamp_ns) {
  if (image_ && stamp_ns >= picture_->stamp_ns && show_same_pixels(*image_, *image)) return {picture_, false};
  image_ = image;
  picture_ = std::make_shared<Picture>();
  picture_->stamp_ns = stamp_ns;
  return {picture_, true};
}

}  // namespace gyro_deblur
