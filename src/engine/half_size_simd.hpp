// The loops that make an image of half the size, and back: one interface, compiled once per instruction set.
#pragma once

#include <cstdint>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Taps of the low pass before both: symmetric and equiripple (T. W. Parks and J. H. McClellan, IEEE Trans. Circuit
/// Theory 19 (2), 1972), by scipy.signal.remez(8, [0, .19, .31, .5], [1, 0], weight=[1, 10]). Every second tap sums to
/// half, so that neither parity of pixels is brighter.
constexpr float kHalvingTaps[] = {-0.0388f, -0.0084f, 0.1709f, 0.3763f, 0.3763f, 0.1709f, -0.0084f, -0.0388f};
constexpr int kHalvingTapCount = 8;

/// Pixels before an output of the low pass, and behind it, in addition to the two that it lies between.
constexpr int kHalvingReach = kHalvingTapCount / 2 - 1;

/// Pixels of the half on either side of its own, x, from which two are made: x - 2 to x + 1 for the even place, x - 1
/// to x + 2 for the odd one.
constexpr int kDoublingReach = 2;

/// The functions of one instruction set.
struct HalfSizeSimd {
  const char* name;
  /// The low pass down: kHalvingTapCount rows to one of `width` values.
  void (*lowpass_bytes)(const std::uint8_t* const* rows, int width, float* to);
  void (*lowpass_words)(const std::uint16_t* const* rows, int width, float* to);
  /// The low pass across and every second value: `count` of them, from from[-kHalvingReach] to
  /// from[2 * count + kHalvingReach - 1].
  void (*decimate)(const float* from, int count, float* to);
  /// `width` values of a row between those of the half. rows: the half's, the nearest first.
  void (*interpolate_down)(const float* const* rows, int width, float* to);
  /// 2 `count` values, from from[-kDoublingReach] to from[count + kDoublingReach - 1].
  void (*interpolate_across)(const float* from, int count, float* to);
};

GYRO_DEBLUR_SIMD_KERNELS(HalfSizeSimd)

}  // namespace gyro_deblur
