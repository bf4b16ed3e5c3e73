// Encodings and their pixel layouts: luminance, bit depth and colour planes of an image.
#include "gyro_deblur/image_format.hpp"

#include <array>
#include <cstddef>
#include <iterator>
#include <stdexcept>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

/// What OpenCV and ROS call a layout.
struct LayoutTraits {
  PixelLayout layout;
  int channels;
  int to_gray;                           ///< conversion, of a mosaic that of its BGR image; -1: none is needed
  int to_bgr;                            ///< conversion where pixels share colours, else -1
  std::array<const char*, 4> encodings;  ///< of sensor_msgs; unused ones are null
};

// In the order of PixelLayout. OpenCV names a mosaic by the second row's second and third pixel, ROS by the first row's
// first two.
constexpr LayoutTraits kLayouts[] = {
    {PixelLayout::GRAY, 1, -1, -1, {"mono8", "mono16", "8UC1", "16UC1"}},
    {PixelLayout::BGR, 3, cv::COLOR_BGR2GRAY, -1, {"bgr8", "bgr16", "8UC3", "16UC3"}},
    {PixelLayout::RGB, 3, cv::COLOR_RGB2GRAY, -1, {"rgb8", "rgb16"}},
    {PixelLayout::BGRA, 4, cv::COLOR_BGRA2GRAY, -1, {"bgra8", "bgra16"}},
    {PixelLayout::RGBA, 4, cv::COLOR_RGBA2GRAY, -1, {"rgba8", "rgba16"}},
    {PixelLayout::BAYER_RGGB, 1, cv::COLOR_BGR2GRAY, cv::COLOR_BayerBG2BGR, {"bayer_rggb8", "bayer_rggb16"}},
    {PixelLayout::BAYER_BGGR, 1, cv::COLOR_BGR2GRAY, cv::COLOR_BayerRG2BGR, {"bayer_bggr8", "bayer_bggr16"}},
    {PixelLayout::BAYER_GBRG, 1, cv::COLOR_BGR2GRAY, cv::COLOR_BayerGR2BGR, {"bayer_gbrg8", "bayer_gbrg16"}},
    {PixelLayout::BAYER_GRBG, 1, cv::COLOR_BGR2GRAY, cv::COLOR_BayerGB2BGR, {"bayer_grbg8", "bayer_grbg16"}},
    {PixelLayout::YUV422_UYVY, 2, -1, cv::COLOR_YUV2BGR_UYVY, {"yuv422", "uyvy"}},
    {PixelLayout::YUV422_YUYV, 2, -1, cv::COLOR_YUV2BGR_YUYV, {"yuv422_yuy2", "yuyv"}},
};
static_assert(std::size(kLayouts) == static_cast<std::size_t>(PixelLayout::YUV422_YUYV) + 1);

const LayoutTraits& traits_of(PixelLayout layout) { return kLayouts[static_cast<int>(layout)]; }

double full_scale(int significant_bits) { return (1 << significant_bits) - 1; }

/// The bits that are set in any colour of a CV_16U image.
std::uint16_t used_bits(const cv::Mat& image, PixelLayout layout) {
  const int channels = image.channels(), values = image.cols * channels;
  const bool has_alpha = layout == PixelLayout::BGRA || layout == PixelLayout::RGBA;
  std::uint16_t used = 0;
  for (int y = 0; y < image.rows; ++y) {
    const auto* row = image.ptr<std::uint16_t>(y);
    if (has_alpha) {
      for (int x = 0; x < values; x += channels) used |= row[x] | row[x + 1] | row[x + 2];
    } else {
      for (int x = 0; x < values; ++x) used |= row[x];
    }
  }
  return used;
}

int guess_significant_bits(std::uint16_t used) {
  constexpr std::uint16_t kLowest = 3;
  if ((used & kLowest) == 0) return 16;
  for (const int bits : {10, 12, 14}) {
    if (used < (1 << bits)) return bits;
  }
  return 16;
}

