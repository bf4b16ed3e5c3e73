// Computes power spectra along the motion.
#include "blur/motion_spectrum.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <numeric>
#include <utility>

#include <Eigen/LU>

#include "base/fourier.hpp"
#include "base/fourier_simd.hpp"
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "blur/noisy_image.hpp"

namespace gyro_deblur {
namespace {

constexpr int kWindow = kMotionWindow;
// Up to .34 cycles/px; beyond, cameras' own filters and halving leave little.
constexpr int kWaves = 44;
// Below, the window mixes frequencies with the mean.
constexpr int kFirstWave = 2;

using Path2 = std::array<Eigen::Vector2d, kPathInstants>;

bool is_usable(const BlockBlur& block) {
  return has_known_blur(block.status) && block.status != BlockStatus::STATIC_EDGE;
}

Path2 path_of(const BlockBlur& block) {
  Path2 path_px;
  const Eigen::Vector2d line(std::cos(block.angle_rad), std::sin(block.angle_rad));
  for (int k = 0; k < kPathInstants; ++k) {
    if (block.curved_path_px) {
      path_px[k] = (*block.curved_path_px)[k].cast<double>();
    } else if (block.nonuniform_path_px) {
      path_px[k] = (*block.nonuniform_path_px)[k] * line;
    } else {
      path_px[k] = (static_cast<double>(k) / (kPathInstants - 1) - 0.5) * block.extent_px * line;
    }
  }
  return path_px;
}

/// Hann's window, scaled to keep the variance of white noise.
const std::array<float, kWindow>& window_weights() {
  static const auto kWeights = [] {
    std::array<float, kWindow> window;
    for (int i = 0; i < kWindow; ++i) {
      window[i] = static_cast<float>(std::sqrt(2.0 / 3) * (1 - std::cos(2 * CV_PI * (i + 0.5) / kWindow)));
    }
    return window;
  }();
  return kWeights;
}

/// Share of a window that is `shrink` times as long and begins at first_px, by its weights squared, that lies in
/// [begin_px, end_px).
double share_within(int begin_px, int end_px, int first_px, int shrink) {
  static const auto kShares = [] {
    std::array<double, kWindow + 1> shares{};  // of the window squared, summed from its begin
    for (int i = 0; i < kWindow; ++i) shares[i + 1] = shares[i] + std::pow(window_weights()[i], 2) / kWindow;
    return shares;
  }();
  return kShares[(end_px - first_px) / shrink] - kShares[(begin_px - first_px) / shrink];
}

struct WindowBlur {
  Path2 path_px;                       // the mean of what its blocks have, by their weight in the window
  Eigen::Matrix2d chord_variance_px2;  // within the window, of the path from its first to its last place
};

/// Nothing where too little of the window is known.
std::optional<WindowBlur> blur_in(const FrameBlur& field, const cv::Rect& window_px, int shrink) {
  constexpr double kLeastShare = 0.7;
  const BlockGrid& grid = field.grid;
  Path2 sum;
  sum.fill(Eigen::Vector2d::Zero());
  const Eigen::Vector2d middle_px =
      0.5 * Eigen::Vector2d(window_px.tl().x + window_px.br().x, window_px.tl().y + window_px.br().y);
  Eigen::Vector2d places_px = Eigen::Vector2d::Zero();
  Eigen::Matrix2d squares_px2 = Eigen::Matrix2d::Zero(), products_px2 = Eigen::Matrix2d::Zero();
  double all = 0, usable = 0;
  const int size_px = grid.block_size_px();
  const int end_row = std::min((window_px.br().y - 1) / size_px + 1, grid.rows());
  const int end_col = std::min((window_px.br().x - 1) / size_px + 1, grid.cols());
  for (int row = window_px.y / size_px; row < end_row; ++row) {
    for (int col = window_px.x / size_px; col < end_col; ++col) {
      const int i = row * grid.cols() + col;
      const cv::Rect shared = grid.rect(i) & window_px;
      const double weight = share_within(shared.x, shared.br().x, window_px.x, shrink) *
                            share_within(shared.y, shared.br().y, window_px.y, shrink);
      all += weight;
      if (!is_usable(field.blocks[i])) continue;
      const Path2 path_px = path_of(field.blocks[i]);
      double same_way = 0;  // a path and its opposite make the same blur
      for (int k = 0; k < kPathInstants; ++k) same_way += path_px[k].dot(sum[k]);
      const double signed_weight = same_way < 0 ? -weight : weight;
      for (int k = 0; k < kPathInstants; ++k) sum[k] += signed_weight * path_px[k];
      usable += weight;
      const Eigen::Vector2d from_middle_px = grid.center(i) - middle_px;
      places_px += weight * from_middle_px;
      squares_px2 += weight * from_middle_px * from_middle_px.transpose();
      products_px2 += signed_weight * (path_px.back() - path_px.front()) * from_middle_px.transpose();
    }
  }
  if (usable < kLeastShare * all || usable == 0) return std::nullopt;
  for (Eigen::Vector2d& place : sum) place /= usable;
  // The chord as a linear function of the place: blocks are too coarse for its variance, and their errors add to it.
  constexpr double kLeastScatterPx2 = 1;  // of the blocks' centres, where all are in one row or column
  const double window_variance = 1.0 / 12 - 5 / (8 * CV_PI * CV_PI);  // of Hann's window squared, over its side squared
  places_px /= usable;
  const Eigen::Matrix2d scatter_px2 =
      squares_px2 / usable - places_px * places_px.transpose() + kLeastScatterPx2 * Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d slope =
      (products_px2 / usable - (sum.back() - sum.front()) * places_px.transpose()) * scatter_px2.inverse();
  return WindowBlur{sum, window_variance * window_px.width * window_px.width * slope * slope.transpose()};
}

/// The line that lies nearest to the places.
Eigen::Vector2d direction_of(const Path2& path_px) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& place : path_px) mean += place / kPathInstants;
  double xx = 0, xy = 0, yy = 0;
  for (const Eigen::Vector2d& place : path_px) {
    const Eigen::Vector2d from_mean = place - mean;
    xx += from_mean.x() * from_mean.x();
    xy += from_mean.x() * from_mean.y();
    yy += from_mean.y() * from_mean.y();
  }
  const double angle_rad = 0.5 * std::atan2(2 * xy, xx - yy);
  return {std::cos(angle_rad), std::sin(angle_rad)};
}

