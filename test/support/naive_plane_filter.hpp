// The definition of the filter in the plane, written for reading.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>

#include "base/fourier.hpp"
#include "gyro_deblur/engine.hpp"
#include "naive_convolution.hpp"
#include "plane_paths.hpp"

namespace gyro_deblur::test {

/// Steps from 0 to 1 as the square of a sine.
inline double rise(int i, int steps) {
  const double s = std::sin(CV_PI / 2 * std::clamp((i + 0.5) / steps, 0.0, 1.0));
  return s * s;
}

/// A column (row) of cells as its window sees it.
struct NaiveWindow {
  int block, begin, end;
  int shared_before, shared_behind;  ///< with the neighbours' windows [px]

  double weight(int i) const {
    return (i - begin < shared_before ? rise(i - begin, shared_before) : 1.0) *
           (end - 1 - i < shared_behind ? rise(end - 1 - i, shared_behind) : 1.0);
  }
};

/// Blocks are cut into the fewest, equally long cells of at most 64 px.
inline std::vector<NaiveWindow> windows_of(const std::vector<int>& block_borders) {
  std::vector<int> borders = {0}, blocks;
  for (int block = 0; block + 1 < static_cast<int>(block_borders.size()); ++block) {
    const int begin = block_borders[block], length = block_borders[block + 1] - begin, parts = (length + 63) / 64;
    for (int i = 1; i <= parts; ++i) {
      borders.push_back(begin + length * i / parts);
      blocks.push_back(block);
    }
  }
  const int count = static_cast<int>(blocks.size());
  const auto half_at = [&](int i) {
    if (i == 0 || i == count) return 0;
    return std::min(borders[i] - borders[i - 1], borders[i + 1] - borders[i]) / 2;
  };
  std::vector<NaiveWindow> windows;
  for (int i = 0; i < count; ++i) {
    const int before = half_at(i), behind = half_at(i + 1);
    windows.push_back({blocks[i], borders[i] - before, borders[i + 1] + behind, 2 * before, 2 * behind});
  }
  return windows;
}

/// A pixel that an element of a tile is made of, with its weight. It stands for what lies outside of the image if it is
/// not `inside`.
struct TileSource {
  int at;
  double weight;
  bool inside;
};

/// Those of element i: beside the window what is behind it fades into what is before it.
inline std::vector<TileSource> sources_of(const NaiveWindow& window, int size, int i, int image_length) {
  const auto source = [&](int at, double weight) {
    const int inside = std::clamp(at, 0, image_length - 1);
    return TileSource{inside, weight, inside == at};
  };
  const int length = window.end - window.begin, at = window.begin + i;
  if (i < length) return {source(at, 1)};
  const double weight = rise(i - length, size - length);
  return {source(at, 1 - weight), source(at - size, weight)};
}

/// A tile times a gain of (u, v) in the frequency domain.
template <typename Gain>
cv::Mat times_gain(const cv::Mat& tile, const Gain& gain) {
  cv::Mat spectrum, result;
  cv::dft(tile, spectrum, cv::DFT_COMPLEX_OUTPUT);
  spectrum.forEach<std::complex<double>>([&](std::complex<double>& z, const int* at) { z *= gain(at[1], at[0]); });
  cv::dft(spectrum, result, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  return result;
}

/// What the blocks with an inverse have in one channel, and beyond them as far as their windows go; unrounded, CV_64F.
inline cv::Mat naive_plane_filter(const cv::Mat& src, int channel, const FilterGrid& grid) {
  cv::Mat sums(src.size(), CV_64F, cv::Scalar(0)), weights(src.size(), CV_64F, cv::Scalar(0));
  for (const NaiveWindow& down : windows_of(grid.y)) {
    for (const NaiveWindow& across : windows_of(grid.x)) {
      const PlaneInverse* inverse = grid.blocks[down.block * grid.cols() + across.block].inverse;
      if (inverse == nullptr) continue;
      const int longest = std::max(across.end - across.begin, down.end - down.begin);
      const double extent_px = extent_of(inverse->path_px).maxCoeff();
      const int size = fourier_size(std::min(longest + static_cast<int>(std::ceil(2 * extent_px)), kMaxFourierSize));
      cv::Mat tile(size, size, CV_64F, cv::Scalar(0)), outside(size, size, CV_64F, cv::Scalar(0));
      for (int y = 0; y < size; ++y) {
        for (int x = 0; x < size; ++x) {
          for (const TileSource& of_y : sources_of(down, size, y, src.rows)) {
            for (const TileSource& of_x : sources_of(across, size, x, src.cols)) {
              tile.at<double>(y, x) += of_x.weight * of_y.weight * pixel_at(src, of_x.at, of_y.at, channel);
              outside.at<double>(y, x) += of_x.inside && of_y.inside ? 0 : of_x.weight * of_y.weight;
            }
          }
        }
      }
      const auto gain = [&](int u, int v) { return gain_at(*inverse, u, v, size); };
      if (across.begin == 0 || down.begin == 0 || across.end == src.cols || down.end == src.rows) {
        const auto blurred_again = [&](int u, int v) { return gain(u, v) * transfer_at(inverse->path_px, u, v, size); };
        tile += 2.5 * outside.mul(times_gain(tile, blurred_again) - tile);
      }
      const cv::Mat result = times_gain(tile, gain);
      for (int y = down.begin; y < down.end; ++y) {
        for (int x = across.begin; x < across.end; ++x) {
          const double weight = across.weight(x) * down.weight(y);
          sums.at<double>(y, x) += weight * result.at<double>(y - down.begin, x - across.begin);
          weights.at<double>(y, x) += weight;
        }
      }
    }
  }
  return sums / weights;  // OpenCV: 0 where there is no window
}

}  // namespace gyro_deblur::test
