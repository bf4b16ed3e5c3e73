// Body of the loops that make the gain of a path's inverse, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "inverse/wiener_gain_2d_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

// Between two places p and q that a point runs through evenly, the mean of exp(-2 pi i f x) is
//   exp(-pi i f (p + q)) sin(t) / t,   t = pi f (q - p).
// (t sin(t) + this) / (t^2 + this) differs from sin(t) / t by a sixth of this at most and limits what rounding of
// sin(t) and t makes of small t. Reciprocals of powers of two are exact, so that the mean stays.
constexpr float kSmall = 1.0f / 16384;

/// Sums over the segments, of frequencies u and -u.
struct TransferPair {
  Vector re, im, mirrored_re, mirrored_im;
};

inline Vector mean_over(Vector sine, Vector t) { return (sine * t + kSmall) * reciprocal(t * t + kSmall); }

/// @param across  phases of u
/// @param down    phases of kLanes frequencies down, float by float
/// @param angles_across, angles_down  shares of t [rad], segment by segment
inline TransferPair transfer(const float* across, const float* down, const float* angles_across,
                             const Vector* angles_down) {
  TransferPair sums{};
  for (int k = 0; k < kPathSegments; ++k) {
    const int half = kPathSegments + k;
    const float c = across[k], s = across[kPhases + k];
    const float half_c = across[half], half_s = across[kPhases + half];
    const Vector re = load(down + k * kLanes), im = load(down + (kPhases + k) * kLanes);
    const Vector half_re = load(down + half * kLanes), half_im = load(down + (kPhases + half) * kLanes);
    const Vector c_re = c * re, s_im = s * im, c_im = c * im, s_re = s * re;
    const Vector sine_down = half_c * half_im, sine_across = half_s * half_re;
    const Vector mean = mean_over(sine_down + sine_across, angles_down[k] + angles_across[k]);
    const Vector mirrored = mean_over(sine_down - sine_across, angles_down[k] - angles_across[k]);
    sums.re += mean * (c_re - s_im);
    sums.im += mean * (c_im + s_re);
    sums.mirrored_re += mirrored * (c_re + s_im);
    sums.mirrored_im += mirrored * (c_im - s_re);
  }
  return sums;
}

static_assert(kPhases % kLanes == 0, "phases are whole vectors");

/// Each is the product of two earlier ones.
void grow_phases(const float* steps, int count, float* phases) {
  for (int k = 0; k < kPhaseFloats; ++k) phases[k] = k < kPhases ? 1.0f : 0.0f;
  for (int made = 1; made < count; made *= 2, steps += kPhaseFloats) {
    const int more = made < count - made ? made : count - made;
    for (int k = 0; k < kPhases; k += kLanes) {
      const Vector c = load(steps + k), s = load(steps + kPhases + k);
      const float* from = phases + k;
      float* to = phases + made * kPhaseFloats + k;
      for (int i = 0; i < more; ++i, from += kPhaseFloats, to += kPhaseFloats) {
        const Vector re = load(from), im = load(from + kPhases);
        store(to, re * c - im * s);
        store(to + kPhases, re * s + im * c);
      }
    }
  }
}

void gain_of_rows(const WienerGain2dTables& tables, int first_row, float* gain, float* again) {
  alignas(GYRO_DEBLUR_VECTOR_BYTES) float down[kPhaseFloats * kLanes];
  for (int k = 0; k < kPhaseFloats; k += kLanes) {
    transpose_floats(tables.down + static_cast<std::ptrdiff_t>(first_row) * kPhaseFloats + k, kPhaseFloats,
                     down + k * kLanes, kLanes);
  }
  Vector angles_down[kPathSegments], v;
  for (int i = 0; i < kLanes; ++i) v[i] = static_cast<float>(first_row + i);
  for (int k = 0; k < kPathSegments; ++k) angles_down[k] = tables.slope_down[k] * v;
  const Vector noise_down = tables.noise_to_signal + tables.noise_rise_down * (v * v);
  const float at_mean = 1 + tables.noise_to_signal;
  const Vector scale = at_mean * load(tables.band_down + first_row);
  const Vector scale_again = again == nullptr ? Vector{} : at_mean * load(tables.again_down + first_row);

  const Vector none = {};
  const int size = tables.cols;
  const auto put = [&](int u, int place, Vector re, Vector im) {
    re *= 1.0f / kPathSegments;
    im *= 1.0f / kPathSegments;
    const Vector power = re * re + im * im;
    const float noise_across = tables.noise_rise_across * static_cast<float>(u) * static_cast<float>(u);
    const Vector share = 1 / (power + (noise_down + noise_across));
    const Vector factor = scale * tables.band_across[u] * share;
    const std::ptrdiff_t to = static_cast<std::ptrdiff_t>(tables.places[place]) * 2 * kLanes;
    store(gain + to, re * factor);
    store(gain + to + kLanes, -im * factor);
    if (again == nullptr) return;
    store(again + to, power * (scale_again * tables.again_across[u] * share));
    store(again + to + kLanes, none);
  };
  for (int u = 0; u < size / 2; ++u) {
    float angles_across[kPathSegments];
    for (int k = 0; k < kPathSegments; ++k) angles_across[k] = static_cast<float>(u) * tables.slope_across[k];
    const TransferPair h =
        transfer(tables.across + static_cast<std::ptrdiff_t>(u) * kPhaseFloats, down, angles_across, angles_down);
    put(u, u, h.re, h.im);
    if (u > 0) put(u, size - u, h.mirrored_re, h.mirrored_im);
  }
  const std::ptrdiff_t half_a_cycle = static_cast<std::ptrdiff_t>(tables.places[size / 2]) * 2 * kLanes;
  for (int i = 0; i < 2; ++i) {
    store(gain + half_a_cycle + i * kLanes, none);
    if (again != nullptr) store(again + half_a_cycle + i * kLanes, none);
  }
}

}  // namespace

extern const WienerGain2dSimd kWienerGain2dSimd;
const WienerGain2dSimd kWienerGain2dSimd = {GYRO_DEBLUR_ISA_NAME, grow_phases, gain_of_rows};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
