#include "engine/cpu/block_method.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>

#include "engine/cpu/block_simd.hpp"

namespace gyro_deblur {
namespace {

// Exact taps are cheap below this, and further down the interpolation between sheared columns and pixels shows: on
// single photographs 0.12 dB of restored quality at 34 px and 7 degrees, 0.08 dB at most from here on.
constexpr int kMinTwoScaleExtentPx = 36;
static_assert(kMinTwoScaleExtentPx >= kConstantRatioExtentPx, "shorter kernels have no jump to take out");
// Nearly along an axis the sheared columns lie between pixels over whole stretches of a line, where exact taps do not,
// and the interpolation shows up to longer extents.
constexpr double kMinTwoScaleExtentNearAxisPx = 57.0;
constexpr double kNearAxisSlope = 0.15;
// Still nearer to an axis and, where two scales are smooth, up to this extent, tiles are cut so short that sheared
// columns drift by no more than this between the middle row, where they lie on pixels, and the ends; 0.10 dB are lost
// at 58 px and 2 degrees without. But not shorter than this many rows: the neighbourhood that the kernel needs comes on
// top for every tile.
constexpr double kMaxShortTileExtentPx = 75.0;
constexpr double kMaxShortTileSlope = 0.08;

// From here to kNearAxisSlope short kernels without a box come to below 42 dB on sheared columns (41.6 dB at 50 px and
// 4 degrees).
constexpr double kMinDeepNonuniformSlope = 0.06;
constexpr double kMaxColumnDriftPx = 0.2;
constexpr int kMinTileRows = 9;
// Box and smooth rest cancel each other from this gain (1 / gamma) down to one, so that their errors grow with it: 0.7
// grey levels at gamma = 0.01, 2 at 0.005, 38 at 0.001. Kernels of a smaller gamma are left to the float engine.
constexpr double kMaxBoxGain = 128.0;
// Exact taps of longer kernels would need a neighbourhood beyond any cache.
constexpr int kMaxExactRadius = 128;

// Sheared columns have sums of weights times pixels in 32 bits, so that weights are the coarser the larger their sizes'
// sum: at this one 9 bits are left to them.
constexpr double kMaxColumnGain = 80.0;
// Extents that a kernel of unknown shape has in its length, as by default.
constexpr double kLengthInExtents = 4.0;

bool exact_is_possible(const LineKernel& kernel, int depth) {
  return depth == CV_8U && kernel.radius() <= kMaxExactRadius;
}

bool has_box(const LineKernel& kernel) { return kernel.box_extent_px > 0; }

/// Of the blur [px].
double extent_of(const LineKernel& kernel) {
  return has_box(kernel) ? kernel.box_extent_px : 2 * kernel.radius() / kLengthInExtents;
}

/// Whether what sheared columns interpolate shows: near an axis, where tiles would have to be shorter than is worth it,
/// the peaks of a kernel without a box fall between pixels together for a whole tile. Without short tiles 39.3 dB to
/// the float engine were seen at 50 px and 5 degrees; with those of 5 rows, 43.8 dB, 16 bit take longer than in the
/// float engine.
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

std::string in_words(FallbackReason reason) {
  const std::string too_short = "blur below " + std::to_string(kMinTwoScaleExtentPx) + " px";
  switch (reason) {
    case FallbackReason::ZERO_KERNEL:
      return "a kernel of zeros";
    case FallbackReason::SMALL_GAMMA:
      return "gamma too small for the fast methods";
    case FallbackReason::DEEP_SHORT_BLUR:
      return "16 bit and " + too_short;
    case FallbackReason::DEEP_NONUNIFORM_BLUR:
      return "16 bit and blur at non-uniform speed below " +
             std::to_string(static_cast<int>(kMinTwoScaleExtentNearAxisPx)) + " px near an axis";
    case FallbackReason::LONG_SHORT_BLUR:
      return "more than " + std::to_string(2 * kMaxExactRadius + 1) + " taps for " + too_short;
  }
  return "";
}

std::optional<FallbackReason> fallback_reason(const LineKernel& kernel, double slope, int depth) {
  const bool is_zero = std::all_of(kernel.taps.begin(), kernel.taps.end(), [](float tap) { return tap == 0; });
  if (is_zero) return FallbackReason::ZERO_KERNEL;
  if (has_box(kernel) && !gain_is_small(kernel)) return FallbackReason::SMALL_GAMMA;
  if (exact_is_possible(kernel, depth)) return std::nullopt;
  if (extent_of(kernel) < kMinTwoScaleExtentPx) {
    return depth == CV_8U ? FallbackReason::LONG_SHORT_BLUR : FallbackReason::DEEP_SHORT_BLUR;
  }
  if (depth == CV_16U && peaks_show(kernel, slope)) return FallbackReason::DEEP_NONUNIFORM_BLUR;
  return gain_is_small(kernel) ? std::nullopt : std::optional(FallbackReason::SMALL_GAMMA);
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
