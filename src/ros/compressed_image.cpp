// Decodes compressed images.
#include "ros/compressed_image.hpp"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <sensor_msgs/image_encodings.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/image_format.hpp"
#include "ros/image_conversion.hpp"

namespace gyro_deblur {
namespace {

namespace encodings = sensor_msgs::image_encodings;
using Bytes = std::vector<std::uint8_t>;

// Markers of ITU-T T.81, table B.1; each follows a byte 0xFF.
constexpr std::uint8_t kMarker = 0xFF, kStartOfImage = 0xD8, kStartOfScan = 0xDA, kEndOfImage = 0xD9;

/// True for a JPEG whose data ends before the end-of-image marker. Within a scan 0xFF is followed by 0 or by a restart
/// marker, so that the marker is found by its bytes there; a preview image within the segments before has its own.
bool lacks_end_marker(const Bytes& data) {
  if (data.size() < 2 || data[0] != kMarker || data[1] != kStartOfImage) return false;
  std::size_t at = 2;
  while (at + 3 < data.size() && data[at] == kMarker && data[at + 1] != kStartOfScan) {
    at += 2 + (std::size_t{data[at + 2]} << 8 | data[at + 3]);
  }
  for (; at + 1 < data.size(); ++at) {
    if (data[at] == kMarker && data[at + 1] == kEndOfImage) return false;
  }
  return true;
}

/// True when the image's last 8x8 px, JPEG's unit, are all equal: what libjpeg gives where data is missing.
bool is_last_unit_flat(const cv::Mat& image) {
  constexpr int kUnitPx = 8;
  const cv::Rect last(cv::Point((image.cols - 1) / kUnitPx * kUnitPx, (image.rows - 1) / kUnitPx * kUnitPx),
                      cv::Point(image.cols, image.rows));
  const cv::Mat values = image(last).clone().reshape(1, last.area());
  for (int channel = 0; channel < values.cols; ++channel) {
    double least = 0, most = 0;
    cv::minMaxLoc(values.col(channel), &least, &most);
    if (least != most) return false;
  }
  return true;
}

/// Empty when it cannot be decoded.
cv::Mat decode(const Bytes& data) {
  if (data.empty()) return {};
  try {
    return cv::imdecode(data, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    return {};  // the same as data that is none
  }
}

/// Brings the colours of decoded pixels into the order of `named`, a colour encoding.
/// @param is_bgr  they are in BGR order, as OpenCV has them; else in RGB order
/// @return the encoding: the depth is that of the pixels
std::string reorder(const std::string& named, bool is_bgr, cv::Mat* pixels) {
  const bool wants_bgr = named.compare(0, 3, "bgr") == 0, wants_alpha = encodings::hasAlpha(named);
  const bool exchange = is_bgr != wants_bgr;
  if (exchange || pixels->channels() != (wants_alpha ? 4 : 3)) {
    const int code = wants_alpha ? (exchange ? cv::COLOR_BGR2RGBA : cv::COLOR_BGR2BGRA)
                                 : (exchange ? cv::COLOR_BGR2RGB : cv::COLOR_BGRA2BGR);
    cv::Mat reordered;
    cv::cvtColor(*pixels, reordered, code);
    *pixels = reordered;
  }
  return std::string(wants_bgr ? "bgr" : "rgb") + (wants_alpha ? "a" : "") + (pixels->depth() == CV_16U ? "16" : "8");
}

std::string refusal(const sensor_msgs::CompressedImage& compressed) {
  const std::string what = std::to_string(compressed.data.size()) + " bytes of format \"" + compressed.format + "\"";
  if (compressed.format.find("compressedDepth") != std::string::npos) {
    return what + " are a depth image, which has no motion blur to remove: choose a topic with camera images";
  }
  return what + " are not an image that OpenCV can decode: check the camera's cable, its bandwidth and its driver";
}

}  // namespace

std::string encoding_of(const cv::Mat& pixels) {
  const int channels = pixels.channels();
  if ((pixels.depth() != CV_8U && pixels.depth() != CV_16U) || channels == 2 || channels > 4) return {};
  return std::string(channels == 1 ? "mono" : channels == 3 ? "bgr" : "bgra") + (pixels.depth() == CV_16U ? "16" : "8");
}

DecodedImage decode_image(const sensor_msgs::CompressedImage& compressed) {
  // compressedDepth puts a header of its own before the data.
  if (compressed.format.find("compressedDepth") != std::string::npos) return {nullptr, refusal(compressed)};
  const bool is_cut = lacks_end_marker(compressed.data);
  cv::Mat pixels;
  if (is_cut) {
    // With an end libjpeg fills what is missing with grey; without, OpenCV leaves there what the memory held.
    Bytes ended = compressed.data;
    ended.insert(ended.end(), {kMarker, kEndOfImage});
    pixels = decode(ended);
  } else {
    pixels = decode(compressed.data);
  }
  sensor_msgs::Image like;
  like.header = compressed.header;
  like.encoding = encoding_of(pixels);
  if (pixels.empty() || like.encoding.empty()) return {nullptr, refusal(compressed)};

  std::string problem;
  // Some drivers leave out the marker alone.
  if (is_cut && is_last_unit_flat(pixels)) {
    problem = "the JPEG ends after " + std::to_string(compressed.data.size()) +
              " bytes, before its last pixels: check the camera's cable, its bandwidth and its driver";
  }
  const std::size_t semicolon = compressed.format.find(';');
  if (semicolon != std::string::npos) {
    const std::string named = compressed.format.substr(0, semicolon);
    const std::optional<int> named_type = type_of_encoding(named);
    if (encodings::isColor(named) && pixels.channels() >= 3) {
      const bool is_bgr = compressed.format.find("compressed bgr", semicolon) != std::string::npos;
      like.encoding = reorder(named, is_bgr, &pixels);
    } else if (named_type && *named_type == pixels.type()) {
      like.encoding = named;
    }
  }
  return {to_image(pixels, like), problem};
}

}  // namespace gyro_deblur