// Demosaicing needs a full 2x2 cell with a neighbour on each side; smaller mosaics are taken as grey.
constexpr int kMinBayerSidePx = 3;

}  // namespace

std::optional<PixelLayout> layout_of_encoding(const std::string& encoding) {
  for (const LayoutTraits& traits : kLayouts) {
    for (const char* name : traits.encodings) {
      if (name != nullptr && encoding == name) return traits.layout;
    }
  }
  return std::nullopt;
}

bool is_bayer(PixelLayout layout) {
  return layout == PixelLayout::BAYER_RGGB || layout == PixelLayout::BAYER_BGGR || layout == PixelLayout::BAYER_GBRG ||
         layout == PixelLayout::BAYER_GRBG;
}

bool is_yuv422(PixelLayout layout) { return layout == PixelLayout::YUV422_UYVY || layout == PixelLayout::YUV422_YUYV; }

int luminance_channel(PixelLayout layout) { return layout == PixelLayout::YUV422_YUYV ? 0 : 1; }

bool shares_colors(PixelLayout layout) { return is_bayer(layout) || is_yuv422(layout); }

int channels_of(PixelLayout layout) { return traits_of(layout).channels; }

BitDepth::BitDepth(int significant_bits) : given_(significant_bits) {
  if (given_ == 0 || (given_ >= 8 && given_ <= 16)) return;
  throw OptionError("significant_bits = " + std::to_string(given_) + " is neither 0 (guessed) nor in [8, 16]");
}

int BitDepth::of(const cv::Mat& image, PixelLayout layout) {
  if (image.depth() != CV_16U) return 8;
  if (given_ != 0) return given_;
  constexpr std::uint16_t kHighest = 1 << 15;
  if ((used_ & kHighest) != 0) return guessed_;  // it cannot change any more
  used_ = static_cast<std::uint16_t>(used_ | used_bits(image, layout));
  const int guess = guess_significant_bits(used_);
  if (guess != guessed_) {
    guessed_ = guess;
    message_ = "16-bit images are taken to have " + std::to_string(guess) +
               " significant bits, from all pixels so far; set significant_bits where the camera has another number";
  }
  return guessed_;
}

std::string BitDepth::take_message() { return std::exchange(message_, {}); }

cv::Mat luminance8(const cv::Mat& image, PixelLayout layout, int significant_bits) {
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
  if (is_yuv422(layout)) {
    gray = cv::Mat();
    cv::extractChannel(image, gray, luminance_channel(layout));
  } else if (is_bayer(layout)) {
    // OpenCV's direct conversion (COLOR_Bayer*2GRAY) makes a checkerboard of up to 8 % on a uniform colour, which
    // validation would take for sharp edges.
    gray = cv::Mat();  // it would be written into the mosaic, which has the same type
    cv::cvtColor(to_bgr(image, layout), gray, traits_of(layout).to_gray);
  } else if (layout != PixelLayout::GRAY) {
    cv::cvtColor(image, gray, traits_of(layout).to_gray);
  }
  if (gray.depth() == CV_16U) {
    cv::Mat gray8;
    gray.convertTo(gray8, CV_8U, 255 / full_scale(significant_bits));
    return gray8;
  }
  return gray;
}

cv::Mat to_bgr(const cv::Mat& image, PixelLayout layout) {
  cv::Mat color;
  const bool is_large = image.cols >= kMinBayerSidePx && image.rows >= kMinBayerSidePx;
  cv::cvtColor(image, color, is_large || is_yuv422(layout) ? traits_of(layout).to_bgr : cv::COLOR_GRAY2BGR);
  return color;
}

void keep_range(const cv::Mat& input, int significant_bits, cv::Mat& output) {
  if (output.depth() != CV_16U || significant_bits >= 16) return;
  cv::Mat limit;
  cv::max(input, cv::Scalar::all(full_scale(significant_bits)), limit);
  cv::min(output, limit, output);
}

}  // namespace gyro_deblur
