// Body of the loop that makes the gain of a path's inverse, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "inverse/wiener_gain_2d_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

// Between two places p and q that a point runs through evenly, the mean of exp(-2 pi i f x) is
//   (exp(-2 pi i f q) - exp(-2 pi i f p)) i / 2t,   t = pi f (q - p).
// For small t rounding would grow as 1 / t; there the mean of the ends is as good, up to t^2 / 3.
constexpr float kSmall = 0.01f;

void gain_of_rows(const WienerGain2dTables& tables, int first_row, bool blurs_again, float* gain) {
  constexpr int kSegments = kPathInstants - 1;
  Vector down_re[kPathInstants], down_im[kPathInstants], from_down[kSegments], v;
  for (int i = 0; i < kLanes; ++i) {
    v[i] = static_cast<float>(first_row + i);
    const float* phases = tables.down + static_cast<std::ptrdiff_t>(first_row + i) * kPhaseFloats;
    for (int k = 0; k < kPathInstants; ++k) {
      down_re[k][i] = phases[k];
      down_im[k][i] = phases[kPathInstants + k];
    }
  }
  for (int k = 0; k < kSegments; ++k) from_down[k] = tables.slope_down[k] * v;
  const Vector noise_down = tables.noise_to_signal + tables.noise_rise_down * (v * v);
  const Vector scale = (1 + tables.noise_to_signal) * load(tables.band_down + first_row);

  const Vector none = {};
  const int size = tables.cols;
  const float* across = tables.across + kPhaseFloats;  // the first is half a cycle a pixel
  for (int u = 1 - size / 2; u < size / 2; ++u, across += kPhaseFloats) {
    Vector re = {}, im = {};  // 2 kSegments times the transfer function
    Vector before_re = across[0] * down_re[0] - across[kPathInstants] * down_im[0];
    Vector before_im = across[0] * down_im[0] + across[kPathInstants] * down_re[0];
    for (int k = 0; k < kSegments; ++k) {
      const float c = across[k + 1], s = across[k + 1 + kPathInstants];
      const Vector after_re = c * down_re[k + 1] - s * down_im[k + 1];
      const Vector after_im = c * down_im[k + 1] + s * down_re[k + 1];
      const Vector t = static_cast<float>(u) * tables.slope_across[k] + from_down[k];
      const Vector one_over_t = reciprocal(t);
      const IntVector is_small = t * t < kSmall * kSmall;
      re += is_small ? after_re + before_re : (before_im - after_im) * one_over_t;
      im += is_small ? after_im + before_im : (after_re - before_re) * one_over_t;
      before_re = after_re;
      before_im = after_im;
    }
    re *= 0.5f / kSegments;
    im *= 0.5f / kSegments;
    const Vector power = re * re + im * im;
    const float noise_across = tables.noise_rise_across * static_cast<float>(u) * static_cast<float>(u);
    const Vector factor = scale * tables.band_across[u < 0 ? -u : u] / (power + (noise_down + noise_across));
    float* to = gain + static_cast<std::ptrdiff_t>(tables.places[u < 0 ? u + size : u]) * 2 * kLanes;
    store(to, (blurs_again ? power : re) * factor);
    store(to + kLanes, blurs_again ? none : -im * factor);
  }
  float* to = gain + static_cast<std::ptrdiff_t>(tables.places[size / 2]) * 2 * kLanes;
  store(to, none);
  store(to + kLanes, none);
}

}  // namespace

extern const WienerGain2dSimd kWienerGain2dSimd;
const WienerGain2dSimd kWienerGain2dSimd = {GYRO_DEBLUR_ISA_NAME, gain_of_rows};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
