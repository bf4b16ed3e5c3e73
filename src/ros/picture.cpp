// Compares images pixel by pixel.
#include "ros/picture.hpp"

#include <cstddef>
#include <cstring>
#include <optional>

#include "ros/image_conversion.hpp"

namespace gyro_deblur {

bool show_same_pixels(const sensor_msgs::Image& a, const sensor_msgs::Image& b) {
  if (a.width != b.width || a.height != b.height || a.encoding != b.encoding || a.is_bigendian != b.is_bigendian) {
    return false;
  }
  // Not sensor_msgs::image_encodings, which does not know every encoding of newer releases and throws.
  const std::optional<int> type = type_of_encoding(a.encoding);
  if (!type) return false;
  const std::size_t row_bytes = a.width * static_cast<std::size_t>(CV_ELEM_SIZE(*type));
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
