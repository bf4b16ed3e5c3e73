// The loops that make the gain of a path's inverse: one interface, compiled once per instruction set.
#pragma once

#include "base/instruction_sets.hpp"
#include "blur/path_1d.hpp"

namespace gyro_deblur {

/// Between the places of a path.
constexpr int kPathSegments = kPathInstants - 1;

/// Phases at a frequency f along one axis, for segments from p to q: exp(-pi i f (p + q)), that of the middle, of all
/// segments, and then exp(pi i f (q - p)) of all.
constexpr int kPhases = 2 * kPathSegments;
/// Real parts, then imaginary parts.
constexpr int kPhaseFloats = 2 * kPhases;

/// What the gain is made from; frequencies in cycles in a tile.
struct WienerGain2dTables {
  int cols;                           ///< of the tile [px]
  const int* places;                  ///< where frequency u (0 .. cols - 1) across belongs
  const float* across;                ///< phases of u = 0 .. cols / 2 - 1, frequency by frequency
  const float* down;                  ///< the same of v = 0, 1 .., aligned to 16 bytes
  float slope_across[kPathSegments];  ///< pi f (q - p) of segments [rad], by u
  float slope_down[kPathSegments];    ///< and by v
  float noise_to_signal;
  float noise_rise_across, noise_rise_down;  ///< by u^2 and v^2
  const float *band_across, *band_down;      ///< further factors of the gain, by |u| and v
  const float *again_across, *again_down;    ///< and of the gain with the blur after it
};

/// The functions of one instruction set.
struct WienerGain2dSimd {
  const char* name;
  /// Phases of `count` frequencies 0, 1 ..
  /// @param steps  phases of frequencies 1, 2, 4 .. below `count`
  void (*grow_phases)(const float* steps, int count, float* phases);
  /// See WienerGain2d::rows; takes as many rows as the vectors of this set have floats.
  void (*gain_of_rows)(const WienerGain2dTables& tables, int first_row, float* gain, float* again);
};

GYRO_DEBLUR_SIMD_KERNELS(WienerGain2dSimd)

}  // namespace gyro_deblur
