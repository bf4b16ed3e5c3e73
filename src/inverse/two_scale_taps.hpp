// A kernel with a box in it as weights of two scales.
#pragma once

#include <cstdint>
#include <set>
#include <vector>

#include "inverse/coefficients.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/tap_simd.hpp"
#include "inverse/two_scale_design.hpp"

namespace gyro_deblur {

/// The two scales of a block, and the room that making them takes.
struct TwoScaleTaps {
  TwoScaleFilter filter{};  ///< points into `coarse` and `pairs`
  std::vector<float> coarse;
  std::vector<std::int32_t> pairs;
  TwoScaleWeights weights;
  std::vector<float> on_axis;
  std::vector<std::int32_t> fixed;
  std::vector<double> running;
};

/// @param kernel       with a box: box_extent_px > 0
/// @param major        see kernel_on_major_axis()
/// @param fixed_point  also weights in fixed point, for 8-bit pixels
void make_two_scale_taps(const LineKernel& kernel, double major, bool fixed_point, const TapSimd& simd,
                         TwoScaleDesigns& designs, TwoScaleTaps& taps);

/// Adds the shapes of all designs that make_two_scale_taps() takes for this kernel, whatever the line's angle.
void add_two_scale_shapes(const LineKernel& kernel, std::set<TwoScaleShape>& shapes);

/// A kernel of any shape on the sheared columns of two scales, tap by tap: more work than two scales, less than exact
/// taps.
/// @param major        see kernel_on_major_axis()
/// @param fixed_point  also weights in fixed point, for 8-bit pixels
void make_sheared_taps(const LineKernel& kernel, double major, bool fixed_point, TwoScaleTaps& taps);

}  // namespace gyro_deblur