double extent_along(const Path2& path_px, const Eigen::Vector2d& direction) {
  double lowest = direction.dot(path_px[0]), highest = lowest;
  for (const Eigen::Vector2d& place : path_px) {
    lowest = std::min(lowest, direction.dot(place));
    highest = std::max(highest, direction.dot(place));
  }
  return highest - lowest;
}

struct Window {
  cv::Rect rect;    // [px of the halved image]
  WindowBlur blur;  // of the full image
};

/// The image, halved as often as suits the blur.
struct Halved {
  NoisyImage image;
  int shrink;
};

/// Extents from 11 to 22 px are left, of which a window holds 6 to 11: as many lobes are seen with a third of the blur
/// as with three times as much.
Halved halved(const cv::Mat& luminance, double extent_px, double noise, int threads) {
  constexpr double kLargestPx = kWindow / 5.66;
  constexpr int kFewest = 3;  // windows side by side, of an image that is halved
  Halved level{noisy_image(luminance, noise), 1};
  while (extent_px / level.shrink > kLargestPx &&
         std::min(level.image.pixels.cols, level.image.pixels.rows) >= kFewest * kWindow) {
    level = {downsample2x(level.image, threads), 2 * level.shrink};
  }
  return level;
}

/// Places of windows, evenly, about `step_px` apart.
std::vector<int> places(int size_px, double step_px) {
  const int steps = cvRound((size_px - kWindow) / step_px);
  std::vector<int> begins;
  for (int i = 0; i <= steps; ++i) begins.push_back((2 * i + 1) * (size_px - kWindow) / (2 * steps + 2));
  return begins;
}

// Power of usual texture falls with this power of the frequency.
constexpr double kTexture = 2.5;

/// One over the power that texture usually has: |f|^2.5 [waves a window], by squared frequency.
const std::vector<float>& whitening() {
  static const std::vector<float> kWhitening = [] {
    std::vector<float> table(kWaves * kWaves + 1);
    for (std::size_t i = 0; i < table.size(); ++i) table[i] = static_cast<float>(std::pow(i, kTexture / 2));
    return table;
  }();
  return kWhitening;
}

