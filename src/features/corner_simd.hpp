// The loops that the search for corners spends its time in: one interface, compiled once per instruction set.
#pragma once

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Floats that may be read and written before and beyond a row of `width`.
constexpr int kCornerRoom = 32;

/// Rows of three products of gradients: xx, xy, yy.
struct GradientProducts {
  float *xx, *xy, *yy;
};

/// The functions of one instruction set.
struct CornerSimd {
  const char* name;
  /// half[x] = mean of two pixels of each row, for x < width; rows have 2 * width bytes.
  void (*downsample2x)(const unsigned char* upper, const unsigned char* lower, float* half, int width);
  /// Products of central differences, from three rows.
  void (*multiply)(const float* above, const float* middle, const float* below, GradientProducts products, int width);
  /// Determinant over trace of the products' sums over 3 x 3 pixels: between half the smaller eigenvalue and all of it
  /// (W. Foerstner, E. Guelch, ISPRS 1987). 0 where there is no gradient.
  void (*rate)(const GradientProducts* rows, float* strengths, int width);
  /// Columns x, first_x <= x < last_x, that are stronger than all eight neighbours. Of equal neighbours the first
  /// counts.
  /// @param columns  room for last_x - first_x
  /// @return how many
  int (*find_peaks)(const float* above, const float* middle, const float* below, int first_x, int last_x, int* columns);
};

GYRO_DEBLUR_SIMD_KERNELS(CornerSimd)

}  // namespace gyro_deblur
