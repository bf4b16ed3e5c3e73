// The definition of the 2-D filter, written for reading.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>

#include "base/fourier.hpp"
#include "blur/path_2d.hpp"
#include "engine/engine.hpp"
#include "engine/half_size.hpp"
#include "naive_convolution.hpp"
#include "paths_2d.hpp"

namespace gyro_deblur::test {

/// Steps from 0 to 1 as the square of a sine.
inline double rise(int i, int steps) {
  const double s = std::sin(CV_PI / 2 * std::clamp((i + 0.5) / steps, 0.0, 1.0));
  return s * s;
}

/// A column (row) of cells as its window sees it.
struct NaiveWindow {
  int block, begin;
  std::vector<double> weights;

  int end() const { return begin + static_cast<int>(weights.size()); }
  double weight(int i) const { return i < begin || i >= end() ? 0 : weights[i - begin]; }
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
    NaiveWindow window{blocks[i], borders[i] - before, {}};
    const int length = borders[i + 1] + behind - window.begin;
    for (int k = 0; k < length; ++k) {
      window.weights.push_back((k < 2 * before ? rise(k, 2 * before) : 1.0) *
                               (length - 1 - k < 2 * behind ? rise(length - 1 - k, 2 * behind) : 1.0));
    }
    windows.push_back(window);
  }
  return windows;
}

/// The same windows in an image of half the length: the mean of two pixels' weights, of one behind which there is none
/// its own.
inline std::vector<NaiveWindow> halved(const std::vector<NaiveWindow>& windows, int image_length) {
  std::vector<NaiveWindow> halves;
  for (const NaiveWindow& window : windows) {
    NaiveWindow half{window.block, window.begin / 2, {}};
    for (int i = half.begin; 2 * i < window.end(); ++i) {
      half.weights.push_back((window.weight(2 * i) + window.weight(std::min(2 * i + 1, image_length - 1))) / 2);
    }
    halves.push_back(half);
  }
  return halves;
}

/// A pixel that an element of a tile is made of, with its weight. It stands for what lies outside of the image if it is
/// not `inside`.
struct TileSource {
  int at;
  double weight;
  bool inside;
};

