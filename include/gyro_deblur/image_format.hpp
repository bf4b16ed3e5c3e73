// How the bytes of an image are to be read.
#pragma once

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

/// 8-bit luminance of an image (CV_8U or CV_16U with channels_of(layout) channels; 16 bit divided by 257).
/// CV_8UC1 GRAY input is returned without a copy. Throws std::invalid_argument when type and layout do not fit.
cv::Mat luminance8(const cv::Mat& image, PixelLayout layout);

}  // namespace gyro_deblur