// Waves along the motion to the nearest whole number make a point; kPoints with those that are not used.
constexpr int kPoints = kWaves + 1;

/// Frequencies of the plane, those of one slice and point together.
struct Samples {
  std::vector<float> power, noise;  // whitened
  std::vector<float> along, tilt;
  std::vector<float> steepness2;  // squared part across the motion over that along it
  std::vector<int> begins;        // by slice and point, and where the last one ends

  void resize(std::size_t count) {
    for (std::vector<float>* values : {&power, &noise, &along, &tilt, &steepness2}) values->resize(count);
  }
};

/// Sums over the frequencies of one point of a spectrum.
struct Sums {
  float weight = 0, power = 0, noise = 0, frequency = 0, tilt = 0, steepness2 = 0;
};

/// With the weights that give the mean power the least variance, if the signal is known.
Sums sums_of(const Samples& samples, int begin, int end, float signal) {
  const float *power = samples.power.data(), *noise = samples.noise.data(), *along = samples.along.data(),
              *tilt = samples.tilt.data(), *steepness2 = samples.steepness2.data();
  float weights = 0, powers = 0, noises = 0, frequencies = 0, tilts = 0, steep = 0;
#pragma omp simd reduction(+ : weights, powers, noises, frequencies, tilts, steep)
  for (int i = begin; i < end; ++i) {
    const float both = signal + noise[i], weight = 1 / (both * both);
    weights += weight;
    powers += weight * power[i];
    noises += weight * noise[i];
    frequencies += weight * along[i];
    tilts += weight * tilt[i];
    steep += weight * steepness2[i];
  }
  return {weights, powers, noises, frequencies, tilts, steep};
}

/// @param steepness       of the slice's middle
/// @param chord_variance  within the window, along and across the motion, over the squared extent; none is seen of a
///                        path that returns to its start
std::vector<SpectrumPoint> points_of(const Samples& samples, int slice, double steepness,
                                     const Eigen::Matrix2d& chord_variance) {
  // Powers of neighbouring frequencies are correlated, by Hann's window: 1.94 of them along each axis have the
  // information of one that is independent.
  constexpr float kCorrelatedPowers = 1.94F * 1.94F;
  constexpr int kFewest = 4;
  constexpr int kPasses = 3;
  std::vector<SpectrumPoint> points;
  for (int i = kFirstWave; i <= kWaves; ++i) {
    const int begin = samples.begins[slice * kPoints + i], end = samples.begins[slice * kPoints + i + 1];
    if (end - begin < kFewest) continue;
    Sums sum;
    float signal = 1;
    for (int pass = 0; pass < kPasses; ++pass) {
      sum = sums_of(samples, begin, end, signal);
      const float power = sum.power / sum.weight, noise = sum.noise / sum.weight;
      signal = std::max(power - noise, 0.1F * noise + 1e-9F);
    }
    if (!(sum.power > 0)) continue;
    SpectrumPoint& point = points.emplace_back();
    point.frequency = sum.frequency / sum.weight;
    point.power = sum.power / sum.weight;
    point.noise = sum.noise / sum.weight;
    // An exponential distribution's deviation is its mean: with the weights above that of their mean is this.
    point.log_variance = kCorrelatedPowers / (sum.weight * point.power * point.power);
    point.spread =
        static_cast<float>(std::sqrt(std::max(0.0, chord_variance(0, 0) + 2 * steepness * chord_variance(0, 1) +
                                                       sum.steepness2 / sum.weight * chord_variance(1, 1))));
    point.tilt = sum.tilt / sum.weight;
  }
  return points;
}

/// Slices of frequencies by direction, of a curved path: in each the path is another one along the line.
/// `across` over `along` is that of the slice's middle.
struct Slices {
  int count = 1;
  double step = 0;  // of across / along
};
constexpr double kSteepest = 1.6;  // across / along, of frequencies that are used

Slices slices_of(const Path2& path_px, const Eigen::Vector2d& direction) {
  // At three times the blur's first zero, how far a phase may be off at a slice's border [cycles].
  constexpr double kOffCycles = 0.12, kLobes = 3;
  constexpr int kMost = 5;
  const Eigen::Vector2d normal(-direction.y(), direction.x());
  const double along_px = extent_along(path_px, direction), across_px = extent_along(path_px, normal);
  const double step = 2 * kOffCycles / (kLobes * across_px / (2 * std::max(along_px, 1e-6)));
  Slices slices;
  slices.count = std::min(kMost, static_cast<int>(std::ceil(2 * kSteepest / step)));
  if (slices.count <= 1) return {};
  slices.step = 2 * kSteepest / slices.count;
  return slices;
}

