// The loops that validation by likelihood spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/instruction_sets.hpp"
#include "blur/path_1d.hpp"

namespace gyro_deblur {

/// Side of the window whose spectrum is taken [px].
constexpr int kSpectrumWindow = 64;

/// Frequencies of a spectrum along each axis: 0 .. kSpectrumWaves - 1 waves in a window. Beyond a quarter of the
/// sampling frequency photographs have too little power to show blur of 5 px and more.
constexpr int kSpectrumWaves = 16;

/// Frequencies of a spectrum: (x, y) is at y * kSpectrumWaves + x, (x, -y) behind all of those.
constexpr int kSpectrumSize = 2 * kSpectrumWaves * kSpectrumWaves;

/// The first half of a symmetric (cosine) and an antisymmetric (sine) transform from the middle of a window, times
/// Hann's window, which is scaled to leave white noise its variance.
struct SpectrumTables {
  float cosine[kSpectrumWindow / 2][kSpectrumWaves], sine[kSpectrumWindow / 2][kSpectrumWaves];
  float cosine_of_wave[kSpectrumWaves][kSpectrumWindow / 2], sine_of_wave[kSpectrumWaves][kSpectrumWindow / 2];
};

/// A curved path that is straight and of uniform speed from place to place: exp(-2 pi i f p) at the middles of its
/// segments is the product of what frequencies across and down make of it.
struct PathPhases {
  static constexpr int kAcross = 32;  // > kSpectrumWaves, whole vectors
  static constexpr int kDown = 2 * kSpectrumWaves + 1;
  struct Segment {
    alignas(64) float across_re[kAcross], across_im[kAcross];  ///< 0 .. kSpectrumWaves
    float down_re[kDown], down_im[kDown];                      ///< -kSpectrumWaves .. kSpectrumWaves
    float half_across, half_down;                              ///< half the phase from end to end, by one wave
  };
  Segment segments[kPathInstants - 1];
};

/// The functions of one instruction set. Sums differ between instruction sets by rounding.
struct SpectrumSimd {
  const char* name;
  /// out[x] = row[x], at most `margin` above the second largest of its eight neighbours and as little below the second
  /// smallest; outside [0, width) pixels are replicated.
  void (*clip_outliers)(const std::uint8_t* above, const std::uint8_t* row, const std::uint8_t* below, int width,
                        int margin, std::uint8_t* out);
  /// Power [grey levels^2] at each frequency of a window: of white noise its variance.
  /// @param stride  between rows
  void (*power_spectrum)(const SpectrumTables& tables, const std::uint8_t* window, std::ptrdiff_t stride, float* power);
  /// model[f] = texture[f] * gain[bin], bin the nearest to |x * bins_x + y * bins_y|.
  void (*multiply_gain)(const float* texture, const float* gain, float bins_x, float bins_y, float* model);
  /// model[f] = texture[f] * (|H(f)|^2 + left), H of a path, smeared as the window does it: Hann's has a spectrum of
  /// 1/2, 1 and 1/2.
  void (*multiply_path_gain)(const float* texture, const PathPhases& path, float left, float* model);
  /// The least sum over the frequencies of 2 log(S + P) - log S over all factors a, S = a * model + 1: the negative log
  /// likelihood, but for a constant, where the power P is S times a factor with a log-logistic distribution.
  /// @param log_factor  of a: where the search begins; becomes where it ends
  double (*least_cost)(const float* power, const float* model, double* log_factor);
};

GYRO_DEBLUR_SIMD_KERNELS(SpectrumSimd)

/// The tables for power_spectrum(), made once.
const SpectrumTables& spectrum_tables();

}  // namespace gyro_deblur
