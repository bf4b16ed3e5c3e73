// Estimates the exposure time of one image from its power spectra.
#include "blur/exposure_estimate.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "base/median.hpp"
#include "blur/image_noise.hpp"
#include "blur/motion_spectrum.hpp"
#include "blur/path_1d.hpp"
#include "blur/ratio_fit.hpp"

namespace gyro_deblur {
namespace {

// A third of a lobe of the highest frequencies that are seen.
constexpr double kStepLog = 0.05;
constexpr double kFineStepLog = 0.012;
// What a ratio is compared with: a bit more than an octave on either side.
constexpr double kReachLog = 0.9;
// Of Newton's method, where the fit before was at a ratio far away.
constexpr int kBeginning = 4;
// Logarithm of the ratio of an image without blur.
constexpr double kNone = -std::numeric_limits<double>::infinity();

/// What each window says of each ratio: negative log likelihoods.
struct Costs {
  std::vector<double> log_ratios;
  std::vector<std::vector<double>> of_windows;  ///< by ratio, and window

  void add(RatioFit* fit, double log_ratio, int steps = 1) {
    log_ratios.push_back(log_ratio);
    of_windows.push_back(fit->costs(std::exp(log_ratio), steps));
  }
};

/// The least of each window.
std::vector<double> least_of(const Costs& costs, std::vector<double> least) {
  for (const std::vector<double>& of_windows : costs.of_windows) {
    for (std::size_t w = 0; w < least.size(); ++w) least[w] = std::min(least[w], of_windows[w]);
  }
  return least;
}

/// What a window says, limited: some show what moves by itself.
double limited(double more) {
  constexpr double kByThemselves = 0.02;
  return -std::log((1 - kByThemselves) * std::exp(-std::max(more, 0.0)) + kByThemselves);
}

/// Of all windows together, by ratio.
std::vector<double> sum_of(const Costs& costs, const std::vector<double>& least) {
  std::vector<double> sum;
  for (const std::vector<double>& of_windows : costs.of_windows) {
    double& of_ratio = sum.emplace_back(0);
    for (std::size_t w = 0; w < of_windows.size(); ++w) of_ratio += limited(of_windows[w] - least[w]);
  }
  return sum;
}

/// Median of the spectra's blur [px of the halved image].
double extent_px_of(const std::vector<MotionSpectrum>& spectra) {
  std::vector<double> extents_px;
  for (const MotionSpectrum& spectrum : spectra) extents_px.push_back(kMotionWindow * extent_of(spectrum.path));
  return median(extents_px);
}

std::size_t index_of_least(const std::vector<double>& sum) {
  return static_cast<std::size_t>(std::min_element(sum.begin(), sum.end()) - sum.begin());
}

/// All ratios of the range, after none at all; and where the best of them is near an end, as many beyond as it takes to
/// see whether it is but the flank of what lies there. None is beyond `limit_log`.
Costs coarse_costs(RatioFit* fit, double first_log, double last_log, double limit_log) {
  Costs costs;
  costs.add(fit, kNone, kBeginning);
  fit->costs(std::exp(first_log), kBeginning);
  double highest = first_log;
  for (; highest <= std::min(last_log, limit_log); highest += kStepLog) costs.add(fit, highest);
  const double best = costs.log_ratios[index_of_least(sum_of(costs, least_of(costs, costs.of_windows.front())))];
  if (best == kNone) return costs;
  for (; highest <= std::min(best + kReachLog, limit_log); highest += kStepLog) costs.add(fit, highest);
  fit->costs(std::exp(first_log), kBeginning);
  for (double lowest = first_log - kStepLog; lowest >= best - kReachLog; lowest -= kStepLog) costs.add(fit, lowest);
  return costs;
}

struct Peak {
  double log_ratio, log_stddev;
  double more_elsewhere;  ///< that no blur at all costs, or the best of other ratios
  double depth;           ///< of the zeros, 1 as the path has them
};

/// @param limit_log  of the logarithms of ratios: an exposure beyond it is impossible
std::optional<Peak> peak_of(const std::vector<MotionSpectrum>& spectra, double first_log, double last_log,
                            double limit_log) {
  if (spectra.empty()) return std::nullopt;
  RatioFit fit(spectra, std::exp(last_log + kReachLog));
  const Costs coarse = coarse_costs(&fit, first_log, last_log, limit_log);
  std::vector<double> least = least_of(coarse, coarse.of_windows.front());
  const double best = coarse.log_ratios[index_of_least(sum_of(coarse, least))];
  // Of shorter blur the first zero is where photographs end, and their end is taken for it.
  constexpr double kLeastPx = 4.5;
  if (best == kNone || std::exp(best) * extent_px_of(spectra) < kLeastPx) return std::nullopt;

  constexpr int kFine = 6, kExact = 2;
  Costs fine;
  fit.costs(std::exp(best - kFine * kFineStepLog), kBeginning);
  for (int i = -kFine; i <= kFine; ++i) fine.add(&fit, best + i * kFineStepLog, kExact);
  least = least_of(fine, std::move(least));
  const std::vector<double> sum = sum_of(coarse, least), fine_sum = sum_of(fine, least);
  const std::size_t at = index_of_least(fine_sum);
  if (at == 0 || at + 1 == fine_sum.size()) return std::nullopt;
  const std::vector<double>&before = fine.of_windows[at - 1], &after = fine.of_windows[at + 1];
  const double curvature = fine_sum[at - 1] - 2 * fine_sum[at] + fine_sum[at + 1];
  if (!(curvature > 0)) return std::nullopt;
  Peak peak;
  peak.log_ratio = fine.log_ratios[at] + kFineStepLog * 0.5 * (fine_sum[at - 1] - fine_sum[at + 1]) / curvature;
  fit.costs(std::exp(peak.log_ratio), kExact);
  peak.depth = fit.depth();
  // With a likelihood that is not quite the truth: P. J. Huber, Proc. 5th Berkeley Symp. Math. Stat. Prob. 1, 1967.
  double squares = 0;
  for (std::size_t w = 0; w < least.size(); ++w) {
    const double slope = 0.5 * (limited(after[w] - least[w]) - limited(before[w] - least[w]));
    squares += slope * slope;
  }
  peak.log_stddev = kFineStepLog * std::sqrt(std::max(squares, curvature)) / curvature;
  constexpr double kSame = 0.1;
  peak.more_elsewhere = sum.front() - fine_sum[at];
  for (std::size_t i = 1; i < sum.size(); ++i) {
    if (std::abs(coarse.log_ratios[i] - peak.log_ratio) <= kSame) continue;
    peak.more_elsewhere = std::min(peak.more_elsewhere, sum[i] - fine_sum[at]);
  }
  return peak;
}

}  // namespace

std::optional<ExposureEstimate> estimate_exposure(const FrameBlur& field, const cv::Mat& luminance,
                                                  std::optional<double> noise_grey_levels, int threads,
                                                  TimeNs limit_ns) {
  field.grid.require_luminance(luminance, "exposure estimation");
  if (!noise_grey_levels) noise_grey_levels = image_noise(luminance, PixelLayout::GRAY, 8, 1, {}, threads);
  // Windows are chosen for the blur that is assumed; where it is another, they are chosen again.
  constexpr int kTries = 3;
  constexpr double kSameWindows = 0.55;
  constexpr double kMargin = 1.1;  // the limit may be an estimate too
  const double limit_log =
      limit_ns > 0 ? std::log(kMargin * static_cast<double>(limit_ns) / static_cast<double>(field.exposure_ns))
                   : std::numeric_limits<double>::infinity();
  double log_scale = 0;
  for (int i = 0; i < kTries; ++i) {
    const std::vector<MotionSpectrum> spectra =
        motion_spectra(field, luminance, std::exp(log_scale), noise_grey_levels.value_or(0), threads);
    const std::optional<Peak> peak = peak_of(spectra, std::log(kMinExposureRatio) - log_scale,
                                             std::log(kMaxExposureRatio) - log_scale, limit_log - log_scale);
    if (!peak) return std::nullopt;
    log_scale += peak->log_ratio;
    if (std::abs(peak->log_ratio) > kSameWindows) continue;
    // A gain of log likelihood that neither noise nor the texture of some windows explains.
    constexpr double kLeastMore = 5;
    // Zeros, rather than texture that departs from a cubic.
    constexpr double kLeastDepth = 0.35;
    if (peak->more_elsewhere < kLeastMore || peak->depth < kLeastDepth) return std::nullopt;
    // Errors that all windows have in common, of the velocity first of all; those of windows that overlap are
    // correlated. The path of an assumed exposure that is too long has acceleration that the blur has not.
    constexpr double kCommon = 0.01, kTooLong = 0.02, kOverlap = 1.4;
    const double ratio = std::exp(log_scale);
    if (ratio < kMinExposureRatio || ratio > kMaxExposureRatio || log_scale > limit_log) return std::nullopt;
    return ExposureEstimate{ratio,
                            std::hypot(kOverlap * peak->log_stddev, kCommon, kTooLong * std::max(-log_scale, 0.0))};
  }
  return std::nullopt;
}

}  // namespace gyro_deblur
