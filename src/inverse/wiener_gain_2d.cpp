// Computes the gain of a curved path's inverse.
#include "inverse/wiener_gain_2d.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace gyro_deblur {
namespace {

/// exp(-2 pi i f p) at the places p of a path along one axis, for `count` frequencies f = first, first + 1, .. cycles
/// in `size` px: real parts and then imaginary parts of all places, frequency by frequency. Each is the product of two
/// earlier ones, and steps between them are squares, so that errors grow with the logarithm of `count`.
void make_phases(const Path2d& path_px, int axis, int first, int count, int size, std::vector<float>& phases) {
  phases.resize(static_cast<std::size_t>(count) * kPhaseFloats);
  std::complex<double> steps[kPathInstants];  // from a frequency to that `made` later
  for (int k = 0; k < kPathInstants; ++k) {
    const double cycle_rad = -2 * M_PI * path_px[k][axis] / size;
    steps[k] = std::polar(1.0, cycle_rad);
    const std::complex<double> begin = std::polar(1.0, cycle_rad * first);
    phases[k] = static_cast<float>(begin.real());
    phases[k + kPathInstants] = static_cast<float>(begin.imag());
  }
  float step[kPhaseFloats];
  for (int made = 1; made < count; made *= 2) {
    for (int k = 0; k < kPathInstants; ++k) {
      const double re = steps[k].real(), im = steps[k].imag();
      step[k] = static_cast<float>(re);
      step[k + kPathInstants] = static_cast<float>(im);
      steps[k] = {re * re - im * im, 2 * re * im};
    }
    const int more = std::min(made, count - made);
    for (int i = 0; i < more; ++i) {
      const float* from = phases.data() + static_cast<std::ptrdiff_t>(i) * kPhaseFloats;
      float* to = phases.data() + static_cast<std::ptrdiff_t>(i + made) * kPhaseFloats;
      for (int k = 0; k < kPathInstants; ++k) {
        const float re = from[k], im = from[k + kPathInstants], c = step[k], s = step[k + kPathInstants];
        to[k] = re * c - im * s;
        to[k + kPathInstants] = re * s + im * c;
      }
    }
  }
}

}  // namespace

void WienerGain2d::set(const WienerInverse2d& inverse, const FourierTile& tile, const PlaneBand& band_across,
                       const PlaneBand& band_down) {
  const int cols = tile.across.size, rows = tile.down.size;
  make_phases(inverse.path_px, 0, -cols / 2, cols, cols, across_);
  make_phases(inverse.path_px, 1, 0, rows / 2, rows, down_);
  tables_.cols = cols;
  tables_.places = tile.across.places;
  tables_.across = across_.data();
  tables_.down = down_.data();
  for (int k = 0; k + 1 < kPathInstants; ++k) {
    const Eigen::Vector2f moved_px = inverse.path_px[k + 1] - inverse.path_px[k];
    tables_.slope_across[k] = static_cast<float>(M_PI / cols) * moved_px.x();
    tables_.slope_down[k] = static_cast<float>(M_PI / rows) * moved_px.y();
  }
  tables_.noise_to_signal = inverse.noise_to_signal;
  tables_.noise_rise_across = inverse.noise_rise_px2 / (static_cast<float>(cols) * static_cast<float>(cols));
  tables_.noise_rise_down = inverse.noise_rise_px2 / (static_cast<float>(rows) * static_cast<float>(rows));
  band_across_ = &band_across;
  band_down_ = &band_down;
}

void WienerGain2d::rows(int first_row, bool blurs_again, float* gain) {
  const auto band = blurs_again ? &PlaneBand::again : &PlaneBand::gain;
  tables_.band_across = (band_across_->*band).data();
  tables_.band_down = (band_down_->*band).data();
  simd_.gain_of_rows(tables_, first_row, blurs_again, gain);
}

}  // namespace gyro_deblur