/// Those of element i: outside the window what is behind it fades into what is before it.
inline std::vector<TileSource> sources_of(const NaiveWindow& window, int size, int i, int image_length) {
  const auto source = [&](int at, double weight) {
    const int inside = std::clamp(at, 0, image_length - 1);
    return TileSource{inside, weight, inside == at};
  };
  const int length = static_cast<int>(window.weights.size()), at = window.begin + i;
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

/// One channel of an image, CV_64F.
inline cv::Mat channel_of(const cv::Mat& image, int channel) {
  cv::Mat plane(image.size(), CV_64F);
  plane.forEach<double>([&](double& value, const int* at) { value = pixel_at(image, at[1], at[0], channel); });
  return plane;
}

/// Along the rows: the low pass between pixels 2 x and 2 x + 1; and its transpose, twice. `length`: of the whole image.
inline cv::Mat halved_rows(const cv::Mat& image) {
  cv::Mat half(image.rows, (image.cols + 1) / 2, CV_64F, cv::Scalar(0));
  half.forEach<double>([&](double& value, const int* at) {
    for (int k = 0; k < kHalvingTapCount; ++k) {
      value += kHalvingTaps[k] * image.at<double>(at[0], std::clamp(2 * at[1] - 3 + k, 0, image.cols - 1));
    }
  });
  return half;
}

inline cv::Mat doubled_rows(const cv::Mat& half, int length) {
  cv::Mat image(half.rows, length, CV_64F, cv::Scalar(0));
  image.forEach<double>([&](double& value, const int* at) {
    for (int i = -4; i < half.cols + 4; ++i) {
      const int k = at[1] - 2 * i + 3;
      if (k < 0 || k >= kHalvingTapCount) continue;
      value += 2 * kHalvingTaps[k] * half.at<double>(at[0], std::clamp(i, 0, half.cols - 1));
    }
  });
  return image;
}

inline cv::Mat doubled(const cv::Mat& half, cv::Size size) {
  return doubled_rows(doubled_rows(half, size.width).t(), size.height).t();
}

/// Whether a block is filtered at half its size: where at 0.24 cycles/px a straight run leaves less than 7 % of the
/// ratio of its inverse, on the mean.
inline bool is_at_half_size(const WienerInverse2d& inverse) {
  const double radians = CV_PI * 0.24 * extent_of(inverse.path_px).maxCoeff();
  return 0.5 / (radians * radians) < 0.07 * (inverse.noise_to_signal + inverse.noise_rise_px2 * 0.24 * 0.24);
}

/// What passes at half the size at u of `size` cycles.
inline double passing(int u, int size) {
  const double f = 0.5 * (u < size / 2 ? u : size - u) / size;
  return std::pow(std::sin(0.5 * CV_PI * std::clamp((0.24 - f) / 0.08, 0.0, 1.0)), 2);
}

/// Sums of weights and of weight times result.
struct NaiveSums {
  cv::Mat results, weights;
};

/// Of the blocks at one size. `image` has that size.
inline NaiveSums naive_sums(const cv::Mat& image, const FilterGrid& grid,
                            const std::vector<NaiveWindow>& windows_across,
                            const std::vector<NaiveWindow>& windows_down, bool is_half) {
  NaiveSums sums{cv::Mat(image.size(), CV_64F, cv::Scalar(0)), cv::Mat(image.size(), CV_64F, cv::Scalar(0))};
  for (const NaiveWindow& down : windows_down) {
    for (const NaiveWindow& across : windows_across) {
      const WienerInverse2d* of_block = grid.blocks[down.block * grid.cols() + across.block].inverse;
      if (of_block == nullptr || is_at_half_size(*of_block) != is_half) continue;
      WienerInverse2d inverse = *of_block;
      if (is_half) {
        for (Eigen::Vector2f& place_px : inverse.path_px) place_px /= 2;
        inverse.noise_rise_px2 /= 4;
      }
      const Eigen::Vector2f extent_px = extent_of(inverse.path_px);
      const bool at_the_end =
          across.begin == 0 || down.begin == 0 || across.end() == image.cols || down.end() == image.rows;
      const auto length_of_tile = [](const NaiveWindow& window, float extent) {
        const int length = static_cast<int>(window.weights.size()) + static_cast<int>(std::ceil(1.75 * extent));
        return fourier_size(std::min(length, kMaxFourierSize));
      };
      const cv::Size size(length_of_tile(across, extent_px.x()), length_of_tile(down, extent_px.y()));
      cv::Mat tile(size, CV_64F, cv::Scalar(0)), outside(size, CV_64F, cv::Scalar(0));
      for (int y = 0; y < size.height; ++y) {
        for (int x = 0; x < size.width; ++x) {
          for (const TileSource& of_y : sources_of(down, size.height, y, image.rows)) {
            for (const TileSource& of_x : sources_of(across, size.width, x, image.cols)) {
              tile.at<double>(y, x) += of_x.weight * of_y.weight * image.at<double>(of_y.at, of_x.at);
              outside.at<double>(y, x) += of_x.inside && of_y.inside ? 0 : of_x.weight * of_y.weight;
            }
          }
        }
      }
      const auto again = [&](int u, int v) {
        const double passes = is_half ? passing(u, size.width) * passing(v, size.height) : 1;
        return passes * gain_at(inverse, u, v, size) * transfer_at(inverse.path_px, u, v, size);
      };
      const auto gain = [&](int u, int v) {
        const auto restores = [&](int k, int length) {
          const double f = 0.5 * (k < length / 2 ? k : length - k) / length;
          return is_half ? passing(k, length) / std::pow(lowpass_response(f), 2) : 1.0;
        };
        return restores(u, size.width) * restores(v, size.height) * gain_at(inverse, u, v, size);
      };
      if (at_the_end) {
        tile += 2.5 * outside.mul(times_gain(tile, again) - tile);
      }
      const cv::Mat result = times_gain(tile, gain);
      for (int y = down.begin; y < down.end(); ++y) {
        for (int x = across.begin; x < across.end(); ++x) {
          const double weight = across.weight(x) * down.weight(y);
          sums.results.at<double>(y, x) += weight * result.at<double>(y - down.begin, x - across.begin);
          sums.weights.at<double>(y, x) += weight;
        }
      }
    }
  }
  return sums;
}

/// What the blocks with an inverse have in one channel, and beyond them as far as their windows go; unrounded, CV_64F.
inline cv::Mat naive_fourier_filter(const cv::Mat& src, int channel, const FilterGrid& grid) {
  const cv::Mat whole = channel_of(src, channel), half = halved_rows(halved_rows(whole).t()).t();
  const std::vector<NaiveWindow> across = windows_of(grid.x), down = windows_of(grid.y);
  const NaiveSums of_whole = naive_sums(whole, grid, across, down, false);
  const NaiveSums of_half = naive_sums(half, grid, halved(across, src.cols), halved(down, src.rows), true);
  const cv::Mat half_results = doubled(of_half.results, src.size()),
                half_weights = doubled(of_half.weights, src.size());
  cv::Mat result(src.size(), CV_64F);
  result.forEach<double>([&](double& value, const int* at) {
    double sum = of_whole.results.at<double>(at), weight = of_whole.weights.at<double>(at);
    // The low pass leaves a little beyond a window, and less than nothing for its weight.
    if (half_weights.at<double>(at) > 0 || weight <= 0) {
      sum += half_results.at<double>(at);
      weight += half_weights.at<double>(at);
    }
    value = weight == 0 ? 0 : sum / weight;  // 0 where there is no window
  });
  return result;
}

}  // namespace gyro_deblur::test
