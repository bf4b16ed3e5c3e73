// Compares a block's power spectrum with those of the predicted blur and of less blur.
#include "blur/blur_likelihood.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

#include "base/parallel.hpp"
#include "blur/spectrum_simd.hpp"
#include "blur/squared_transfer.hpp"

namespace gyro_deblur {
namespace {

/// Less blur than predicted, as a share of it (no blur at all is one of the hypotheses, too). The most comes first: the
/// texture is searched for from where it was with the hypothesis before.
constexpr std::array<double, 3> kLess = {0.5, 0.33, 0.15};

// Transfer functions are tabulated by frequency along the motion, in bins of a quarter of a wave a window: a lobe of
// the longest blur of a level, 32 px, has eight.
constexpr int kBinsPerWave = 4;
constexpr int kBins = 96;       // > sqrt(2) (kSpectrumWaves - 1) kBinsPerWave
constexpr int kFiner = 2;       // finer bins of the predicted blur, which the others read at shares of the frequency
constexpr int kFineBins = 201;  // > (kBins + kBinsPerWave) kFiner

using Table = std::array<float, kBins>;

std::array<double, kFineBins> squared_transfer_of(const BlockBlur& blur, double scale) {
  constexpr double kStep = 1.0 / (kSpectrumWindow * kBinsPerWave * kFiner), kRestPx = 1e-3;
  std::array<double, kFineBins> squared;
  if (!blur.nonuniform_path_px) {
    squared_transfer(std::array<double, 2>{0, scale * blur.extent_px}, kStep, kRestPx, &squared);
    return squared;
  }
  std::array<double, kPathInstants> places_px;
  for (int k = 0; k < kPathInstants; ++k) places_px[k] = scale * (*blur.nonuniform_path_px)[k];
  squared_transfer(places_px, kStep, kRestPx, &squared);
  return squared;
}

/// |H|^2 of `share` times the path, as the window smears it: Hann's has a spectrum of 1/2, 1 and 1/2, whose squares
/// are these weights.
/// @param left  what is between the lobes, at least
Table gain_of(const std::array<double, kFineBins>& squared, double share, double left) {
  std::array<double, kBins + 2 * kBinsPerWave> of_path;
  for (int i = 0; i < kBins + 2 * kBinsPerWave; ++i) {
    of_path[i] = squared[static_cast<int>(share * kFiner * std::abs(i - kBinsPerWave) + 0.5)];
  }
  Table gain;
  for (int i = 0; i < kBins; ++i) {
    gain[i] =
        static_cast<float>((of_path[i] + 4 * of_path[i + kBinsPerWave] + of_path[i + 2 * kBinsPerWave]) / 6 + left);
  }
  return gain;
}

/// How often an image is halved before blur of an extent is looked at: 8 to 32 px are left, which a window holds, and
/// the noise is less.
int halvings(double extent_px) { return extent_px < 16 ? 0 : extent_px < 64 ? 1 : 2; }
constexpr int kLevels = 3;

/// Limits every pixel to its neighbours: hot pixels have a white spectrum.
cv::Mat clipped(const cv::Mat& luminance, double noise_grey_levels, int threads) {
  // Of Gaussian noise hardly a pixel in a million is so far above the second largest of eight.
  constexpr double kStddevs = 4;
  const int margin = static_cast<int>(std::min(255.0, std::ceil(kStddevs * noise_grey_levels)));
  constexpr int kRowsAtATime = 32;
  cv::Mat image(luminance.size(), CV_8UC1);
  static const SpectrumSimd& simd = select_for_cpu<SpectrumSimd>();
  parallel_for(luminance.rows, threads, kRowsAtATime, [&](int y) {
    simd.clip_outliers(luminance.ptr<std::uint8_t>(std::max(y - 1, 0)), luminance.ptr<std::uint8_t>(y),
                       luminance.ptr<std::uint8_t>(std::min(y + 1, luminance.rows - 1)), luminance.cols, margin,
                       image.ptr<std::uint8_t>(y));
  });
  return image;
}

}  // namespace

PathPhases phases_of(const Path2d& path_px, double scale) {
  PathPhases phases{};
  for (int k = 0; k < kPathInstants - 1; ++k) {
    const Eigen::Vector2d begin = scale / kSpectrumWindow * path_px[k].cast<double>(),
                          end = scale / kSpectrumWindow * path_px[k + 1].cast<double>();
    const Eigen::Vector2d middle = begin + end, half = CV_PI * (end - begin);
    PathPhases::Segment& segment = phases.segments[k];
    segment.half_across = static_cast<float>(half.x());
    segment.half_down = static_cast<float>(half.y());
    // Each wave from that of one cycle less.
    const std::complex<double> step_across = std::polar(1.0, -CV_PI * middle.x()),
                               step_down = std::polar(1.0, -CV_PI * middle.y());
    std::complex<double> across = 1, down = 1;
    for (int wave = 0; wave <= kSpectrumWaves; ++wave) {
      segment.across_re[wave] = static_cast<float>(across.real());
      segment.across_im[wave] = static_cast<float>(across.imag());
      segment.down_re[kSpectrumWaves + wave] = segment.down_re[kSpectrumWaves - wave] = static_cast<float>(down.real());
      segment.down_im[kSpectrumWaves + wave] = static_cast<float>(down.imag());
      segment.down_im[kSpectrumWaves - wave] = static_cast<float>(-down.imag());
      across *= step_across;
      down *= step_down;
    }
  }
  return phases;
}

BlurLikelihood::BlurLikelihood(const cv::Mat& luminance, double noise_grey_levels, int threads) {
  CV_Assert(luminance.type() == CV_8UC1);
  levels_.push_back(noisy_image(clipped(luminance, noise_grey_levels, threads), noise_grey_levels));
  while (levels_.size() < kLevels) {
    const cv::Mat& finer = levels_.back().pixels;
    if (std::min(finer.cols, finer.rows) / 2 < kSpectrumWindow) break;
    levels_.push_back(downsample2x(levels_.back(), threads));
  }
}

int BlurLikelihood::level_of(double extent_px) const {
  return std::min(halvings(extent_px), static_cast<int>(levels_.size()) - 1);
}

int BlurLikelihood::window_px(double extent_px) const { return kSpectrumWindow << level_of(extent_px); }

double BlurLikelihood::log_ratio(const cv::Rect& block, const BlockBlur& blur) const {
  const int level = level_of(blur.extent_px);
  const cv::Mat& image = levels_[level].pixels;
  if (std::min(image.cols, image.rows) < kSpectrumWindow) return 0;
  const int shrink = 1 << level;
  const auto begin = [&](int middle_px, int size) {
    return std::clamp(middle_px / shrink - kSpectrumWindow / 2, 0, size - kSpectrumWindow);
  };
  const cv::Rect window(begin(block.x + block.width / 2, image.cols), begin(block.y + block.height / 2, image.rows),
                        kSpectrumWindow, kSpectrumWindow);

  static const SpectrumSimd& simd = select_for_cpu<SpectrumSimd>();
  const SpectrumOrder& order = spectrum_order();
  std::array<float, kSpectrumSize> spectrum;
  simd.power_spectrum(spectrum_tables(), image.ptr<std::uint8_t>(window.y, window.x),
                      static_cast<std::ptrdiff_t>(image.step[0]), spectrum.data());
  // The scale at which the log-logistic distribution fits the power of noise, which is exponential, best: then
  // E[2 P / (s + P)] = 1.
  constexpr double kScaleOfNoise = 0.6102;
  // Noise that is taken for less than it is looks like texture which no blur has touched, for more like nothing at all.
  constexpr double kMargin = 1.15;
  const auto unit = static_cast<float>(1 / (kMargin * kScaleOfNoise * levels_[level].noise_variance));
  std::array<float, kSpectrumPlaces> power, model;
  for (int i = 0; i < kSpectrumPlaces; ++i) power[i] = order.texture[i] > 0 ? unit * spectrum[order.at[i]] : 0;

  const auto bins_x = static_cast<float>(kBinsPerWave * std::cos(blur.angle_rad));
  const auto bins_y = static_cast<float>(kBinsPerWave * std::sin(blur.angle_rad));
  const auto squared = blur.curved_path_px ? std::array<double, kFineBins>{} : squared_transfer_of(blur, 1.0 / shrink);
  // What the window mixes, and a path that is not quite the predicted one: below the lobes of the longest blur.
  const double left = 0.003 / shrink;
  const auto model_of = [&](double share) {
    if (blur.curved_path_px) {
      const PathPhases phases = phases_of(*blur.curved_path_px, share / shrink);
      return simd.multiply_path_gain(order, phases, static_cast<float>(left), model.data());
    }
    simd.multiply_gain(order, gain_of(squared, share, left).data(), bins_x, bins_y, model.data());
  };
  // The first search begins at the mean power; each other one where the blur before it ended.
  constexpr int kFirstSteps = 6, kSteps = 2;
  const float sum = std::accumulate(power.begin(), power.end(), 0.0f) - kSpectrumPlaces;
  model_of(1);
  TextureFit fit;
  fit.log_power = std::log(std::max(sum, 0.05f * kSpectrumPlaces) / std::accumulate(model.begin(), model.end(), 0.0f));
  const double cost = simd.least_cost(order, power.data(), model.data(), kFirstSteps, &fit);
  std::array<double, kLess.size() + 1> more;  // that the other hypotheses cost
  for (std::size_t i = 0; i < kLess.size(); ++i) {
    model_of(kLess[i]);
    more[i] = simd.least_cost(order, power.data(), model.data(), kSteps, &fit) - cost;
  }
  more.back() = simd.least_cost(order, power.data(), order.texture, kSteps, &fit) - cost;
  const double least = *std::min_element(more.begin(), more.end());
  double likelihood = 0;
  for (const double m : more) likelihood += std::exp(least - m) / more.size();
  return least - std::log(likelihood);
}

std::vector<double> log_ratios(const FrameBlur& field, const BlurLikelihood& likelihood, int threads) {
  constexpr int kBlocksAtATime = 4;
  constexpr double kMostOfOne = 100;  // beyond every threshold
  const BlockGrid& grid = field.grid;
  const auto is_asked = [&](int i) { return field.blocks[i].status == BlockStatus::DEBLURRED; };
  const auto is_looked_at = [&](int i) {
    const int row = i / grid.cols(), col = i % grid.cols();
    const int window_px = likelihood.window_px(field.blocks[i].extent_px);
    if (window_px < 2 * grid.block_size_px()) return true;
    return window_px < 4 * grid.block_size_px() ? (row + col) % 2 == 0 : row % 2 == 0 && col % 2 == 0;
  };
  std::vector<double> ratios(field.blocks.size());
  parallel_for(grid.size(), threads, kBlocksAtATime, [&](int i) {
    if (is_asked(i) && is_looked_at(i)) ratios[i] = likelihood.log_ratio(grid.rect(i), field.blocks[i]);
  });
  parallel_for(grid.size(), threads, kBlocksAtATime, [&](int i) {
    if (!is_asked(i) || is_looked_at(i)) return;
    double sum = 0;
    int count = 0;
    grid.for_each_around(i, [&](int other) {
      if (!is_asked(other) || !is_looked_at(other)) return;
      sum += std::clamp(ratios[other], -kMostOfOne, kMostOfOne);
      ++count;
    });
    ratios[i] = count > 0 ? sum / count : likelihood.log_ratio(grid.rect(i), field.blocks[i]);
  });
  return ratios;
}

std::vector<double> with_neighbours(const BlockGrid& grid, const std::vector<double>& log_ratios) {
  // Of a neighbour, and of the frame. A larger limit decides better on blocks with noise, but lets more of a moving
  // object's edge follow its surroundings.
  constexpr double kMost = 5;
  // Effect of an error of the noise on blocks without texture, which all together would decide for a frame.
  constexpr double kNothing = 1;
  const auto limited = [&](double value) {
    return std::copysign(std::clamp(std::abs(value) - kNothing, 0.0, kMost), value);
  };
  double of_frame = 0;
  for (const double ratio : log_ratios) of_frame += limited(ratio);
  of_frame = std::clamp(of_frame, -kMost, kMost);
  std::vector<double> ratios = log_ratios;
  for (int i = 0; i < grid.size(); ++i) {
    ratios[i] += of_frame - limited(log_ratios[i]);
    grid.for_each_around(i, [&](int around) { ratios[i] += limited(log_ratios[around]); });
  }
  return ratios;
}

}  // namespace gyro_deblur
