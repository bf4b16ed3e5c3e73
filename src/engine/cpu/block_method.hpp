// Which method the CPU engine filters a block with: exact taps where they are few, two scales (TwoScaleWeights) where
// the kernel is long and its shape is known, and the float engine for what is left.
#pragma once

#include <optional>
#include <string>

#include "gyro_deblur/kernel_bank.hpp"

namespace gyro_deblur {

/// Why a block is left to the float engine.
enum class SlowReason {
  ZERO_KERNEL,       ///< nothing to scale fixed-point weights by
  SMALL_GAMMA,       ///< box and smooth rest cancel each other too well
  DEEP_SHORT_BLUR,   ///< exact taps are for 8 bit, and the blur is too short for two scales
  DEEP_WITHOUT_BOX,  ///< exact taps are for 8 bit, and two scales need a box
  LONG_SHORT_BLUR,   ///< too many taps, and the blur is too short for two scales
  LONG_WITHOUT_BOX   ///< too many taps, and two scales need a box
};
constexpr int kSlowReasons = 6;

/// In words, for diagnostics.
std::string in_words(SlowReason reason);

/// Nothing where a fast method serves.
/// @param depth  CV_8U or CV_16U
std::optional<SlowReason> slow_reason(const LineKernel& kernel, int depth);

/// Where a fast method serves: whether it is two scales rather than exact taps.
/// @param slope  of the line along its major axis, [-1, 1]
bool takes_two_scales(const LineKernel& kernel, double slope, int depth);

/// Rows along the major axis that one tile may have on two scales, at most kMaxTileSide.
int max_two_scale_rows(const LineKernel& kernel, double slope);

}  // namespace gyro_deblur
