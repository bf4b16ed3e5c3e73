// The loop that makes the gain of a path's inverse: one interface, compiled once per instruction set.
#pragma once

#include "base/instruction_sets.hpp"
#include "blur/path_1d.hpp"

namespace gyro_deblur {

/// Floats of the phases of a path's places at one frequency: real parts, imaginary parts.
constexpr int kPhaseFloats = 2 * kPathInstants;

/// What the gain is made from; frequencies in cycles in a tile.
struct WienerGain2dTables {
  int cols;                               ///< of the tile [px]
  const int* places;                      ///< where frequency u (0 .. cols - 1) across belongs
  const float* across;                    ///< phases exp(-2 pi i u x) of the places' x, for u from -cols / 2 on
  const float* down;                      ///< the same of y, for v from 0 to half the rows, less 1
  float slope_across[kPathInstants - 1];  ///< half the phase between two places, by u
  float slope_down[kPathInstants - 1];    ///< and by v
  float noise_to_signal;
  float noise_rise_across, noise_rise_down;  ///< by u^2 and v^2
  const float *band_across, *band_down;      ///< further factors of the gain, by |u| and v
};

/// The functions of one instruction set.
struct WienerGain2dSimd {
  const char* name;
  /// See WienerGain2d; takes as many rows as the vectors of this set have floats.
  void (*gain_of_rows)(const WienerGain2dTables& tables, int first_row, bool blurs_again, float* gain);
};

GYRO_DEBLUR_SIMD_KERNELS(WienerGain2dSimd)

}  // namespace gyro_deblur
