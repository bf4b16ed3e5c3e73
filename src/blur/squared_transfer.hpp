// Squared transfer function of a path.
#pragma once

#include <array>
#include <cmath>
#include <complex>
#include <cstddef>

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// |H|^2 of a path, even between its places, at as many frequencies from 0 on as `squared` has, `step` cycles apart.
/// @param rest  a segment that moves by less stands still; in the unit of the places
template <typename Place, std::size_t kPlaces, typename Squared>
void squared_transfer(const std::array<Place, kPlaces>& places, double step, double rest, Squared* squared) {
  // The integral of exp(-i w p) over a segment from a to b is (exp(-i w a) - exp(-i w b)) / (i w (b - a)).
  std::array<std::complex<double>, kPlaces> phase, phase_step;
  for (std::size_t k = 0; k < kPlaces; ++k) {
    phase[k] = 1;
    phase_step[k] = std::polar(1.0, -2 * CV_PI * step * places[k]);
  }
  (*squared)[0] = 1;
  for (std::size_t i = 1; i < squared->size(); ++i) {
    for (std::size_t k = 0; k < kPlaces; ++k) phase[k] *= phase_step[k];
    std::complex<double> sum = 0;
    for (std::size_t k = 0; k + 1 < kPlaces; ++k) {
      const double moved = places[k + 1] - places[k];
      const std::complex<double> middle = 0.5 * (phase[k] + phase[k + 1]), end = phase[k] - phase[k + 1];
      sum += std::abs(moved) < rest
                 ? middle
                 : std::complex<double>(end.imag(), -end.real()) / (2 * CV_PI * step * static_cast<double>(i) * moved);
    }
    (*squared)[i] = static_cast<typename Squared::value_type>(std::norm(sum) / ((kPlaces - 1.0) * (kPlaces - 1.0)));
  }
}

}  // namespace gyro_deblur
