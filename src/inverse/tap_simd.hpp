// The loops that make weights: one interface, compiled once per instruction set (see tap_simd_impl.hpp).
#pragma once

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Rows of a matrix that combine_columns takes at a time: floats in the widest vector.
constexpr int kRowGroup = 16;

/// Room that solve_toeplitz takes behind each of its vectors.
constexpr int kToeplitzRoom = 16;

/// The functions of one instruction set.
struct TapSimd {
  const char* name;
  /// What kernel_on_major_axis() gives for steps 0 .. steps of a symmetric kernel, 2 radius + 1 taps around taps[0],
  /// whose taps are `step` apart in [0.7, 1]. Writes whole groups of kRowGroup.
  void (*resample_kernel)(const float* taps, int radius, double step, int steps, float* on_axis);
  /// sums[i] = sum of factors[m] * columns[m * kRowGroup + i] over m < count, for i < kRowGroup.
  void (*combine_columns)(const float* columns, const float* factors, int count, float* sums);
  /// Solves T x = y for two right sides by Levinson's recursion: O(n^2) of time, O(n) of memory. T_ij = r(|i - j|) is
  /// positive definite, with r(i) = 0 from i = `band` on, 1 <= band <= n.
  /// @param lags    r(band - 1) .. r(0)
  /// @param sides   the sides, n elements and then n
  /// @param work    5 (n + kToeplitzRoom) + band elements
  /// @param solved  as `sides`
  void (*solve_toeplitz)(const double* lags, int band, int n, const double* sides, double* work, double* solved);
};

GYRO_DEBLUR_SIMD_KERNELS(TapSimd)

}  // namespace gyro_deblur
