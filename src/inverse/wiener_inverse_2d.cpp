// Noise-to-signal ratio of the 2-D filter.
#include "inverse/wiener_inverse_2d.hpp"

namespace gyro_deblur {

WienerInverse2d wiener_inverse_2d(const Path2d& path_px, const FilterOptions& options, double noise_to_texture) {
  // Share of the ratio at 1/6 cycles/px that does not rise with the frequency (doc/reports/filter_constants.md).
  constexpr double kConstantShare = 0.3, kSquaredFrequency = 1.0 / 36;
  // Weight of a block's noise: restores best of six (doc/reports/filter_constants.md).
  constexpr double kOfNoise = 0.3;
  return {path_px, static_cast<float>(kConstantShare * options.noise_to_signal_ratio),
          static_cast<float>((1 - kConstantShare) * options.noise_to_signal_ratio / kSquaredFrequency +
                             kOfNoise * noise_to_texture)};
}

}  // namespace gyro_deblur
