// The definition of the convolution, written for reading.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/deconvolution.hpp"

namespace gyro_deblur::test {

inline double pixel_at(const cv::Mat& image, int x, int y, int channel) {
  const int index = x * image.channels() + channel;
  return image.depth() == CV_8U ? image.ptr<std::uint8_t>(y)[index] : image.ptr<std::uint16_t>(y)[index];
}

/// Unrounded, unclipped sum over the taps at one pixel; the edge pixel is replicated outside the image.
inline double convolve_at(const cv::Mat& src, const std::vector<KernelTap>& taps, int x, int y, int channel) {
  double sum = 0;
  for (const KernelTap& tap : taps) {
    const int from_x = std::clamp(x - tap.dx, 0, src.cols - 1);
    const int from_y = std::clamp(y - tap.dy, 0, src.rows - 1);
    sum += static_cast<double>(tap.weight) * pixel_at(src, from_x, from_y, channel);
  }
  return sum;
}

/// Largest |dst - clipped exact value| over all filtered blocks, and over all copied ones (which must be 0).
struct ConvolutionError {
  double filtered = 0;
  double copied = 0;
};
inline ConvolutionError compare_with_naive(const cv::Mat& src, const std::vector<BlockFilter>& blocks,
                                           const cv::Mat& dst) {
  const double max = src.depth() == CV_8U ? 255.0 : 65535.0;
  ConvolutionError error;
  for (const BlockFilter& block : blocks) {
    std::vector<KernelTap> taps;
    if (block.kernel != nullptr) taps = rotate_kernel(*block.kernel, block.angle_rad);
    for (int y = block.rect.y; y < block.rect.br().y; ++y) {
      for (int x = block.rect.x; x < block.rect.br().x; ++x) {
        for (int c = 0; c < src.channels(); ++c) {
          const double got = pixel_at(dst, x, y, c);
          if (block.kernel == nullptr) {
            error.copied = std::max(error.copied, std::abs(got - pixel_at(src, x, y, c)));
          } else {
            const double exact = std::clamp(convolve_at(src, taps, x, y, c), 0.0, max);
            error.filtered = std::max(error.filtered, std::abs(got - exact));
          }
        }
      }
    }
  }
  return error;
}

}  // namespace gyro_deblur::test
