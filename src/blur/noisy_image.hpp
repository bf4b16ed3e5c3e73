// An image with the noise that its pixels have, at halves of its size.
#pragma once

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// An image and the variance of its noise, that of rounding to whole grey levels included.
struct NoisyImage {
  cv::Mat pixels;         ///< CV_8UC1
  double noise_variance;  ///< [grey levels^2]
};

/// @param noise_grey_levels  standard deviation of the sensor's noise, >= 0
NoisyImage noisy_image(const cv::Mat& pixels, double noise_grey_levels);

/// Rounded means of 2 x 2 px; an odd last row or column is left out. The same with any number of threads.
/// @param image  at least 2 px wide and high
NoisyImage downsample2x(const NoisyImage& image, int threads);

}  // namespace gyro_deblur
