// Halves images and their noise.
#include "blur/noisy_image.hpp"

#include <algorithm>

#include "base/parallel.hpp"
#include "blur/image_noise.hpp"
#include "blur/spectrum_simd.hpp"

namespace gyro_deblur {
namespace {

/// Of rounding to whole grey levels.
constexpr double kRoundingVariance = 1.0 / 12;

}  // namespace

NoisyImage noisy_image(const cv::Mat& pixels, double noise_grey_levels) {
  return {pixels, noise_grey_levels * noise_grey_levels + kRoundingVariance};
}

NoisyImage downsample2x(const NoisyImage& image, int threads) {
  static const SpectrumSimd& simd = select_for_cpu<SpectrumSimd>();
  const cv::Mat& whole = image.pixels;
  cv::Mat half(whole.rows / 2, whole.cols / 2, CV_8UC1);
  constexpr int kRowsAtATime = 32;
  parallel_for(half.rows, threads, kRowsAtATime,
               [&](int y) { simd.halve(whole.ptr(2 * y), whole.ptr(2 * y + 1), half.cols, half.ptr(y)); });
  // A camera's own filters and JPEG leave noise that neighbouring pixels share, which a mean does not take away.
  const double shared = image_noise(half, PixelLayout::GRAY, 8, 1, {}, threads).value_or(0);
  return {half, std::max(image.noise_variance / 4 + kRoundingVariance, shared * shared)};
}

}  // namespace gyro_deblur
