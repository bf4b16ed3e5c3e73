// How the bytes of an image are to be read.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// Pixel layouts that can be deblurred. Channels are filtered independently, alpha is copied, and a Bayer mosaic is
/// filtered plane by plane at half resolution, so that the output keeps the input's encoding. Of YUV 4:2:2 the
/// luminance is filtered and the colours are copied.
enum class PixelLayout {
  GRAY,
  BGR,
  RGB,
  BGRA,
  RGBA,
  BAYER_RGGB,
  BAYER_BGGR,
  BAYER_GBRG,
  BAYER_GRBG,
  YUV422_UYVY,  ///< pairs of pixels as U Y V Y; two channels, of which the second is the luminance
  YUV422_YUYV,  ///< pairs of pixels as Y U Y V; two channels, of which the first is the luminance
};

/// Layout of a sensor_msgs image encoding (mono8, mono16, 8UC1, 16UC1, bgr8, rgb8, bgra8, rgba8, their 16-bit variants,
/// 8UC3 and 16UC3 as BGR, bayer_*8/16, and yuv422 or uyvy, yuv422_yuy2 or yuyv); nothing for any other. 8UC4 has none:
/// whether its fourth channel is light is not known.
std::optional<PixelLayout> layout_of_encoding(const std::string& encoding);

bool is_bayer(PixelLayout layout);
bool is_yuv422(PixelLayout layout);
/// The channel of a YUV 4:2:2 image that is the luminance. Precondition: is_yuv422(layout).
int luminance_channel(PixelLayout layout);
/// Channels of a cv::Mat with this layout: 1 to 4.
int channels_of(PixelLayout layout);

/// The significant bits of a camera's images: pixels are at most 2^bits - 1. Many cameras put 10, 12 or 14 bits
/// into 16. Not thread-safe.
class BitDepth {
 public:
  /// @param significant_bits  of 16-bit images, 8 to 16; 0: guessed. Throws OptionError.
  explicit BitDepth(int significant_bits = 0);

  /// Significant bits of an image: 8 for CV_8U, for CV_16U those given. Guessed, they are the fewest of 10, 12, 14 and
  /// 16 that hold every colour of this image and all before, so that the guess follows no single image's brightness;
  /// and 16 where the lowest two bits have never been used: data aligned to the high bits fills the range already.
  int of(const cv::Mat& image, PixelLayout layout);

  /// That a guess of fewer than 16 bits has been made, or changed; once, else empty.
  std::string take_message();

 private:
  int given_, guessed_ = 16;
  std::uint16_t used_ = 0;  ///< bits that were set in any pixel
  std::string message_;
};

/// 8-bit luminance of an image (CV_8U or CV_16U with channels_of(layout) channels).
/// CV_8UC1 GRAY input is returned without a copy. Throws std::invalid_argument when type and layout do not fit.
/// @param significant_bits  of 16-bit images: 2^bits - 1 becomes 255, more too
cv::Mat luminance8(const cv::Mat& image, PixelLayout layout, int significant_bits = 16);

/// True where a pixel alone does not have all of its colours: they are lost when it is moved by a fraction of a pixel.
bool shares_colors(PixelLayout layout);

/// BGR of such an image, depth as it is: a Bayer mosaic (CV_8UC1 or CV_16UC1), or YUV 4:2:2 (CV_8UC2 of even width).
/// Precondition: shares_colors(layout).
cv::Mat to_bgr(const cv::Mat& image, PixelLayout layout);

/// Takes what filtering has added to `output` beyond the range of significant bits out of it again; a pixel that was
/// beyond it in `input` keeps that value. Precondition: same size and type.
void keep_range(const cv::Mat& input, int significant_bits, cv::Mat& output);

}  // namespace gyro_deblur
