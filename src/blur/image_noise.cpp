// Estimates the noise of an image from its flattest parts.
#include "blur/image_noise.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include "base/median.hpp"

namespace gyro_deblur {
namespace {

constexpr int kSquarePx = 8;
constexpr int kReachPx = 2;                 // of the filter
constexpr int kMinSquares = 30;             // for a median that is right within 10 %
constexpr std::size_t kManySquares = 1500;  // as many in the smallest class of texture
constexpr std::size_t kMaxSquares = 2048;   // more of a large image would add nothing
// 1, -4, 6, -4, 1 has the most power at half a cycle a pixel that five weights can have alone there.
constexpr float kInner = 6, kOuter = -4;
constexpr double kFilterPower = 70.0 * 70.0;  // sum of squared weights, in both directions
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

/// A row of squares, and what its filters reach.
constexpr int kBandRows = kSquarePx + 2 * kReachPx;
using Band = std::array<std::vector<float>, kBandRows>;

/// Added to a sample that is black, saturated or masked; makes the mean of any others negative.
constexpr float kClipped = -1e4;

/// Adds `count` samples, `stride` of the image's values apart.
template <typename Pixel>
inline void add_samples(const Pixel* from, int stride, int count, float scale, int full_scale, float* to) {
  for (int x = 0; x < count; ++x) {
    const int sample = from[x * stride];
    const int ends = (sample == 0) + (sample >= full_scale);
    to[x] += scale * static_cast<float>(sample) + kClipped * static_cast<float>(ends);
  }
}

template <typename Pixel>
void load(const Plane& plane, int first_row, int full_scale, Band& band) {
  const int channels = plane.image.channels(), cols = plane.cols(), n = plane.mean_of;
  const auto scale = static_cast<float>(255.0 / full_scale / (n * n));
  const int stride = n * plane.step * channels;
  for (int y = 0; y < kBandRows; ++y) {
    band[y].assign(cols, 0);
    for (int i = 0; i < n * n; ++i) {
      const int row = plane.first_y + ((first_row + y) * n + i / n) * plane.step,
                first_col = plane.first_x + i % n * plane.step;
      const Pixel* from = plane.image.ptr<Pixel>(row) + first_col * channels + plane.channel;
      float* to = band[y].data();
      // Strides that the compiler knows vectorise.
      if (stride == 1) {
        add_samples(from, 1, cols, scale, full_scale, to);
      } else if (stride == 2) {
        add_samples(from, 2, cols, scale, full_scale, to);
      } else {
        add_samples(from, stride, cols, scale, full_scale, to);
      }
      if (plane.mask.empty()) continue;
      const std::uint8_t* used = plane.mask.pixels().ptr<std::uint8_t>(row) + first_col;
      for (int x = 0; x < cols; ++x) to[x] += used[x * n * plane.step] == 0 ? kClipped : 0;
    }
  }
}

float checkerboard(float a, float b, float c, float d, float e) { return a + e + kOuter * (b + d) + kInner * c; }

/// Adds the squares of a band that are neither black nor saturated nor masked anywhere.
void add_squares(const Band& band, std::vector<float>& down, std::vector<float>& sums, std::vector<Square>& squares) {
  const int cols = static_cast<int>(band[0].size()), count = (cols - 2 * kReachPx) / kSquarePx;
  // By column: the filter's power, sum and sum of squares of the means, and whether a pixel is at the end of the range.
  sums.assign(4 * cols, 0);
  float *power = sums.data(), *first = power + cols, *second = first + cols, *clipped = second + cols;
  down.resize(cols);
  for (const std::vector<float>& row : band) {
    for (int x = 0; x < cols; ++x) clipped[x] += row[x] < 0 ? 1.0f : 0.0f;
  }
  for (int y = 0; y < kSquarePx; ++y) {
    const float *a = band[y].data(), *b = band[y + 1].data(), *c = band[y + 2].data(), *d = band[y + 3].data(),
                *e = band[y + 4].data();
    for (int x = 0; x < cols; ++x) down[x] = checkerboard(a[x], b[x], c[x], d[x], e[x]);
    for (int x = kReachPx; x < cols - kReachPx; ++x) {
      const float finest = checkerboard(down[x - 2], down[x - 1], down[x], down[x + 1], down[x + 2]);
      power[x] += finest * finest;
    }
    if (y % 2 == 1) continue;
    for (int x = kReachPx; x + 1 < cols - kReachPx; x += 2) {
      const float mean = (c[x] + c[x + 1] + d[x] + d[x + 1]) / 4;
      first[x] += mean;
      second[x] += mean * mean;
    }
  }
  for (int i = 0; i < count; ++i) {
    const auto sum = [&](const float* of, int reach_px = 0) {
      const float* first_column = of + kReachPx + i * kSquarePx;
      return std::accumulate(first_column - reach_px, first_column + kSquarePx + reach_px, 0.0);
    };
    if (sum(clipped, kReachPx) > 0) continue;
    constexpr int kMeans = kSquarePx * kSquarePx / 4;
    const double mean = sum(first) / kMeans;
    squares.push_back({std::max(0.0, (sum(second) - kMeans * mean * mean) / (kMeans - 1)),
                       sum(power) / (kSquarePx * kSquarePx * kFilterPower)});
  }
}

std::vector<Square> squares_of(const Plane& plane, int depth, int full_scale) {
  const int cols = (plane.cols() - 2 * kReachPx) / kSquarePx, rows = (plane.rows() - 2 * kReachPx) / kSquarePx;
  std::vector<Square> squares;
  if (cols <= 0 || rows <= 0) return squares;
  const int taken = std::clamp(static_cast<int>(kMaxSquares) / cols, 1, rows);
  Band band;
  std::vector<float> down, sums;
  for (int i = 0; i < taken; ++i) {
    const int row = static_cast<int>((2 * i + 1LL) * rows / (2 * taken)) * kSquarePx;
    if (depth == CV_8U) {
      load<std::uint8_t>(plane, row, full_scale, band);
    } else {
      load<std::uint16_t>(plane, row, full_scale, band);
    }
    add_squares(band, down, sums, squares);
  }
  return squares;
}

/// Variance of the noise, from squares in order of texture. What a little texture has of the finest detail is found
/// from squares that have more of both.
double variance_without_texture(const std::vector<Square>& squares) {
  const auto finest_of = [&](std::size_t begin, std::size_t end) {
    std::vector<double> finest;
    for (std::size_t i = begin; i < end; ++i) finest.push_back(squares[i].finest);
    return kMeanOverMedian * median(finest);
  };
  constexpr double kFlatShare = 0.05;
  const std::size_t count = squares.size();
  constexpr std::size_t kFlatSquares = 64;
  const std::size_t flat = std::max<std::size_t>(kFlatSquares, std::lround(kFlatShare * static_cast<double>(count)));
  const double flattest = finest_of(0, std::min(flat, count));
  if (count < kManySquares) return flattest;
  // A line through classes of squares, all of them equally certain in proportion to their size.
  constexpr double kClasses[] = {0, 0.02, 0.04, 0.08, 0.16, 0.3};
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
                                  const PixelMask& mask) {
  const int full_scale = image.depth() == CV_8U ? 255 : (1 << significant_bits) - 1;
  Plane plane = green_plane(image, layout);
  plane.mean_of = mean_of;
  plane.mask = mask;
  std::vector<Square> squares = squares_of(plane, image.depth(), full_scale);
  if (squares.size() < kMinSquares) return std::nullopt;
  std::sort(squares.begin(), squares.end(), [](const Square& a, const Square& b) { return a.texture < b.texture; });
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

double image_noise(const cv::Mat& luminance, const NoiseModel& model, const PixelMask& mask) {
  // Without a mask OpenCV wants none at all.
  const double mean = mask.empty() ? cv::mean(luminance)[0] : cv::mean(luminance, mask.pixels())[0];
  return std::sqrt(model.read_noise * model.read_noise + model.photon_gain * mean);
}

}  // namespace gyro_deblur
