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
WienerInverse2d wiener_inverse_2d(const Path2d& path_px, const FilterOptions& options, double noise_to_texture = 0);

}  // namespace gyro_deblur
