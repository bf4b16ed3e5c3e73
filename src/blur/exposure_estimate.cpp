#include "gyro_deblur/exposure_estimate.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

#include "base/median.hpp"
#include "blur/motion_spectrum.hpp"
#include "blur/ratio_fit.hpp"
#include "gyro_deblur/image_noise.hpp"

namespace gyro_deblur {
namespace {

// A third of a lobe of the highest frequencies that are seen.
constexpr double kStepLog = 0.04;
constexpr double kFineStepLog = 0.01;

/// What each window says of each ratio.
struct Costs {
  std::vector<double> log_ratios;
  std::vector<std::vector<double>> of_windows;  ///< by ratio, and window
};

/// What a window says, limited: some show what moves by itself.
double limited(double more) {
  constexpr double kByThemselves = 0.02;
  return -std::log((1 - kByThemselves) * std::exp(-more) + kByThemselves);
}

/// A negative log likelihood by ratio, of all windows together.
std::vector<double> sum_of(const Costs& costs, const std::vector<double>& least) {
  std::vector<double> sum;
  for (const std::vector<double>& of_windows : costs.of_windows) {
    double& of_ratio = sum.emplace_back(0);
    for (std::size_t w = 0; w < of_windows.size(); ++w) of_ratio += limited(of_windows[w] - least[w]);
  }
  return sum;
}

Costs costs_of(RatioFit* fit, double first_log, double step_log, int count) {
  Costs costs;
  for (int i = 0; i < count; ++i) {
    costs.log_ratios.push_back(first_log + i * step_log);
    costs.of_windows.push_back(fit->costs(std::exp(costs.log_ratios.back())));
  }
  return costs;
}

struct Peak {
  double log_ratio, log_stddev;
  double more_elsewhere;  ///< that no blur at all costs, or the best of other ratios
};

/// Median of the spectra's blur [px of the halved image].
double extent_px_of(const std::vector<MotionSpectrum>& spectra) {
  std::vector<double> extents_px;
  for (const MotionSpectrum& spectrum : spectra) extents_px.push_back(kMotionWindow * extent_of(spectrum.path));
  return median(extents_px);
}

/// The least cost, if it is not at an end.
std::optional<std::size_t> least_inside(const std::vector<double>& sum) {
  const auto least = std::min_element(sum.begin(), sum.end());
  if (least == sum.begin() || least + 1 == sum.end()) return std::nullopt;
  return static_cast<std::size_t>(least - sum.begin());
}

std::optional<Peak> peak_of(const std::vector<MotionSpectrum>& spectra, double first_log, double last_log) {
  if (spectra.empty()) return std::nullopt;
  constexpr int kBeyond = 2;
  const int count = static_cast<int>((last_log - first_log) / kStepLog) + 2 * kBeyond + 1;
  RatioFit fit(spectra, std::exp(last_log + 1));
  const std::vector<double> none = fit.costs(0);
  const Costs coarse = costs_of(&fit, first_log - kBeyond * kStepLog, kStepLog, count);
  std::vector<double> least = none;
  for (const std::vector<double>& of_windows : coarse.of_windows) {
    for (std::size_t w = 0; w < least.size(); ++w) least[w] = std::min(least[w], of_windows[w]);
  }
  const std::vector<double> sum = sum_of(coarse, least);
  const std::optional<std::size_t> best = least_inside(sum);
  // Of shorter blur the first zero is where photographs end, and their end is taken for it.
  constexpr double kLeastPx = 4.5;
  if (!best || std::exp(coarse.log_ratios[*best]) * extent_px_of(spectra) < kLeastPx) return std::nullopt;
  constexpr int kFine = 4;
  const Costs fine = costs_of(&fit, coarse.log_ratios[*best] - kFine * kFineStepLog, kFineStepLog, 2 * kFine + 1);
  const std::vector<double> fine_sum = sum_of(fine, least);
  const std::optional<std::size_t> at = least_inside(fine_sum);
  if (!at) return std::nullopt;
  const std::vector<double>&before = fine.of_windows[*at - 1], &after = fine.of_windows[*at + 1];
  const double curvature = fine_sum[*at - 1] - 2 * fine_sum[*at] + fine_sum[*at + 1];
  if (!(curvature > 0)) return std::nullopt;
  Peak peak;
  peak.log_ratio = fine.log_ratios[*at] + kFineStepLog * 0.5 * (fine_sum[*at - 1] - fine_sum[*at + 1]) / curvature;
  // With a likelihood that is not quite the truth: P. J. Huber, Proc. 5th Berkeley Symp. Math. Stat. Prob. 1, 1967.
  double squares = 0;
  for (std::size_t w = 0; w < least.size(); ++w) {
    const double slope = 0.5 * (limited(after[w] - least[w]) - limited(before[w] - least[w]));
    squares += slope * slope;
  }
  peak.log_stddev = kFineStepLog * std::sqrt(std::max(squares, curvature)) / curvature;
  constexpr double kSame = 0.1;
  peak.more_elsewhere = sum_of({{0}, {none}}, least).front() - fine_sum[*at];
  const auto compare = [&](const Costs& costs) {
    const std::vector<double> with = sum_of(costs, least);
    for (std::size_t i = 0; i < with.size(); ++i) {
      if (std::abs(costs.log_ratios[i] - peak.log_ratio) <= kSame) continue;
      peak.more_elsewhere = std::min(peak.more_elsewhere, with[i] - fine_sum[*at]);
    }
  };
  compare(coarse);
  // What is the least of the range may be the flank of what lies beyond it.
  constexpr double kReachLog = 0.9;
  const auto steps_beyond = [&](double from_log, double to_log) {
    return std::max(0, static_cast<int>(std::ceil((to_log - from_log) / kStepLog)));
  };
  const double lowest = coarse.log_ratios.front(), highest = coarse.log_ratios.back();
  compare(costs_of(&fit, highest + kStepLog, kStepLog, steps_beyond(highest, peak.log_ratio + kReachLog)));
  compare(costs_of(&fit, lowest - kStepLog, -kStepLog, steps_beyond(peak.log_ratio - kReachLog, lowest)));
  return peak;
}

}  // namespace

std::optional<ExposureEstimate> estimate_exposure(const FrameBlur& field, const cv::Mat& luminance,
                                                  std::optional<double> noise_grey_levels, int threads) {
  if (luminance.type() != CV_8UC1 || luminance.cols != field.grid.width_px() ||
      luminance.rows != field.grid.height_px()) {
    throw std::invalid_argument("the exposure needs 8-bit luminance of the blur field's size, " +
                                std::to_string(field.grid.width_px()) + "x" + std::to_string(field.grid.height_px()));
  }
  if (!noise_grey_levels) noise_grey_levels = image_noise(luminance, PixelLayout::GRAY);
  // Windows are chosen for the blur that is assumed; where it is another, they are chosen again.
  constexpr int kTries = 3;
  constexpr double kSameWindows = 0.4;
  double log_scale = 0;
  for (int i = 0; i < kTries; ++i) {
    const std::vector<MotionSpectrum> spectra =
        motion_spectra(field, luminance, std::exp(log_scale), noise_grey_levels.value_or(0), threads);
    const std::optional<Peak> peak =
        peak_of(spectra, std::log(kMinExposureRatio) - log_scale, std::log(kMaxExposureRatio) - log_scale);
    if (!peak) return std::nullopt;
    log_scale += peak->log_ratio;
    if (std::abs(peak->log_ratio) > kSameWindows) continue;
    // Of a log likelihood: what neither noise nor the texture of some windows makes.
    constexpr double kLeastMore = 8;
    if (peak->more_elsewhere < kLeastMore) return std::nullopt;
    // Errors that all windows have in common, of the velocity first of all; those of windows that overlap are alike.
    constexpr double kCommon = 0.01, kOverlap = 1.4;
    const double ratio = std::exp(log_scale);
    if (ratio < kMinExposureRatio || ratio > kMaxExposureRatio) return std::nullopt;
    return ExposureEstimate{ratio, std::hypot(kOverlap * peak->log_stddev, kCommon)};
  }
  return std::nullopt;
}

}  // namespace gyro_deblur
