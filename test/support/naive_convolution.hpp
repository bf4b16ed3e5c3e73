// The definition of the convolution, and of the cross-fade where blocks meet, written for reading.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>

#include "engine/engine.hpp"
#include "inverse/line_taps.hpp"
#include "pipeline/deconvolution.hpp"

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

/// A column (row) of blocks at one pixel: who has a say, and how near the neighbours are.
struct AxisBlend {
  int own = 0;
  std::vector<std::pair<int, double>> weights;  ///< of columns (rows); they sum to one
  double fade_before = 0, fade_behind = 0;      ///< weight of the input if the column before, or behind, is copied

  AxisBlend(const std::vector<int>& borders, int position) {
    while (borders[own + 1] <= position) ++own;
    const auto margin_at = [&](int border) {
      if (border == 0 || border + 1 == static_cast<int>(borders.size())) return 0;
      const int narrower = std::min(borders[border] - borders[border - 1], borders[border + 1] - borders[border]);
      return narrower >= 8 ? 4 : narrower >= 4 ? 2 : narrower >= 2 ? 1 : 0;
    };
    const auto in_256ths = [](double weight) { return std::floor(weight * 256 + 0.5) / 256; };
    // Steps of equal height lead from 0 to 1: 2 m + 1 between blocks, m + 1 between the input and a block.
    const int to_begin = position - borders[own], to_end = borders[own + 1] - 1 - position;
    const int before = margin_at(own), behind = margin_at(own + 1);
    if (to_begin < before) {
      const double weight = in_256ths((before + 1.0 + to_begin) / (2 * before + 1));
      weights = {{own - 1, 1 - weight}, {own, weight}};
      fade_before = in_256ths((before - to_begin) / (before + 1.0));
    } else if (to_end < behind) {
      const double weight = in_256ths((behind - to_end) / (2.0 * behind + 1));
      weights = {{own, 1 - weight}, {own + 1, weight}};
      fade_behind = in_256ths((behind - to_end) / (behind + 1.0));
    } else {
      weights = {{own, 1.0}};
    }
  }
};

/// The result at one pixel of one channel, where block i alone would have value(i) and the input is `input`.
/// @param rounds  whether value() is a pixel; means are rounded then
template <typename Value>
double blend_at(const FilterGrid& grid, const AxisBlend& across, const AxisBlend& down, bool rounds, double input,
                const Value& value) {
  const auto round = [&](double x) { return rounds ? std::floor(x + 0.5) : x; };
  const auto index = [&](int col, int row) { return row * grid.cols() + col; };
  const auto is_copied = [&](int col, int row) {
    return col >= 0 && col < grid.cols() && row >= 0 && row < grid.rows() &&
           grid.blocks[index(col, row)].kernel == nullptr;
  };
  if (is_copied(across.own, down.own)) return input;
  double mean = 0;
  for (const auto& [col, weight_of_col] : across.weights) {
    for (const auto& [row, weight_of_row] : down.weights) {
      mean += weight_of_col * weight_of_row * (is_copied(col, row) ? input : value(index(col, row)));
    }
  }
  double fade = 0;
  for (const int dx : {-1, 0, 1}) {
    for (const int dy : {-1, 0, 1}) {
      if (!is_copied(across.own + dx, down.own + dy)) continue;
      const double of_x = dx == 0 ? 1 : dx < 0 ? across.fade_before : across.fade_behind;
      const double of_y = dy == 0 ? 1 : dy < 0 ? down.fade_before : down.fade_behind;
      fade = std::max(fade, std::min(of_x, of_y));
    }
  }
  return round((1 - fade) * round(mean) + fade * input);
}

/// Largest |dst - exact value|, where values of blocks are clipped but nothing is rounded.
struct ConvolutionError {
  double alone = 0;    ///< where one filtered block decides
  double blended = 0;  ///< where several do
  double copied = 0;   ///< must be 0
};
inline ConvolutionError compare_with_naive(const cv::Mat& src, const FilterGrid& grid, const cv::Mat& dst) {
  const double max = src.depth() == CV_8U ? 255.0 : 65535.0;
  std::vector<std::vector<KernelTap>> taps;
  for (const BlockFilter& block : grid.blocks) {
    taps.push_back(block.kernel == nullptr ? std::vector<KernelTap>{} : rotate_kernel(*block.kernel, block.angle_rad));
  }
  ConvolutionError error;
  for (int y = 0; y < src.rows; ++y) {
    const AxisBlend down(grid.y, y);
    for (int x = 0; x < src.cols; ++x) {
      const AxisBlend across(grid.x, x);
      const bool copied = grid.blocks[down.own * grid.cols() + across.own].kernel == nullptr;
      double& worst = copied                                                   ? error.copied
                      : across.weights.size() == 1 && down.weights.size() == 1 ? error.alone
                                                                               : error.blended;
      for (int c = 0; c < src.channels(); ++c) {
        const double exact = blend_at(grid, across, down, false, pixel_at(src, x, y, c), [&](int block) {
          return std::clamp(convolve_at(src, taps[block], x, y, c), 0.0, max);
        });
        worst = std::max(worst, std::abs(pixel_at(dst, x, y, c) - exact));
      }
    }
  }
  return error;
}

}  // namespace gyro_deblur::test
