#include "gyro_deblur/image_format.hpp"

#include <stdexcept>
#include <unordered_map>

#include <opencv2/imgproc.hpp>

namespace gyro_deblur {
namespace {

// 65535 / 255: takes full scale to full scale.
constexpr double kScale16To8 = 1.0 / 257.0;

/// Colour of a mosaic. OpenCV names a pattern by the second row's second and third pixel, ROS by the first row's first
/// two.
int demosaicing(PixelLayout layout) {
  switch (layout) {
    case PixelLayout::BAYER_RGGB:
      return cv::COLOR_BayerBG2BGR;
    case PixelLayout::BAYER_BGGR:
      return cv::COLOR_BayerRG2BGR;
    case PixelLayout::BAYER_GBRG:
      return cv::COLOR_BayerGR2BGR;
    case PixelLayout::BAYER_GRBG:
      return cv::COLOR_BayerGB2BGR;
    default:
      throw std::logic_error("not a mosaic");
  }
}

int luminance_conversion(PixelLayout layout) {
  switch (layout) {
    case PixelLayout::RGB:
      return cv::COLOR_RGB2GRAY;
    case PixelLayout::BGRA:
      return cv::COLOR_BGRA2GRAY;
    case PixelLayout::RGBA:
      return cv::COLOR_RGBA2GRAY;
    default:
      return cv::COLOR_BGR2GRAY;  // BGR, and what demosaicing gives
  }
}

// Demosaicing needs a full 2x2 cell with a neighbour on each side; smaller mosaics are taken as grey.
constexpr int kMinBayerSidePx = 3;

}  // namespace

std::optional<PixelLayout> layout_of_encoding(const std::string& encoding) {
  static const std::unordered_map<std::string, PixelLayout> layouts = {
      {"mono8", PixelLayout::GRAY},
      {"mono16", PixelLayout::GRAY},
      {"8UC1", PixelLayout::GRAY},
      {"16UC1", PixelLayout::GRAY},
      {"bgr8", PixelLayout::BGR},
      {"bgr16", PixelLayout::BGR},
      {"rgb8", PixelLayout::RGB},
      {"rgb16", PixelLayout::RGB},
      {"bgra8", PixelLayout::BGRA},
      {"bgra16", PixelLayout::BGRA},
      {"rgba8", PixelLayout::RGBA},
      {"rgba16", PixelLayout::RGBA},
      {"bayer_rggb8", PixelLayout::BAYER_RGGB},
      {"bayer_rggb16", PixelLayout::BAYER_RGGB},
      {"bayer_bggr8", PixelLayout::BAYER_BGGR},
      {"bayer_bggr16", PixelLayout::BAYER_BGGR},
      {"bayer_gbrg8", PixelLayout::BAYER_GBRG},
      {"bayer_gbrg16", PixelLayout::BAYER_GBRG},
      {"bayer_grbg8", PixelLayout::BAYER_GRBG},
      {"bayer_grbg16", PixelLayout::BAYER_GRBG},
  };
  const auto found = layouts.find(encoding);
  if (found == layouts.end()) return std::nullopt;
  return found->second;
}

bool is_bayer(PixelLayout layout) {
  return layout == PixelLayout::BAYER_RGGB || layout == PixelLayout::BAYER_BGGR || layout == PixelLayout::BAYER_GBRG ||
         layout == PixelLayout::BAYER_GRBG;
}

int channels_of(PixelLayout layout) {
  switch (layout) {
    case PixelLayout::BGR:
    case PixelLayout::RGB:
      return 3;
    case PixelLayout::BGRA:
    case PixelLayout::RGBA:
      return 4;
    default:
      return 1;
  }
}

cv::Mat luminance8(const cv::Mat& image, PixelLayout layout) {
  if (image.depth() != CV_8U && image.depth() != CV_16U) {
    throw std::invalid_argument("image depth must be CV_8U or CV_16U, got OpenCV depth " +
                                std::to_string(image.depth()));
  }
  if (image.channels() != channels_of(layout)) {
    throw std::invalid_argument("image has " + std::to_string(image.channels()) + " channels where its layout has " +
                                std::to_string(channels_of(layout)));
  }
  if (image.empty()) return cv::Mat(image.size(), CV_8UC1);

  cv::Mat gray = image;
  if (is_bayer(layout)) {
    if (image.cols >= kMinBayerSidePx && image.rows >= kMinBayerSidePx) {
      // OpenCV's direct conversion (COLOR_Bayer*2GRAY) leaves a checkerboard of up to 8 % on a uniform colour, which
      // validation would take for sharp edges.
      cv::Mat color;
      cv::cvtColor(image, color, demosaicing(layout));
      gray = cv::Mat();  // it would be written into the mosaic, which has the same type
      cv::cvtColor(color, gray, luminance_conversion(layout));
    }
  } else if (layout != PixelLayout::GRAY) {
    cv::cvtColor(image, gray, luminance_conversion(layout));
  }
  if (gray.depth() == CV_16U) {
    cv::Mat gray8;
    gray.convertTo(gray8, CV_8U, kScale16To8);
    return gray8;
  }
  return gray;
}

}  // namespace gyro_deblur
