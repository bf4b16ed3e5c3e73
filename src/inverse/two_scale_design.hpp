// How a kernel with a box in it is split into two scales, found by least squares once per length
// (doc/design/two_scale_filter.md).
#pragma once

#include <utility>
#include <vector>

#include "base/once_map.hpp"
#include "inverse/tap_simd.hpp"

namespace gyro_deblur {

/// Weights of the two scales that stand for a kernel of unit steps, symmetric about 0.
///
/// Samples x[m] are summed over nodes of `decimation` samples; the sums are filtered with coarse weights, and the
/// result between nodes is a quadratic B-spline. Two boxes, over [-box_half, box_half] and one sample more on either
/// side, carry the jumps that the coarse part cannot follow.
struct TwoScaleWeights {
  float inner_box, outer_box;
  std::vector<float> coarse;  ///< of nodes 0 .. radius; node -k has the weight of node k
};

/// The linear map from a kernel to its weights, for all kernels that jump at about the same place.
class TwoScaleDesign {
 public:
  /// @param box_half  samples of the inner box on either side of its centre, >= 0
  /// @param radius    coarse weights on either side of the centre; radius * decimation > box_half
  TwoScaleDesign(int box_half, int radius);

  /// Samples in a node: a fifteenth of the box.
  static int decimation_for(int box_half);

  int reach() const { return radius_ * decimation_; }  ///< taps beyond are not seen

  /// Weights that come nearest to the kernel, with its sum kept exactly.
  /// @param kernel  taps 0 .. count, count <= reach()
  void fit(const float* kernel, int count, const TapSimd& simd, TwoScaleWeights& weights) const;

 private:
  int box_half_, decimation_, radius_;
  // Rows are coarse weights, inner and outer box; a column for each tap. See TapSimd::combine_columns.
  int row_groups_;
  std::vector<float> map_;
};

/// What a design is made for: box_half and radius.
using TwoScaleShape = std::pair<int, int>;

/// Designs by shape, made on first use (a tenth of a millisecond each, up to 130 KiB) and kept.
using TwoScaleDesigns = OnceMap<TwoScaleShape, TwoScaleDesign>;

}  // namespace gyro_deblur
