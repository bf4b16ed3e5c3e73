// What is left of a blurred line's texture and noise by a Wiener filter, by extent and noise-to-signal ratio.
#pragma once

#include <vector>

namespace gyro_deblur {

constexpr double kMaxNoiseToSignalRatio = 1;

/// What to filter a block with, and what is expected of it.
struct FilterChoice {
  int ratio_doublings = 0;  ///< how often the noise-to-signal ratio is doubled, >= 0
  /// Expected share of the blur's error that filtering removes, less the noise that it adds; at most 1. Below 0
  /// filtering does harm. Smoothed noise does not count as a gain.
  double gain = 1;
  /// Variance of white noise after filtering over that before, > 0: the integral over f of |W|^2, see
  /// FilterBank::choose().
  double noise_gain = 1;
};

/// The integrals that FilterBank::choose() is about, made once for a noise-to-signal ratio and its doublings, and for
/// extents a quarter of an octave apart.
class ExpectedErrors {
 public:
  /// Precondition: 0 < noise_to_signal_ratio <= kMaxNoiseToSignalRatio.
  explicit ExpectedErrors(double noise_to_signal_ratio);

  /// How often the ratio is doubled until it reaches kMaxNoiseToSignalRatio.
  int doublings() const { return static_cast<int>(by_extent_.front().filtered.size()) - 1; }

  /// See FilterBank::choose(). Extents are clamped to those that have kernels.
  FilterChoice least(double extent_px, double noise_to_texture) const;

 private:
  /// For a texture of c = 1 and noise of v = 1.
  struct Error {
    double texture, noise;
  };
  struct AtExtent {
    double blurred;               ///< texture's error before
    std::vector<Error> filtered;  ///< by doubling
  };
  static AtExtent at_extent(double extent_px, double noise_to_signal_ratio);

  std::vector<AtExtent> by_extent_;
};

}  // namespace gyro_deblur
