// The loop that validation spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstdint>

namespace gyro_deblur {

/// The functions of one instruction set: all of them give the same.
struct GradientLoops {
  const char* name;
  /// The largest |dx gx + dy gy| over a block, with the Sobel pair (gx, gy) in grey levels times 8.
  /// @param padded  the block and one pixel around it, height + 2 rows of width + 2 elements in [0, 255]
  /// @param dx, dy  within +-2^20, the sum of their squares at most 2^40
  int (*strongest_gradient)(const std::int16_t* padded, int width, int height, int dx, int dy);
};

namespace baseline {
extern const GradientLoops kGradientLoops;
}
#if defined(__x86_64__)
namespace avx2 {
extern const GradientLoops kGradientLoops;
}
namespace avx512 {
extern const GradientLoops kGradientLoops;
}
#endif

/// The widest set this processor runs.
const GradientLoops& best_gradient_loops();

/// A set by name ("baseline", "avx2", "avx512"), or null when this processor or build does not have it.
const GradientLoops* find_gradient_loops(const char* name);

}  // namespace gyro_deblur
