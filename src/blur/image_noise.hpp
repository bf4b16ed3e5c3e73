// The noise level of an image, and what it is to be compared with.
#pragma once

#include <optional>

#include <opencv2/core.hpp>

#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/pixel_mask.hpp"

namespace gyro_deblur {

/// Standard deviation of the noise in an image's pixels, [grey levels of 8 bits], rounding included (0.29 for whole
/// grey levels): what is left of a 5 x 5 px filter that passes the finest checkerboard alone, in those squares of 8 x 8
/// px that have the least texture at twice its size, extrapolated to none. Of the green channel, of a mosaic of one
/// plane of green. Nothing where fewer than 30 squares are neither black nor saturated anywhere.
///
/// Accuracy: doc/reports/experiments.md#noise. In a sharp image that is texture everywhere the finest of it counts as
/// noise. Noise that demosaicing or compression has smoothed is underestimated.
///
/// @param image             CV_8U or CV_16U that fits `layout`
/// @param significant_bits  of 16-bit images: 2^bits - 1 becomes 255
/// @param mean_of           >= 1; the noise that pixels would have if it were white and left in means of so many in
///                          either direction what is found there
/// @param mask              empty, or of the image's size; squares with a masked pixel are left out
/// @param threads           at most; 0: one for each core
std::optional<double> image_noise(const cv::Mat& image, PixelLayout layout, int significant_bits = 16, int mean_of = 1,
                                  const PixelMask& mask = {}, int threads = 1);

/// Standard deviation of an image's grey levels [of 8 bits], noise included, of every sixteenth pixel either way of
/// the same channel, or plane of a mosaic. Blur reduces it little. 0 of an image without pixels.
/// @param mask  empty, or of the image's size; masked pixels are left out
double image_contrast(const cv::Mat& image, PixelLayout layout, int significant_bits = 16, const PixelMask& mask = {});

}  // namespace gyro_deblur
