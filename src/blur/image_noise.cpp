// Estimates the noise of an image from its flattest parts.
#include "blur/image_noise.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "blur/noise_simd.hpp"

namespace gyro_deblur {
namespace {

constexpr int kSquarePx = kNoiseSquarePx, kReachPx = kNoiseReachPx;
constexpr int kMinSquares = 30;               // for a median that is right within 10 %
constexpr std::size_t kManySquares = 1500;    // as many in the smallest class of texture
constexpr std::size_t kMaxSquares = 2048;     // more of a large image would add nothing
constexpr double kFilterPower = 70.0 * 70.0;  // sum of the filter's squared weights, in both directions
// Of white noise: the mean of a square's power over the median; the share of its variance in means of 2 x 2 px.
constexpr double kMeanOverMedian = 1.083;
constexpr double kNoiseInMeans = 0.25;

/// One colour of an image.
struct Plane {
  const cv::Mat& image;
  int first_x, first_y;  ///< its first sample
  int step;              ///< pixels between samples
  int channel;
  int mean_of = 1;  ///< so many samples in either direction are one value
  PixelMask mask = {};

  int cols() const { return (image.cols - first_x + step - 1) / step / mean_of; }
  int rows() const { return (image.rows - first_y + step - 1) / step / mean_of; }
};

Plane green_plane(const cv::Mat& image, PixelLayout layout) {
  switch (layout) {
    case PixelLayout::BAYER_RGGB:
    case PixelLayout::BAYER_BGGR:
      return {image, 1, 0, 2, 0};
    case PixelLayout::BAYER_GBRG:
    case PixelLayout::BAYER_GRBG:
      return {image, 0, 0, 2, 0};
    case PixelLayout::YUV422_UYVY:
    case PixelLayout::YUV422_YUYV:
      return {image, 0, 0, 1, luminance_channel(layout)};
    case PixelLayout::GRAY:
      return {image, 0, 0, 1, 0};
    default:
      return {image, 0, 0, 1, 1};
  }
}

/// Of one square [grey levels^2].
struct Square {
  double texture;  ///< variance of the means of 2 x 2 px
  double finest;   ///< power of the finest checkerboard, as variance of white noise
};

/// What a thread works with.
struct Scratch {
  std::array<std::vector<float>, kNoiseBandRows> band;  // a row of squares, and what their filter reaches
  std::vector<float> down, sums;
};

void load(const NoiseSimd& simd, const Plane& plane, int first_row, int full_scale, Scratch* scratch) {
  const int channels = plane.image.channels(), cols = plane.cols(), n = plane.mean_of;
  const auto scale = static_cast<float>(255.0 / full_scale / (n * n));
  const int stride = n * plane.step * channels;
  for (int y = 0; y < kNoiseBandRows; ++y) {
    std::vector<float>& values = scratch->band[y];
    values.assign(cols, 0);
    for (int i = 0; i < n * n; ++i) {
      const int row = plane.first_y + ((first_row + y) * n + i / n) * plane.step,
                first_col = plane.first_x + i % n * plane.step;
      const int first_value = first_col * channels + plane.channel;
      if (plane.image.depth() == CV_8U) {
        simd.add_samples8(plane.image.ptr<std::uint8_t>(row) + first_value, stride, cols, scale, full_scale,
                          values.data());
      } else {
        simd.add_samples16(plane.image.ptr<std::uint16_t>(row) + first_value, stride, cols, scale, full_scale,
                           values.data());
      }
      if (plane.mask.empty()) continue;
      const std::uint8_t* used = plane.mask.pixels().ptr<std::uint8_t>(row) + first_col;
      for (int x = 0; x < cols; ++x) values[x] += used[x * n * plane.step] == 0 ? kNoiseClipped : 0;
    }
  }
}

/// Adds the squares of a band that are neither black nor saturated nor masked anywhere.
void add_squares(const NoiseSimd& simd, Scratch* scratch, std::vector<Square>* squares) {
  const int cols = static_cast<int>(scratch->band[0].size()), count = (cols - 2 * kReachPx) / kSquarePx;
  scratch->down.resize(cols);
  scratch->sums.resize(4 * cols);
  float* const sums = scratch->sums.data();
  const float *power = sums, *first = sums + cols, *second = sums + 2 * cols, *clipped = sums + 3 * cols;
  const float* rows[kNoiseBandRows];
  for (int y = 0; y < kNoiseBandRows; ++y) rows[y] = scratch->band[y].data();
  simd.sum_band(rows, cols, scratch->down.data(), {sums, sums + cols, sums + 2 * cols, sums + 3 * cols});
  for (int i = 0; i < count; ++i) {
    const int column = kReachPx + i * kSquarePx;
    if (std::any_of(clipped + column - kReachPx, clipped + column + kSquarePx + kReachPx,
                    [](float n) { return n > 0; }))
      continue;
    // Of means every second one: the others share pixels with them.
    double powers = 0, means = 0, squared_means = 0;
    for (int x = column; x < column + kSquarePx; x += 2) {
      powers += power[x] + power[x + 1];
      means += first[x];
      squared_means += second[x];
    }
    constexpr int kMeans = kSquarePx * kSquarePx / 4;
    const double mean = means / kMeans;
    squares->push_back({std::max(0.0, (squared_means - kMeans * mean * mean) / (kMeans - 1)),
                        powers / (kSquarePx * kSquarePx * kFilterPower)});
  }
}

std::vector<Square> squares_of(const Plane& plane, int full_scale, int threads) {
  static const NoiseSimd& simd = select_for_cpu<NoiseSimd>();
  const int cols = (plane.cols() - 2 * kReachPx) / kSquarePx, rows = (plane.rows() - 2 * kReachPx) / kSquarePx;
  if (cols <= 0 || rows <= 0) return {};
  const int taken = std::clamp(static_cast<int>(kMaxSquares) / cols, 1, rows);
  std::vector<std::vector<Square>> of_bands(static_cast<std::size_t>(taken));
  const int used = threads_or_all(threads);  // once: the number of cores may change
  std::vector<Scratch> scratch(static_cast<std::size_t>(used));
  constexpr int kBandsAtATime = 2;
  parallel_for(taken, used, kBandsAtATime, [&](int i, int thread) {
    const int row = static_cast<int>((2 * i + 1LL) * rows / (2 * taken)) * kSquarePx;
    load(simd, plane, row, full_scale, &scratch[thread]);
    add_squares(simd, &scratch[thread], &of_bands[i]);
  });
  std::vector<Square> squares;
  for (const std::vector<Square>& band : of_bands) squares.insert(squares.end(), band.begin(), band.end());
  return squares;
}

// Classes of squares by texture: where they begin and end, as shares of all.
constexpr double kClasses[] = {0, 0.02, 0.04, 0.08, 0.16, 0.3};
constexpr double kFlatShare = 0.05;
constexpr std::size_t kFlatSquares = 64;  // at least

std::size_t flat_squares(std::size_t count) {
  return std::min(count, std::max<std::size_t>(kFlatSquares, std::lround(kFlatShare * static_cast<double>(count))));
}

/// Puts the squares of each class before those of the next ones, and the flattest before the others.
void order_by_texture(std::vector<Square>* squares) {
  const std::size_t count = squares->size();
  std::vector<std::size_t> bounds = {flat_squares(count)};
  for (const double share : kClasses) bounds.push_back(static_cast<std::size_t>(share * static_cast<double>(count)));
  std::sort(bounds.rbegin(), bounds.rend());
  auto end = squares->end();
  for (const std::size_t bound : bounds) {
    const auto begin = squares->begin() + static_cast<std::ptrdiff_t>(bound);
    if (begin == end) continue;
    std::nth_element(squares->begin(), begin, end,
                     [](const Square& a, const Square& b) { return a.texture < b.texture; });
    end = begin;
  }
}

/// Variance of the noise, from squares as order_by_texture() leaves them. What a little texture has of the finest
/// detail is found from squares that have more of both.
double variance_without_texture(const std::vector<Square>& squares) {
  const auto finest_of = [&](std::size_t begin, std::size_t end) {
    std::vector<double> finest;
    for (std::size_t i = begin; i < end; ++i) finest.push_back(squares[i].finest);
    return kMeanOverMedian * median(finest);
  };
  const std::size_t count = squares.size();
  const double flattest = finest_of(0, flat_squares(count));
  if (count < kManySquares) return flattest;
  // A line through classes of squares, all of them equally certain in proportion to their size.
  double s = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (std::size_t k = 0; k + 1 < std::size(kClasses); ++k) {
    const auto begin = static_cast<std::size_t>(kClasses[k] * count),
               end = static_cast<std::size_t>(kClasses[k + 1] * count);
    if (begin == end) continue;
    double x = 0;
    for (std::size_t i = begin; i < end; ++i) x += squares[i].texture / static_cast<double>(end - begin);
    const double y = finest_of(begin, end);
    if (y <= 0) return flattest;
    const double weight = 1 / (y * y);
    s += weight;
    sx += weight * x;
    sy += weight * y;
    sxx += weight * x * x;
    sxy += weight * x * y;
  }
  const double determinant = s * sxx - sx * sx;
  if (!(determinant > 1e-9 * s * sxx)) return flattest;
  const double slope = (s * sxy - sx * sy) / determinant, start = (sxx * sy - sx * sxy) / determinant;
  if (slope <= 0) return flattest;
  // The noise itself is in the means, too.
  const double variance = start / std::max(1 - slope * kNoiseInMeans, 0.5);
  return std::clamp(variance, 0.5 * flattest, flattest);
}

}  // namespace

std::optional<double> image_noise(const cv::Mat& image, PixelLayout layout, int significant_bits, int mean_of,
                                  const PixelMask& mask, int threads) {
  const int full_scale = image.depth() == CV_8U ? 255 : (1 << significant_bits) - 1;
  Plane plane = green_plane(image, layout);
  plane.mean_of = mean_of;
  plane.mask = mask;
  std::vector<Square> squares = squares_of(plane, full_scale, threads);
  if (squares.size() < kMinSquares) return std::nullopt;
  order_by_texture(&squares);
  return mean_of * std::sqrt(variance_without_texture(squares));
}

double image_contrast(const cv::Mat& image, PixelLayout layout, int significant_bits, const PixelMask& mask) {
  constexpr int kStep = 16;
  const Plane plane = green_plane(image, layout);
  const bool wide = image.depth() == CV_16U;
  std::int64_t sum = 0, squares = 0, samples = 0;
  const int step = kStep / plane.step;
  for (int y = 0; y < plane.rows(); y += step) {
    const int row = plane.first_y + y * plane.step;
    // Every second row half a step farther, or stripes as wide as a step would look flat.
    for (int x = y / step % 2 * step / 2; x < plane.cols(); x += step) {
      const int col = plane.first_x + x * plane.step, i = col * image.channels() + plane.channel;
      if (!mask.empty() && mask.pixels().at<std::uint8_t>(row, col) == 0) continue;
      const std::int64_t level = wide ? image.ptr<std::uint16_t>(row)[i] : image.ptr<std::uint8_t>(row)[i];
      sum += level;
      squares += level * level;
      ++samples;
    }
  }
  if (samples == 0) return 0;
  const double full_scale = wide ? (1 << significant_bits) - 1 : 255;
  const double mean = static_cast<double>(sum) / samples, mean_of_squares = static_cast<double>(squares) / samples;
  return 255 / full_scale * std::sqrt(std::max(0.0, mean_of_squares - mean * mean));
}

}  // namespace gyro_deblur
