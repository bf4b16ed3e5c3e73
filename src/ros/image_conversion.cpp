// Converts image messages to pixels and back.
#include "ros/image_conversion.hpp"

#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <string>

#include <sensor_msgs/image_encodings.h>
#include <boost/make_shared.hpp>

#include "base/format.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {
namespace {

bool host_is_big_endian() {
  const std::uint16_t probe = 1;
  std::uint8_t first_byte = 0;
  std::memcpy(&first_byte, &probe, 1);
  return first_byte == 0;
}

struct PixelType {
  PixelLayout layout;
  int cv_type;
};

std::optional<PixelType> find_pixel_type(const std::string& encoding) {
  const std::optional<PixelLayout> layout = layout_of_encoding(encoding);
  if (!layout) return std::nullopt;
  // sensor_msgs' own function does not know all of them; the names of those that have a layout contain the depth.
  const int depth = encoding.find("16") == std::string::npos ? CV_8U : CV_16U;
  return PixelType{*layout, CV_MAKETYPE(depth, channels_of(*layout))};
}

PixelType pixel_type_of(const std::string& encoding) {
  if (const std::optional<PixelType> type = find_pixel_type(encoding)) return *type;
  throw FrameError(PassThroughReason::UNSUPPORTED_ENCODING,
                   "encoding \"" + encoding +
                       "\" is not one of mono8, mono16, 8UC1, 16UC1, bgr8, rgb8, 8UC3, bgra8, rgba8, their 16-bit "
                       "variants, bayer_*8/16, yuv422 and yuv422_yuy2");
}

sensor_msgs::ImagePtr make_image(const cv::Mat& pixels, const std_msgs::Header& header, const std::string& encoding) {
  auto message = boost::make_shared<sensor_msgs::Image>();
  message->header = header;
  message->encoding = encoding;
  message->width = static_cast<std::uint32_t>(pixels.cols);
  message->height = static_cast<std::uint32_t>(pixels.rows);
  message->is_bigendian = host_is_big_endian();
  const std::size_t row_bytes = static_cast<std::size_t>(pixels.cols) * pixels.elemSize();
  message->step = static_cast<std::uint32_t>(row_bytes);
  message->data.reserve(row_bytes * static_cast<std::size_t>(pixels.rows));  // resize() would clear it first
  for (int y = 0; y < pixels.rows; ++y) {
    message->data.insert(message->data.end(), pixels.ptr(y), pixels.ptr(y) + row_bytes);
  }
  return message;
}

}  // namespace

std::optional<int> type_of_encoding(const std::string& encoding) {
  const std::optional<PixelType> type = find_pixel_type(encoding);
  return type ? std::optional<int>(type->cv_type) : std::nullopt;
}

void check_image(const sensor_msgs::Image& message) {
  if (message.width == 0 || message.height == 0) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image is empty (" + size_text(message.width, message.height) + ")");
  }
  const PixelType type = pixel_type_of(message.encoding);
  constexpr std::uint32_t kLargestSide = std::numeric_limits<std::int16_t>::max();
  if (message.width > kLargestSide || message.height > kLargestSide) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image size " + size_text(message.width, message.height) +
                                                       " is outside [1, " + std::to_string(kLargestSide) + "] px");
  }
  if (is_yuv422(type.layout) && message.width % 2 != 0) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image width = " + std::to_string(message.width) + " is odd, " +
                                                       message.encoding +
                                                       " has one colour for each two pixels of a row");
  }
  const std::size_t row_bytes = static_cast<std::size_t>(message.width) * CV_ELEM_SIZE(type.cv_type);
  if (message.step < row_bytes || message.step % CV_ELEM_SIZE1(type.cv_type) != 0) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image step = " + std::to_string(message.step) + " does not fit " +
                                                       std::to_string(message.width) + " pixels of " +
                                                       message.encoding + " (" + std::to_string(row_bytes) + " bytes)");
  }
  const std::size_t needed = static_cast<std::size_t>(message.step) * message.height;
  if (message.data.size() < needed) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image data has " + std::to_string(message.data.size()) +
                                                       " bytes, step * height = " + std::to_string(needed));
  }
}

ImageView view_image(const sensor_msgs::Image& message) {
  check_image(message);
  const PixelType type = pixel_type_of(message.encoding);
  // cv::Mat has no read-only form; ImageView forbids writing.
  auto* data = const_cast<std::uint8_t*>(message.data.data());
  cv::Mat image(static_cast<int>(message.height), static_cast<int>(message.width), type.cv_type, data, message.step);
  if (CV_MAT_DEPTH(type.cv_type) == CV_16U && (message.is_bigendian != 0) != host_is_big_endian()) {
    image = image.clone();
    for (int y = 0; y < image.rows; ++y) {
      auto* row = image.ptr<std::uint16_t>(y);
      const int values = image.cols * image.channels();
      for (int x = 0; x < values; ++x) row[x] = static_cast<std::uint16_t>((row[x] << 8) | (row[x] >> 8));
    }
  }
  return {image, type.layout};
}

sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const sensor_msgs::Image& input) {
  return make_image(pixels, input.header, input.encoding);
}

sensor_msgs::ImagePtr to_bgr_image(const cv::Mat& bgr, const std_msgs::Header& header) {
  return make_image(bgr, header, sensor_msgs::image_encodings::BGR8);
}

sensor_msgs::ImagePtr to_mono_image(const cv::Mat& gray, const std_msgs::Header& header) {
  return make_image(gray, header, sensor_msgs::image_encodings::MONO8);
}

}  // namespace gyro_deblur
