// The loop that validation spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// The functions of one instruction set: all of them give the same.
struct GradientSimd {
  const char* name;
  /// The largest |dx gx + dy gy| over a block, with the Sobel pair (gx, gy) in grey levels times 8.
  /// @param around  the pixel above and left of the block's first one: those around the block are read, too
  /// @param stride  between rows
  /// @param dx, dy  within +-2^20, the sum of their squares at most 2^40
  int (*strongest_gradient)(const std::uint8_t* around, std::ptrdiff_t stride, int width, int height, int dx, int dy);
};

GYRO_DEBLUR_SIMD_KERNELS(GradientSimd)

}  // namespace gyro_deblur
