// Finds the longest exposure time whose blur can still be removed.
#include "blur/exposure_advice.hpp"

#include <algorithm>
#include <cmath>

namespace gyro_deblur {

std::optional<ExposureTerms> exposure_terms(const FrameBlur& field, const FrameQuality& quality,
                                            const BlurFieldOptions& options) {
  const double relative_noise = noise_to_contrast(field);
  if (!quality.score || field.exposure_ns <= 0 || relative_noise <= 0) return std::nullopt;
  ExposureTerms terms;
  terms.speed_px_s = quality.before.median_px / to_seconds(field.exposure_ns);
  terms.exposure_ns = field.exposure_ns;
  terms.noise_to_contrast = relative_noise;
  terms.blur_field = options;
  return terms;
}

double expected_repeatability_at(const ExposureTerms& terms, TimeNs exposure_ns) {
  const double shorter = static_cast<double>(terms.exposure_ns) / static_cast<double>(exposure_ns);
  const double noise = terms.noise_to_contrast * std::sqrt(terms.noise.constant + terms.noise.photons * shorter +
                                                           terms.noise.reading * shorter * shorter);
  BlockBlur block;
  block.extent_px = static_cast<float>(terms.speed_px_s * to_seconds(exposure_ns));
  const double left = *expected_repeatability(block, noise);
  if (block.extent_px < terms.blur_field.min_extent_px || block.extent_px > terms.blur_field.max_extent_px) return left;
  block.status = BlockStatus::DEBLURRED;
  return std::max(left, *expected_repeatability(block, noise));  // see Regularization::ADAPTIVE
}

std::optional<ExposureAdvice> advise_exposure(const ExposureTerms& terms, TimeNs limit_ns) {
  constexpr TimeNs kShortestNs = 10'000;  // few sensors expose for less
  constexpr double kWell = 0.75, kStep = 1.01;
  const auto share_at = [&terms](TimeNs exposure_ns) { return expected_repeatability_at(terms, exposure_ns); };
  ExposureAdvice advice;
  const auto consider = [&](TimeNs exposure_ns) {
    const double share = share_at(exposure_ns);
    if (share > advice.best_share) advice.best_ns = exposure_ns, advice.best_share = share;
  };
  for (double step_ns = kShortestNs; step_ns < static_cast<double>(limit_ns); step_ns *= kStep) {
    consider(std::llround(step_ns));
  }
  consider(limit_ns);
  if (advice.best_share < kPoorScore) return std::nullopt;
  // From the limit back: what lies between may be less, where blur begins to be undone.
  const double enough = kWell * advice.best_share;
  TimeNs too_long_ns = limit_ns;
  advice.longest_ns = limit_ns;
  while (share_at(advice.longest_ns) < enough) {
    too_long_ns = advice.longest_ns;
    advice.longest_ns = std::max<TimeNs>(advice.best_ns, std::llround(static_cast<double>(advice.longest_ns) / kStep));
  }
  while (too_long_ns - advice.longest_ns > 1) {
    const TimeNs middle_ns = advice.longest_ns + (too_long_ns - advice.longest_ns) / 2;
    (share_at(middle_ns) < enough ? too_long_ns : advice.longest_ns) = middle_ns;
  }
  return advice;
}

}  // namespace gyro_deblur
