// A kernel along a line as fixed-point weights of pixels.
#pragma once

#include <vector>

#include "inverse/coefficients.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur {

/// The exact taps of a block, and the room that making them takes.
struct ExactTaps {
  ExactFilter filter{};  ///< points into `pairs`
  std::vector<PairTap> pairs;
  LineSteps line;
};

/// make_line_steps()'s taps in fixed point.
/// @param byte_weights  the engine takes weights in bytes; they are used where that does no harm
void make_exact_taps(const LineKernel& kernel, const LineDirection& direction, bool byte_weights, ExactTaps& exact);

}  // namespace gyro_deblur
