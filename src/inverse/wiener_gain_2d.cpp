// Computes the gain of a curved path's inverse.
#include "inverse/wiener_gain_2d.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace gyro_deblur {
namespace {

// Of half of kMaxFourierSize frequencies: 1, 2, 4 .. 256.
constexpr int kMaxPhaseSteps = 9;
static_assert(1 << kMaxPhaseSteps == kMaxFourierSize / 2, "every step has its place");

/// The phases of a path's segments along one axis (see kPhases) for `count` frequencies f = 0, 1, .. cycles in `size`
/// px. Steps between them are squares, so that errors grow with the logarithm of `count`.
void make_phases(const Path2d& path_px, int axis, int count, int size, const WienerGain2dSimd& simd,
                 std::vector<float>& phases) {
  std::complex<double> of_places[kPathInstants];
  for (int k = 0; k < kPathInstants; ++k) of_places[k] = std::polar(1.0, -M_PI * path_px[k][axis] / size);
  double re[kPhases], im[kPhases];
  for (int k = 0; k < kPathSegments; ++k) {
    const double a = of_places[k].real(), b = of_places[k].imag();
    const double c = of_places[k + 1].real(), d = of_places[k + 1].imag();
    re[k] = a * c - b * d;
    im[k] = a * d + b * c;
    re[kPathSegments + k] = a * c + b * d;
    im[kPathSegments + k] = b * c - a * d;
  }
  float steps[kMaxPhaseSteps * kPhaseFloats];
  float* step = steps;
  for (int made = 1; made < count; made *= 2, step += kPhaseFloats) {
    for (int k = 0; k < kPhases; ++k) {
      step[k] = static_cast<float>(re[k]);
      step[kPhases + k] = static_cast<float>(im[k]);
      const double squared = re[k] * re[k] - im[k] * im[k];
      im[k] *= 2 * re[k];
      re[k] = squared;
    }
  }
  phases.resize(static_cast<std::size_t>(count) * kPhaseFloats);
  simd.grow_phases(steps, count, phases.data());
}

}  // namespace

void WienerGain2d::set(const WienerInverse2d& inverse, const FourierTile& tile, const PlaneBand& band_across,
                       const PlaneBand& band_down) {
  const int cols = tile.across.size, rows = tile.down.size;
  make_phases(inverse.path_px, 0, cols / 2, cols, simd_, across_);
  make_phases(inverse.path_px, 1, rows / 2, rows, simd_, down_);
  tables_.cols = cols;
  tables_.places = tile.across.places;
  tables_.across = across_.data();
  tables_.down = down_.data();
  for (int k = 0; k < kPathSegments; ++k) {
    const Eigen::Vector2f moved_px = inverse.path_px[k + 1] - inverse.path_px[k];
    tables_.slope_across[k] = static_cast<float>(M_PI / cols) * moved_px.x();
    tables_.slope_down[k] = static_cast<float>(M_PI / rows) * moved_px.y();
  }
  tables_.noise_to_signal = inverse.noise_to_signal;
  tables_.noise_rise_across = inverse.noise_rise_px2 / (static_cast<float>(cols) * static_cast<float>(cols));
  tables_.noise_rise_down = inverse.noise_rise_px2 / (static_cast<float>(rows) * static_cast<float>(rows));
  tables_.band_across = band_across.gain.data();
  tables_.band_down = band_down.gain.data();
  tables_.again_across = band_across.again.data();
  tables_.again_down = band_down.again.data();
}

void WienerGain2d::rows(int first_row, float* gain, float* again) {
  simd_.gain_of_rows(tables_, first_row, gain, again);
}

}  // namespace gyro_deblur
