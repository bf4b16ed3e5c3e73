// Converts image messages to pixels and back.
#include "ros/image_conversion.hpp"

#include <cstdint>
#include <limits>
#include <optional>
#include <string>

#include <boost/make_shared.hpp>

#include "base/format.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {
namespace {

int require_type(const std::string& encoding) {
  if (const std::optional<int> type = type_of_encoding(encoding)) return *type;
  throw FrameError(PassThroughReason::UNSUPPORTED_ENCODING,
                   "encoding \"" + encoding +
                       "\" is not one of mono8, mono16, 8UC1, 16UC1, bgr8, rgb8, 8UC3, bgra8, rgba8, their 16-bit "
                       "variants, bayer_*8/16, yuv422 and yuv422_yuy2");
}

}  // namespace

std::optional<int> type_of_encoding(const std::string& encoding) {
  const std::optional<PixelLayout> layout = layout_of_encoding(encoding);
  if (!layout) return std::nullopt;
  // sensor_msgs' own function does not know all of them; the names of those that have a layout contain the depth.
  const int depth = encoding.find("16") == std::string::npos ? CV_8U : CV_16U;
  return CV_MAKETYPE(depth, channels_of(*layout));
}

void check_image(const sensor_msgs::Image& message) {
  const auto refuse = [](const std::string& text) { throw FrameError(PassThroughReason::BAD_IMAGE, text); };
  if (message.width == 0 || message.height == 0) {
    refuse("image is empty (" + size_text(message.width, message.height) + ")");
  }
  const int type = require_type(message.encoding);
  constexpr std::uint32_t kLargestSide = std::numeric_limits<std::int16_t>::max();
  if (message.width > kLargestSide || message.height > kLargestSide) {
    refuse("image size " + size_text(message.width, message.height) + " is outside [1, " +
           std::to_string(kLargestSide) + "] px");
  }
  if (is_yuv422(*layout_of_encoding(message.encoding)) && message.width % 2 != 0) {
    refuse("image width = " + std::to_string(message.width) + " is odd, " + message.encoding +
           " has one colour for each two pixels of a row");
  }
  const std::size_t row_bytes = static_cast<std::size_t>(message.width) * CV_ELEM_SIZE(type);
  if (message.step < row_bytes || message.step % CV_ELEM_SIZE1(type) != 0) {
    refuse("image step = " + std::to_string(message.step) + " does not fit " + std::to_string(message.width) +
           " pixels of " + message.encoding + " (" + std::to_string(row_bytes) + " bytes)");
  }
  const std::size_t needed = static_cast<std::size_t>(message.step) * message.height;
  if (message.data.size() < needed) {
    refuse("image data has " + std::to_string(message.data.size()) +
           " bytes, step * height = " + std::to_string(needed));
  }
}

ImageView view_image(const sensor_msgs::Image& message) {
  check_image(message);
  const int type = require_type(message.encoding);
  // cv::Mat has no read-only form; ImageView forbids writing.
  auto* data = const_cast<std::uint8_t*>(message.data.data());
  cv::Mat image(static_cast<int>(message.height), static_cast<int>(message.width), type, data, message.step);
  // All machines that ROS 1 supports are little-endian.
  if (CV_MAT_DEPTH(type) == CV_16U && message.is_bigendian != 0) {
    image = image.clone();
    auto* const values = image.ptr<std::uint16_t>();
    for (std::size_t i = 0; i < image.total() * static_cast<std::size_t>(image.channels()); ++i) {
      values[i] = static_cast<std::uint16_t>((values[i] << 8) | (values[i] >> 8));
    }
  }
  return {image, *layout_of_encoding(message.encoding)};
}

sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const std_msgs::Header& header, const std::string& encoding) {
  auto message = boost::make_shared<sensor_msgs::Image>();
  message->header = header;
  message->encoding = encoding;
  message->width = static_cast<std::uint32_t>(pixels.cols);
  message->height = static_cast<std::uint32_t>(pixels.rows);
  const std::size_t row_bytes = static_cast<std::size_t>(pixels.cols) * pixels.elemSize();
  message->step = static_cast<std::uint32_t>(row_bytes);
  message->data.reserve(row_bytes * static_cast<std::size_t>(pixels.rows));  // resize() would clear it first
  for (int y = 0; y < pixels.rows; ++y) {
    message->data.insert(message->data.end(), pixels.ptr(y), pixels.ptr(y) + row_bytes);
  }
  return message;
}

sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const sensor_msgs::Image& input) {
  return to_image(pixels, input.header, input.encoding);
}

}  // namespace gyro_deblur
