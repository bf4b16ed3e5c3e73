// What validation makes of photographs whose blur is known: as predicted, a third of it, or none.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::test {

/// Images of one photograph, and the blur that is predicted for all of them.
struct PredictedBlur {
  FrameBlur field;
  cv::Mat blurred, sharp, third;  // CV_64F, without noise
};

/// @param photograph  one channel; the image is cut out of it, so that its border holds real light from outside
inline PredictedBlur predict_blur(const cv::Mat& photograph, double angle_rad, double extent_px) {
  constexpr int kMarginPx = 32;
  const cv::Rect inner(kMarginPx, kMarginPx, photograph.cols - 2 * kMarginPx, photograph.rows - 2 * kMarginPx);
  PredictedBlur images;
  images.field = uniform_blur_field(inner.width, inner.height, angle_rad, extent_px, {});
  photograph(inner).convertTo(images.sharp, CV_64F);
  images.blurred = blur_along_line(photograph, angle_rad, extent_px)(inner).clone();
  images.third = blur_along_line(photograph, angle_rad, extent_px / 3)(inner).clone();
  return images;
}

/// How a camera shows an image.
struct Exposed {
  double noise_grey_levels = 0;
  double contrast = 1;  ///< about the middle grey
  int hot_ppm = 0;      ///< pixels that are white, per million
};

inline cv::Mat expose(const cv::Mat& image, const Exposed& how, std::uint64_t seed) {
  constexpr double kMiddleGrey = 128;
  cv::Mat light = how.contrast * image + kMiddleGrey * (1 - how.contrast);
  cv::Mat shown = expose(light, how.noise_grey_levels, seed);
  cv::RNG rng(seed + 1);
  for (int k = static_cast<int>(shown.total() * how.hot_ppm / 1'000'000); k > 0; --k) {
    const int x = rng.uniform(0, shown.cols), y = rng.uniform(0, shown.rows);
    shown.at<uchar>(y, x) = 255;
  }
  return shown;
}

/// Area under the receiver operating characteristic: the probability that one of `wanted` is larger than one of
/// `unwanted`. Precondition: neither is empty.
inline double area_under_roc(const std::vector<double>& wanted, std::vector<double> unwanted) {
  std::sort(unwanted.begin(), unwanted.end());
  double sum = 0;
  for (const double value : wanted) {
    const auto below = std::lower_bound(unwanted.begin(), unwanted.end(), value);
    const auto equal_end = std::upper_bound(below, unwanted.end(), value);
    sum += static_cast<double>(below - unwanted.begin()) + 0.5 * static_cast<double>(equal_end - below);
  }
  return sum / (static_cast<double>(wanted.size()) * static_cast<double>(unwanted.size()));
}

}  // namespace gyro_deblur::test
