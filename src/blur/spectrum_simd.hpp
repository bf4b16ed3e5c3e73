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

/// Sectors of directions that the frequencies are divided into, and places for those of all sectors.
constexpr int kSpectrumSectors = 8;
constexpr int kSpectrumPlaces = 480;

/// The frequencies of a half plane, less the four lowest, which a window mixes with the mean. Place
/// i * kSpectrumSectors + k has the i-th one of sector k; the last of a sector may be empty.
struct SpectrumOrder {
  std::int32_t at[kSpectrumPlaces];                      ///< index in a spectrum; 0 where empty
  float across[kSpectrumPlaces], down[kSpectrumPlaces];  ///< waves a window
  float texture[kSpectrumPlaces];                        ///< |f|^-2.5 [waves a window]; 0 where empty
  float log_frequency[kSpectrumPlaces];                  ///< natural, less its mean; 0 where empty
};

/// How the texture of a window differs from |f|^-2.5: natural logarithms of factors.
struct TextureFit {
  double log_power = 0;                         ///< at all frequencies
  double exponent = 0;                          ///< of |f|, less -2.5
  double log_of_sector[kSpectrumSectors] = {};  ///< in each sector, besides
};

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
  /// Rounded means of 2 x 2 px.
  /// @param count  of means
  void (*halve)(const std::uint8_t* upper, const std::uint8_t* lower, int count, std::uint8_t* out);
  /// Power [grey levels^2] at each frequency of a window: of white noise its variance.
  /// @param stride  between rows
  void (*power_spectrum)(const SpectrumTables& tables, const std::uint8_t* window, std::ptrdiff_t stride, float* power);
  /// model = texture * gain[bin] at each place, bin the nearest to |across * bins_x + down * bins_y|.
  void (*multiply_gain)(const SpectrumOrder& order, const float* gain, float bins_x, float bins_y, float* model);
  /// model = texture * (|H|^2 + left) at each place, H of a path, smeared as the window does it: Hann's has a spectrum
  /// of 1/2, 1 and 1/2.
  void (*multiply_path_gain)(const SpectrumOrder& order, const PathPhases& path, float left, float* model);
  /// The cost of the best texture that a search of so many steps finds: the sum over the places of 2 log(S + P) - log
  /// S, S = fitted texture * model + 1, and what deviations of the texture cost. That is the negative log likelihood,
  /// but for a constant, where the power P is S times a factor with a log-logistic distribution, and the deviations are
  /// normally distributed.
  /// @param steps  of the search
  /// @param fit    where the search begins; becomes where it ends
  double (*least_cost)(const SpectrumOrder& order, const float* power, const float* model, int steps, TextureFit* fit);
};

GYRO_DEBLUR_SIMD_KERNELS(SpectrumSimd)

/// The tables for power_spectrum(), made once.
const SpectrumTables& spectrum_tables();

/// The places of the frequencies, made once.
const SpectrumOrder& spectrum_order();

}  // namespace gyro_deblur
