// Images and options that all measurements share.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur::benchmark {

/// Blur of 1 to 500 px is deblurred, so that a field's extents are what the measurement says.
BlurFieldOptions wide_options();

/// The first images of the Oxford affine sets in grey where they are present, else two synthetic textures. CV_8UC1.
std::vector<cv::Mat> natural_images();

/// `image` continued by its reflections, and cropped, to `size`: keeps the sharpness of its pixels.
cv::Mat extend(const cv::Mat& image, cv::Size size);

}  // namespace gyro_deblur::benchmark
