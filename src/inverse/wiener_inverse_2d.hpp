// Parameters of the 2-D filter of a path.
#pragma once

#include "blur/path_2d.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

/// The Wiener inverse of the blur that `path_px` makes, by its transfer function H:
///   G(f) = (1 + N(0)) conj(H(f)) / (|H(f)|^2 + N(f)),   N(f) = noise_to_signal + noise_rise_px2 |f|^2,
/// f in cycles/px, so that G(0) = 1. The power of photographs falls with the square of the frequency (see
/// Regularization::FIXED): c / |f|^2 in grey levels squared, which makes white noise of sigma grey levels
/// N = sigma^2 |f|^2 / c.
struct WienerInverse2d {
  Path2d path_px;
  float noise_to_signal;  ///< > 0
  float noise_rise_px2;   ///< >= 0
};

/// Inverse with the options' noise_to_signal_ratio at 1/6 cycles/px, plus the part by noise. No other member
/// of the options is used.
/// @param noise_to_texture  see FilterBank::choose(), >= 0
inline WienerInverse2d wiener_inverse_2d(const Path2d& path_px, const FilterOptions& options,
                                         double noise_to_texture = 0) {
  // Share of the ratio at 1/6 cycles/px that does not rise with the frequency (doc/reports/filter_constants.md).
  constexpr double kConstantShare = 0.3, kSquaredFrequency = 1.0 / 36;
  // Weight of a block's noise: restores best of six (doc/reports/filter_constants.md).
  constexpr double kOfNoise = 0.3;
  return {path_px, static_cast<float>(kConstantShare * options.noise_to_signal_ratio),
          static_cast<float>((1 - kConstantShare) * options.noise_to_signal_ratio / kSquaredFrequency +
                             kOfNoise * noise_to_texture)};
}

}  // namespace gyro_deblur
