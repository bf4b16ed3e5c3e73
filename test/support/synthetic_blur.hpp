// Images with exactly known blur.
#pragma once

#include <algorithm>
#include <cmath>
#include <complex>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "blur/path_1d.hpp"
#include "inverse/filter_bank.hpp"

namespace gyro_deblur::test {

/// `image` (one channel) with its spectrum multiplied by transfer(fx, fy), in cycles per pixel. No interpolation.
/// Returns CV_64F of the image's size. The border is mirrored: crop reach_px / 2 and a few pixels more where the
/// scene's edge matters.
template <typename Transfer>
cv::Mat filter_in_2d(const cv::Mat& image, double reach_px, const Transfer& transfer) {
  const int pad = static_cast<int>(std::ceil(reach_px)) + 32;
  const int cols = cv::getOptimalDFTSize(image.cols + 2 * pad), rows = cv::getOptimalDFTSize(image.rows + 2 * pad);
  cv::Mat real, padded, spectrum, blurred;
  image.convertTo(real, CV_64F);
  cv::copyMakeBorder(real, padded, pad, rows - image.rows - pad, pad, cols - image.cols - pad, cv::BORDER_REFLECT_101);
  cv::dft(padded, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int v = 0; v < rows; ++v) {
    const double fy = static_cast<double>(v <= rows / 2 ? v : v - rows) / rows;
    for (int u = 0; u < cols; ++u) {
      const double fx = static_cast<double>(u <= cols / 2 ? u : u - cols) / cols;
      cv::Vec2d& value = spectrum.at<cv::Vec2d>(v, u);
      const std::complex<double> product = std::complex<double>(value[0], value[1]) * transfer(fx, fy);
      value = {product.real(), product.imag()};
    }
  }
  cv::dft(spectrum, blurred, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  return blurred(cv::Rect(pad, pad, image.cols, image.rows)).clone();
}

/// The same with transfer(f), f in cycles per pixel along the line: nothing is lost across it.
template <typename Transfer>
cv::Mat filter_along_line(const cv::Mat& image, double angle_rad, double reach_px, const Transfer& transfer) {
  const double dx = std::cos(angle_rad), dy = std::sin(angle_rad);
  return filter_in_2d(image, reach_px, [&](double fx, double fy) { return transfer(fx * dx + fy * dy); });
}

inline double sinc(double x) { return std::abs(x) < 1e-9 ? 1.0 : std::sin(x) / x; }

/// The blur of a straight uniform motion, to sub-pixel accuracy; see filter_along_line.
inline cv::Mat blur_along_line(const cv::Mat& image, double angle_rad, double extent_px) {
  return filter_along_line(image, angle_rad, extent_px, [=](double f) { return sinc(CV_PI * extent_px * f); });
}

/// The blur of a straight motion at non-uniform speed, to sub-pixel accuracy; see filter_along_line.
inline cv::Mat blur_along_path(const cv::Mat& image, double angle_rad, const Path1d& path_px) {
  return filter_along_line(image, angle_rad, extent_of(path_px), [&](double f) {
    std::complex<double> sum = 0;
    for (int k = 0; k + 1 < kPathInstants; ++k) {
      const double length = path_px[k + 1] - path_px[k], middle = 0.5 * (path_px[k + 1] + path_px[k]);
      sum += std::polar(sinc(CV_PI * length * f), -2 * CV_PI * middle * f);
    }
    return sum / (kPathInstants - 1.0);
  });
}

/// `image` with Gaussian noise, rounded and clipped to 8 bit.
inline cv::Mat expose(const cv::Mat& image, double noise_grey_levels, std::uint64_t seed) {
  cv::Mat noise(image.size(), CV_64F), real, out;
  cv::RNG rng(seed);
  rng.fill(noise, cv::RNG::NORMAL, 0.0, noise_grey_levels);
  image.convertTo(real, CV_64F);
  cv::Mat sum = real + noise;
  sum.convertTo(out, CV_8U);
  return out;
}

/// A scene with structure at every scale and no texture file: blurred noise of several octaves and some hard-edged
/// rectangles, CV_8UC1.
inline cv::Mat textured_image(int width_px, int height_px, std::uint64_t seed) {
  cv::RNG rng(seed);
  cv::Mat sum(height_px, width_px, CV_32F, cv::Scalar(128));
  for (const double sigma : {1.0, 2.0, 4.0, 8.0}) {
    cv::Mat octave(height_px, width_px, CV_32F);
    rng.fill(octave, cv::RNG::NORMAL, 0.0, 40.0 * sigma);
    cv::GaussianBlur(octave, octave, cv::Size(), sigma, sigma, cv::BORDER_REFLECT_101);
    sum += octave;
  }
  const int rectangles = width_px * height_px / 2000;
  for (int i = 0; i < rectangles; ++i) {
    // One after the other: compilers do not agree on the order of arguments.
    const int y = rng.uniform(0, height_px), x = rng.uniform(0, width_px);
    const int height = rng.uniform(4, 30), width = rng.uniform(4, 30);
    cv::rectangle(sum, cv::Rect(x, y, width, height), cv::Scalar(rng.uniform(20, 236)), cv::FILLED);
  }
  cv::Mat out;
  sum.convertTo(out, CV_8U);
  return out;
}

/// Peak signal-to-noise ratio [dB] of one-channel 8-bit images.
inline double psnr_db(const cv::Mat& a, const cv::Mat& b) {
  cv::Mat difference;
  cv::subtract(a, b, difference, cv::noArray(), CV_64F);
  const double mse = std::max(difference.dot(difference) / static_cast<double>(a.total()), 1e-12);
  return 10 * std::log10(255.0 * 255.0 / mse);
}

}  // namespace gyro_deblur::test
