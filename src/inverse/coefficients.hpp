// Filter coefficients as inner loops take them. Plain data: those loops are compiled apart (base/vectors_impl.hpp).
#pragma once

#include <cstdint>

namespace gyro_deblur {

/// Exact taps: at step `m` along the line the two neighbours across, with weights as a pair of int16.
struct PairTap {
  int m, n;              ///< input relative to the output
  std::int32_t weights;  ///< weight of n in the low half, of n + 1 in the high half
};

/// Largest size of a weight. int16 would hold eight times as much; with this, sums of 2000 taps at full brightness
/// still fit int32.
constexpr int kMaxPairWeight = 1 << 12;
constexpr int kMaxByteWeight = 127;  ///< where weights_are_bytes

struct ExactFilter {
  const PairTap* taps;
  int count;
  bool weights_are_bytes;  ///< at most kMaxByteWeight in size
  int radius_m;            ///< max |tap.m|
  int n_min, n_max;        ///< over taps
  float scale;             ///< grey levels in a sum of weights times pixels
};

constexpr int kCoarseGuard = 3;  ///< zeros on either side of TwoScaleFilter::coarse

/// Two scales (see TwoScaleWeights), or the taps themselves on the sheared columns of two scales. Applies to
/// correlation order: output(m) = sum weight[k] input(m + k).
struct TwoScaleFilter {
  int box_half;                ///< samples of the inner box on either side of the output
  float inner_box, outer_box;  ///< weights of the two boxes
  const float* coarse;         ///< 2 coarse_radius + 1 weights of sums over `decimation` samples
  int coarse_radius;
  int decimation;  ///< >= 1; 1: every sample is a node, and the boxes are next to nothing
  /// The weights w of `coarse` in fixed point with coarse_shift bits, for 8-bit pixels, as pairs of int16 with the
  /// lower index in the low half: coarse_even[i] is w[2 i], w[2 i + 1] and coarse_odd[i] is w[2 i - 1], w[2 i], with
  /// zeros beyond the ends; i from -1 to coarse_radius + 1. Their sum is coarse_sum.
  const std::int32_t *coarse_even = nullptr, *coarse_odd = nullptr;
  int coarse_shift = 0;
  std::int32_t coarse_sum = 0;
};

}  // namespace gyro_deblur
