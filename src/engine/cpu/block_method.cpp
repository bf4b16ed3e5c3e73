// Chooses the method for a block by its extent, slope and pixel depth.
#include "engine/cpu/block_method.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>

#include "engine/cpu/block_simd.hpp"

namespace gyro_deblur {
namespace {

// Below this extent exact taps are cheap, and the interpolation between sheared columns and pixels would show (figures
// for this and the next constants: doc/reports/filter_constants.md).
constexpr int kMinTwoScaleExtentPx = 36;
static_assert(kMinTwoScaleExtentPx >= kConstantRatioExtentPx, "shorter kernels have no jump to take out");
// Nearly along an axis the sheared columns lie between pixels over whole stretches of a line, where exact taps do not,
// and the interpolation shows up to longer extents.
constexpr double kMinTwoScaleExtentNearAxisPx = 57.0;
constexpr double kNearAxisSlope = 0.15;
// Still nearer to an axis and, where two scales are smooth, up to this extent, tiles are cut so short that sheared
// columns drift by at most kMaxColumnDriftPx between the middle row, where they lie on pixels, and the ends, but not
// shorter than kMinTileRows: the neighbourhood that the kernel needs comes on top for every tile.
constexpr double kMaxShortTileExtentPx = 75.0;
constexpr double kMaxShortTileSlope = 0.08;

// From here to kNearAxisSlope short kernels without a box differ visibly from the float engine on sheared columns.
constexpr double kMinDeepNonuniformSlope = 0.06;
constexpr double kMaxColumnDriftPx = 0.2;
constexpr int kMinTileRows = 9;
// Box and smooth rest cancel each other from this gain (1 / noise-to-signal ratio) down to one, so that their errors
// grow with it. The float engine filters with kernels of a smaller ratio.
constexpr double kMaxBoxGain = 128.0;
// Exact taps of longer kernels would need a neighbourhood beyond any cache.
constexpr int kMaxExactRadius = 128;

// Sums over sheared columns have 32 bits: the larger the sum of absolute weights, the coarser is each. This limit keeps
// 9 bits for a weight.
constexpr double kMaxColumnGain = 80.0;
// Extents that a kernel of unknown shape has in its length, as by default.
constexpr double kLengthInExtents = 4.0;

bool exact_is_possible(const LineKernel& kernel, int depth) {
  return depth == CV_8U && kernel.radius() <= kMaxExactRadius;
}

bool has_box(const LineKernel& kernel) { return kernel.box_extent_px > 0; }

/// Extent of the kernel's blur [px].
double extent_of(const LineKernel& kernel) {
  return has_box(kernel) ? kernel.box_extent_px : 2 * kernel.radius() / kLengthInExtents;
}

/// Whether what sheared columns interpolate shows: near an axis, where tiles would have to be shorter than is worth it,
/// the peaks of a kernel without a box fall between pixels together for a whole tile.
bool peaks_show(const LineKernel& kernel, double slope) {
  return !has_box(kernel) && std::abs(slope) > kMinDeepNonuniformSlope && std::abs(slope) < kNearAxisSlope &&
         extent_of(kernel) < kMinTwoScaleExtentNearAxisPx;
}

/// Whether box and smooth rest, or the taps of a kernel without a box, have room in what the sheared columns compute
/// with.
bool gain_is_small(const LineKernel& kernel) {
  if (has_box(kernel)) return kernel.box_height * kernel.box_extent_px <= kMaxBoxGain;
  double gain = 0;
  for (const float tap : kernel.taps) gain += std::abs(tap);
  return gain <= kMaxColumnGain;
}

}  // namespace

std::string fallback_reason(const LineKernel& kernel, double slope, int depth) {
  const auto is_none = [](float tap) { return tap == 0; };
  // The middle first: it is hardly ever 0, and the others need not be in a cache.
  const bool is_zero =
      is_none(kernel.taps[kernel.radius()]) && std::all_of(kernel.taps.begin(), kernel.taps.end(), is_none);
  if (is_zero) return "a kernel of zeros";  // nothing to scale fixed-point weights by
  // Weights are so large that they cancel each other too well.
  const char* small_ratio = "noise-to-signal ratio too small for the fast methods";
  if (has_box(kernel) && !gain_is_small(kernel)) return small_ratio;
  if (exact_is_possible(kernel, depth)) return {};
  if (extent_of(kernel) < kMinTwoScaleExtentPx) {
    const std::string too_many = "more than " + std::to_string(2 * kMaxExactRadius + 1) + " taps for ";
    return (depth == CV_8U ? too_many : "16 bit and ") + "blur below " + std::to_string(kMinTwoScaleExtentPx) + " px";
  }
  if (depth == CV_16U && peaks_show(kernel, slope)) {
    return "16 bit and blur at non-uniform speed below " +
           std::to_string(static_cast<int>(kMinTwoScaleExtentNearAxisPx)) + " px near an axis";
  }
  return gain_is_small(kernel) ? "" : small_ratio;
}

bool takes_sheared_columns(const LineKernel& kernel, double slope, int depth) {
  const bool exact = exact_is_possible(kernel, depth);
  const bool near_axis = std::abs(slope) < kNearAxisSlope && exact;
  if (extent_of(kernel) < (near_axis ? kMinTwoScaleExtentNearAxisPx : kMinTwoScaleExtentPx)) return false;
  return !exact || gain_is_small(kernel);
}

bool takes_two_scales(const LineKernel& kernel) {
  return kernel.box_extent_px >= kMinTwoScaleExtentPx && gain_is_small(kernel);
}

int max_sheared_rows(const LineKernel& kernel, double slope) {
  const double steepness = std::abs(slope);
  if (steepness > kMaxShortTileSlope) return kMaxTileSide;
  if (has_box(kernel) && kernel.box_extent_px > kMaxShortTileExtentPx) return kMaxTileSide;
  // Also where the slope is 0.
  if (steepness * kMaxTileSide <= 2 * kMaxColumnDriftPx) return kMaxTileSide;
  return std::max(static_cast<int>(2 * kMaxColumnDriftPx / steepness), kMinTileRows);
}

}  // namespace gyro_deblur
