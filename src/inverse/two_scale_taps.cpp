#include "inverse/two_scale_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>

#include "inverse/fixed_point.hpp"

namespace gyro_deblur {
namespace {

// Rounding errors are passed on to the next weight inwards: their sum over neighbours, which is what a blurred image
// sees, stays below one unit.
void fix_coarse_weights(TwoScaleTaps& taps) {
  TwoScaleFilter& filter = taps.filter;
  const int radius = filter.coarse_radius;
  const std::vector<float>& weights = taps.weights.coarse;
  double size = 0, largest = 0;
  for (int k = 0; k <= radius; ++k) {
    size += (k == 0 ? 1 : 2) * std::abs(weights[k]);
    largest = std::max<double>(largest, std::abs(weights[k]));
  }
  // Sums of nodes are below 2^15 in size, results below 2^31, and weights below 2^15 even with a neighbour's error.
  constexpr int kMaxShift = 14;
  filter.coarse_shift = kMaxShift;
  while (filter.coarse_shift > 0 &&
         (size * (1 << filter.coarse_shift) > 65000.0 || largest * (1 << filter.coarse_shift) > 32000.0)) {
    --filter.coarse_shift;
  }

  taps.fixed.assign(2 * radius + 1 + 8, 0);
  std::int32_t* fixed = taps.fixed.data() + radius + 4;  // of node k at [k]
  const double unit = 1 << filter.coarse_shift;
  double error = 0, wanted = 0;
  for (int k = radius; k >= 0; --k) {
    const double exact = weights[k] * unit;
    fixed[k] = fixed[-k] = round_to_int(exact + (k == 0 ? 2 : 1) * error);
    error += exact - fixed[k];
    wanted += (k == 0 ? 1 : 2) * exact;
  }
  filter.coarse_sum = std::accumulate(taps.fixed.begin(), taps.fixed.end(), 0);
  // What is left of the sum decides the brightness.
  filter.inner_box +=
      static_cast<float>((wanted - filter.coarse_sum) / unit * filter.decimation / (2 * filter.box_half + 1));

  const int pairs = radius + 3;  // from pair -1
  taps.pairs.resize(2 * pairs);
  std::int32_t* even = taps.pairs.data() + 1;
  std::int32_t* odd = even + pairs;
  for (int i = -1; i <= radius + 1; ++i) {
    const std::int32_t* at = fixed - radius + 2 * i;
    even[i] = pack_int16(at[0], at[1]);
    odd[i] = pack_int16(at[-1], at[0]);
  }
  filter.coarse_even = even;
  filter.coarse_odd = odd;
}

}  // namespace

// The kernel along the major axis jumps at the ends of its box and is smooth elsewhere: two boxes carry the jumps, and
// few coarse weights the rest.
void make_two_scale_taps(const LineKernel& kernel, double major, bool fixed_point, const TapLoops& loops,
                         TwoScaleDesigns& designs, TwoScaleTaps& taps) {
  const double stretch = std::abs(major);  // steps of the major axis in one pixel of the line
  // A box that covers the samples -b .. b ends at b + 1 / 2: the box's end lies between those of the two boxes.
  const int box_half = static_cast<int>(std::floor((kernel.box_extent_px * stretch - 1) / 2));
  const int d = TwoScaleDesign::decimation_for(box_half);
  const int steps = static_cast<int>(std::ceil(kernel.radius() * stretch)), radius = (steps + d - 1) / d;
  const TwoScaleDesign& design = designs.get(box_half, radius);

  taps.on_axis.resize(steps + kRowGroup);
  loops.resample_kernel(kernel.taps.data() + kernel.radius(), kernel.radius(), stretch, steps, taps.on_axis.data());
  design.fit(taps.on_axis.data(), steps, loops, taps.weights);
  taps.coarse.assign(2 * radius + 1 + 2 * kCoarseGuard, 0.0f);
  float* middle = taps.coarse.data() + kCoarseGuard + radius;
  for (int k = 0; k <= radius; ++k) middle[k] = middle[-k] = taps.weights.coarse[k];

  taps.filter = {};
  TwoScaleFilter& filter = taps.filter;
  filter.box_half = box_half;
  filter.inner_box = taps.weights.inner_box;
  filter.outer_box = taps.weights.outer_box;
  filter.coarse = taps.coarse.data() + kCoarseGuard;
  filter.coarse_radius = radius;
  filter.decimation = d;
  if (fixed_point) fix_coarse_weights(taps);
}

}  // namespace gyro_deblur
