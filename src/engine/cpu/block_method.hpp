// Which method the CPU engine filters a block with: exact taps where they are few, sheared columns where the kernel is
// long, and the float engine for what is left. On sheared columns a kernel whose shape is known has two scales
// (TwoScaleWeights), and any other one its taps.
#pragma once

#include <string>

#include "inverse/filter_bank.hpp"

namespace gyro_deblur {

/// Why a block is left to the float engine, for diagnostics; empty where a fast method serves.
/// @param slope  of the line along its major axis, [-1, 1]
/// @param depth  CV_8U or CV_16U
std::string fallback_reason(const LineKernel& kernel, double slope, int depth);

/// Where a fast method serves: whether it is sheared columns rather than exact taps.
bool takes_sheared_columns(const LineKernel& kernel, double slope, int depth);

/// Whether a kernel on sheared columns has two scales rather than its taps.
bool takes_two_scales(const LineKernel& kernel);

/// Rows along the major axis that one tile may have on sheared columns, at most kMaxTileSide.
int max_sheared_rows(const LineKernel& kernel, double slope);

}  // namespace gyro_deblur
