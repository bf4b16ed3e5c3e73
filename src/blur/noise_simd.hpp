// The loops that the estimate of noise spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstdint>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Side of a square whose noise is measured [px], and how far the filter reaches beyond it.
constexpr int kNoiseSquarePx = 8, kNoiseReachPx = 2;
/// Rows of a band of squares.
constexpr int kNoiseBandRows = kNoiseSquarePx + 2 * kNoiseReachPx;

/// Added to a sample that is black, saturated or masked; makes the mean of any others negative.
constexpr float kNoiseClipped = -1e4;

/// Sums down a band, by column: each has as many values as the band has columns.
struct NoiseSums {
  float* power;           ///< squares of the filter's result, from column kNoiseReachPx on
  float *first, *second;  ///< of means of 2 x 2 px (column x and the next one), and their squares
  float* clipped;         ///< how many values are negative
};

/// The functions of one instruction set.
struct NoiseSimd {
  const char* name;
  /// Adds `count` samples, `stride` of the image's values apart, times `scale`; and kNoiseClipped to those that are 0,
  /// or `full_scale` or more.
  void (*add_samples8)(const std::uint8_t* from, int stride, int count, float scale, int full_scale, float* to);
  void (*add_samples16)(const std::uint16_t* from, int stride, int count, float scale, int full_scale, float* to);
  /// Sums of a band of kNoiseBandRows rows. The filter is 1, -4, 6, -4, 1 along both axes.
  /// @param cols  > 2 kNoiseReachPx; each row has as many values
  /// @param down  room for a row
  void (*sum_band)(const float* const* rows, int cols, float* down, NoiseSums sums);
};

GYRO_DEBLUR_SIMD_KERNELS(NoiseSimd)

}  // namespace gyro_deblur
