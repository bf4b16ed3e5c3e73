// Integrates the expected errors of a Wiener filter over frequency.
#include "inverse/expected_errors.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>

#include "inverse/filter_bank.hpp"

namespace gyro_deblur {
namespace {

constexpr double kExtentsPerOctave = 4;

double sinc(double x) { return std::abs(x) < 1e-9 ? 1 : std::sin(x) / x; }

}  // namespace

ExpectedErrors::AtExtent ExpectedErrors::at_extent(double extent_px, double noise_to_signal_ratio) {
  AtExtent errors{0, {}};
  for (double g = noise_to_signal_ratio; g < 2 * kMaxNoiseToSignalRatio; g *= 2) errors.filtered.push_back({0, 0});
  const double share = spectral_share(extent_px);
  // The middles of steps: sixteen between two zeros of the box's transform, half of the frequencies by symmetry.
  const int steps = static_cast<int>(std::ceil(8 * std::max(extent_px, 4.0)));
  for (int i = 0; i < steps; ++i) {
    const double f = 0.5 * (i + 0.5) / steps, texture = 1 / (f * f) / steps, noise = 1.0 / steps;
    const double h = sinc(CV_PI * extent_px * f), shape = share * (2 - 2 * std::cos(2 * CV_PI * f)) + 1 - share;
    errors.blurred += (1 - h) * (1 - h) * texture;
    double g = noise_to_signal_ratio;
    for (Error& error : errors.filtered) {
      g = std::min(g, kMaxNoiseToSignalRatio);
      // Scaled to a gain of 1 at frequency 0, as the kernels are.
      const double w = (1 + g * (1 - share)) * h / (h * h + g * shape);
      error.texture += (1 - w * h) * (1 - w * h) * texture;
      error.noise += w * w * noise;
      g *= 2;
    }
  }
  return errors;
}

ExpectedErrors::ExpectedErrors(double noise_to_signal_ratio) {
  const int count =
      static_cast<int>(std::ceil(kExtentsPerOctave * std::log2(kMaxKernelExtentPx / kMinKernelExtentPx))) + 1;
  for (int i = 0; i < count; ++i) {
    by_extent_.push_back(at_extent(kMinKernelExtentPx * std::exp2(i / kExtentsPerOctave), noise_to_signal_ratio));
  }
}

FilterChoice ExpectedErrors::least(double extent_px, double noise_to_texture) const {
  const double place =
      kExtentsPerOctave * std::log2(std::clamp(extent_px, kMinKernelExtentPx, kMaxKernelExtentPx) / kMinKernelExtentPx);
  const auto below = std::min(static_cast<std::size_t>(place), by_extent_.size() - 2);
  const double share = place - static_cast<double>(below);
  const AtExtent &shorter = by_extent_[below], &longer = by_extent_[below + 1];
  const auto between = [share](double a, double b) { return (1 - share) * a + share * b; };
  FilterChoice choice;
  Error chosen{};
  const auto sum = [noise_to_texture](const Error& error) { return error.texture + noise_to_texture * error.noise; };
  for (std::size_t i = 0; i < shorter.filtered.size(); ++i) {
    const Error &a = shorter.filtered[i], &b = longer.filtered[i];
    const Error error{between(a.texture, b.texture), between(a.noise, b.noise)};
    if (i > 0 && sum(error) >= sum(chosen)) continue;
    chosen = error;
    choice.ratio_doublings = static_cast<int>(i);
  }
  choice.noise_gain = chosen.noise;
  const double blurred = between(shorter.blurred, longer.blurred);
  choice.gain = 1 - (chosen.texture + noise_to_texture * std::max(0.0, chosen.noise - 1)) / blurred;
  return choice;
}

}  // namespace gyro_deblur
