// How the bytes of an image are to be read.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// Pixel layouts that can be deblurred. Channels are filtered independently, alpha is copied, and a Bayer mosaic is
/// filtered plane by plane at half resolution, so that the output keeps the input's encoding.
enum class PixelLayout { GRAY, BGR, RGB, BGRA, RGBA, BAYER_RGGB, BAYER_BGGR, BAYER_GBRG, BAYER_GRBG };

/// Layout of a sensor_msgs image encoding (mono8, mono16, 8UC1, 16UC1, bgr8, rgb8, bgra8, rgba8, their 16-bit kin and
/// bayer_*8/16); nothing for any other.
std::optional<PixelLayout> layout_of_encoding(const std::string& encoding);

bool is_bayer(PixelLayout layout);
/// Channels of a cv::Mat with this layout: 1, 3 or 4.
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

/// Colours (BGR, depth as it is) of a Bayer mosaic, CV_8UC1 or CV_16UC1. Precondition: is_bayer(layout).
cv::Mat demosaiced(const cv::Mat& mosaic, PixelLayout layout);

/// Takes what filtering has added to `output` beyond the range of significant bits out of it again; a pixel that was
/// beyond it in `input` keeps that value. Precondition: same size and type.
void keep_range(const cv::Mat& input, int significant_bits, cv::Mat& output);

}  // namespace gyro_deblur
