// The loop that validation spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

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

namespace baseline {
extern const GradientSimd kGradientSimd;
}
#if defined(__x86_64__)
namespace avx2 {
extern const GradientSimd kGradientSimd;
}
namespace avx512 {
extern const GradientSimd kGradientSimd;
}
#endif

/// The widest set this processor runs.
const GradientSimd& best_gradient_simd();

/// A set by name ("baseline", "avx2", "avx512"), or null when this processor or build does not have it.
const GradientSimd* find_gradient_simd(const char* name);

}  // namespace gyro_deblur