/// What a thread works with. OpenCV's matrices begin on a cache line.
struct Scratch {
  cv::Mat tile = cv::Mat(kWindow, fourier_stride(kWindow), CV_32F);
  cv::Mat transform = cv::Mat(1, fourier_scratch(kWindow), CV_32F);
  cv::Mat powers = cv::Mat(kWindow, kWindow / 2, CV_32F);  // by frequency across (those below 0 at the end), and down
  std::vector<int> keys;                                   // slice and point of each frequency; -1: not used
  Samples samples;
};

void take_powers(const cv::Mat& window, Scratch* scratch) {
  static const FourierSimd& simd = select_for_cpu<FourierSimd>();
  static const FourierPlan kPlan(kWindow, simd.largest_radix);
  const FourierTile plan{kPlan.stages(), kPlan.stages()};
  const std::array<float, kWindow>& weights = window_weights();
  const auto mean = static_cast<float>(cv::mean(window)[0]);
  for (int y = 0; y < kWindow; ++y) {
    const std::uint8_t* from = window.ptr<std::uint8_t>(y);
    float* to = scratch->tile.ptr<float>(y);
    for (int x = 0; x < kWindow; ++x) to[x] = (from[x] - mean) * (weights[x] * weights[y]);
  }
  auto *tile = scratch->tile.ptr<float>(), *transform = scratch->transform.ptr<float>();
  simd.transform_columns(plan, tile, transform);
  for (int row = 0; row <= kWaves; row += simd.lanes) {
    simd.row_powers(plan, row, tile, scratch->powers.ptr<float>(), transform);
  }
}

/// A frequency's part along the motion [waves]; that of the opposite one, which has the same power, where it is below
/// 0.
inline float along_of(int u, int v, float dx, float dy) {
  return std::abs(static_cast<float>(u) * dx + static_cast<float>(v) * dy);
}

/// Finds the slice and point of each frequency, and how many each has.
void take_keys(const Slices& slices, float dx, float dy, Scratch* scratch) {
  scratch->keys.assign(kWaves * (2 * kWaves + 1), -1);
  std::vector<int>& begins = scratch->samples.begins;
  begins.assign(slices.count * kPoints + 1, 0);
  int* key = scratch->keys.data();
  for (int u = 1; u <= kWaves; ++u) {
    for (int v = -kWaves; v <= kWaves; ++v, ++key) {
      const int squared = u * u + v * v;
      if (squared > kWaves * kWaves || squared < kFirstWave * kFirstWave) continue;
      const int point = static_cast<int>(along_of(u, v, dx, dy) + 0.5F);
      if (point < kFirstWave) continue;
      int slice = 0;
      if (slices.count > 1) {
        const float along = static_cast<float>(u) * dx + static_cast<float>(v) * dy;
        const float across = static_cast<float>(v) * dx - static_cast<float>(u) * dy;
        const double place = (across / along + kSteepest) / slices.step;
        if (place < 0 || place >= slices.count) continue;
        slice = static_cast<int>(place);
      }
      *key = slice * kPoints + point;
      ++begins[*key + 1];
    }
  }
  std::partial_sum(begins.begin(), begins.end(), begins.begin());
}

void take_samples(const Slices& slices, const Eigen::Vector2d& direction, float noise_variance, Scratch* scratch) {
  constexpr float kScale = 1.0F / (kWindow * kWindow);
  const auto dx = static_cast<float>(direction.x()), dy = static_cast<float>(direction.y());
  const std::vector<float>& white = whitening();
  take_keys(slices, dx, dy, scratch);
  Samples& samples = scratch->samples;
  samples.resize(samples.begins.back());
  std::vector<int> next = samples.begins;
  const int* key = scratch->keys.data();
  for (int u = 1; u <= kWaves; ++u) {
    // The power at (u, v) is that at (-u, -v).
    const float *powers = scratch->powers.ptr<float>(u), *opposite = scratch->powers.ptr<float>(kWindow - u);
    for (int v = -kWaves; v <= kWaves; ++v, ++key) {
      if (*key < 0) continue;
      const int i = next[*key]++, squared = u * u + v * v;
      const float along = along_of(u, v, dx, dy);
      samples.power[i] = kScale * white[squared] * (v < 0 ? opposite[-v] : powers[v]);
      samples.noise[i] = noise_variance * white[squared];
      samples.along[i] = along;
      samples.steepness2[i] = (static_cast<float>(squared) - along * along) / (along * along);
      samples.tilt[i] = static_cast<float>(kTexture) * along / static_cast<float>(squared);
    }
  }
}

void add_spectra(const Window& window, int index, const Halved& level, Scratch* scratch,
                 std::vector<MotionSpectrum>* spectra) {
  take_powers(level.image.pixels(window.rect), scratch);
  const Path2& path_px = window.blur.path_px;
  const Eigen::Vector2d direction = direction_of(path_px), normal(-direction.y(), direction.x());
  const Slices slices = slices_of(path_px, direction);
  Eigen::Matrix2d axes;
  axes << direction, normal;
  const Eigen::Matrix2d chord_variance =
      axes.transpose() * window.blur.chord_variance_px2 * axes / std::pow(extent_along(path_px, direction), 2);
  take_samples(slices, direction, static_cast<float>(level.image.noise_variance), scratch);
  for (int slice = 0; slice < slices.count; ++slice) {
    const double steepness = slices.count > 1 ? -kSteepest + (slice + 0.5) * slices.step : 0;
    MotionSpectrum motion{index, {}, points_of(scratch->samples, slice, steepness, chord_variance)};
    const double windows_per_px = 1.0 / (level.shrink * kWindow);
    for (int k = 0; k < kPathInstants; ++k) {
      motion.path[k] = static_cast<float>(windows_per_px * (direction + steepness * normal).dot(path_px[k]));
    }
    if (!motion.points.empty()) spectra->push_back(std::move(motion));
  }
}

}  // namespace

std::vector<MotionSpectrum> motion_spectra(const FrameBlur& field, const cv::Mat& luminance, double scale, double noise,
                                           int threads) {
  constexpr double kLeastPx = 2;
  std::vector<double> extents_px;
  for (const BlockBlur& block : field.blocks) {
    if (is_usable(block) && scale * block.extent_px >= kLeastPx) extents_px.push_back(scale * block.extent_px);
  }
  if (extents_px.empty() || std::min(luminance.cols, luminance.rows) < kWindow) return {};
  const Halved level = halved(luminance, median(extents_px), noise, threads);
  std::vector<Window> windows;
  // Those that overlap by more than half add little; more than some 16 are not needed.
  constexpr double kWindows = 16;
  const double step_px = std::max(0.5 * kWindow, std::sqrt(static_cast<double>(level.image.pixels.total()) / kWindows));
  for (const int y : places(level.image.pixels.rows, step_px)) {
    for (const int x : places(level.image.pixels.cols, step_px)) {
      const cv::Rect rect(x, y, kWindow, kWindow);
      const cv::Rect rect_px(level.shrink * x, level.shrink * y, level.shrink * kWindow, level.shrink * kWindow);
      std::optional<WindowBlur> blur = blur_in(field, rect_px, level.shrink);
      if (!blur) continue;
      for (Eigen::Vector2d& place : blur->path_px) place *= scale;
      blur->chord_variance_px2 *= scale * scale;
      if (extent_along(blur->path_px, direction_of(blur->path_px)) >= kLeastPx) windows.push_back({rect, *blur});
    }
  }
  std::vector<std::vector<MotionSpectrum>> of_windows(windows.size());
  const int used = threads_or_all(threads);  // once: the number of cores may change
  std::vector<Scratch> scratch(used);
  constexpr int kWindowsAtATime = 2;
  parallel_for(static_cast<int>(windows.size()), used, kWindowsAtATime,
               [&](int i, int thread) { add_spectra(windows[i], i, level, &scratch[thread], &of_windows[i]); });
  std::vector<MotionSpectrum> spectra;
  for (std::vector<MotionSpectrum>& of_window : of_windows) {
    std::move(of_window.begin(), of_window.end(), std::back_inserter(spectra));
  }
  return spectra;
}

}  // namespace gyro_deblur
