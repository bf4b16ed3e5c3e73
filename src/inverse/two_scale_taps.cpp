// Makes the weights of two scales of a kernel.
#include "inverse/two_scale_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>

#include "inverse/fixed_point.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur {
namespace {

// Rounding errors are passed on to the next weight inwards: their sum over neighbours, which is what a blurred image
// sees, stays below one unit on either side.
void fix_coarse_weights(TwoScaleTaps& taps) {
  TwoScaleFilter& filter = taps.filter;
  const int radius = filter.coarse_radius;
  const float* weights = filter.coarse + radius;  // of node k at [k]
  double size = 0, largest = 0;
  for (int k = 0; k <= radius; ++k) {
    size += std::abs(weights[k]) + (k == 0 ? 0 : std::abs(weights[-k]));
    largest = std::max<double>({largest, std::abs(weights[k]), std::abs(weights[-k])});
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
  double error_before = 0, error_after = 0, wanted = 0;
  for (int k = radius; k > 0; --k) {
    const double before = weights[-k] * unit, after = weights[k] * unit;
    fixed[-k] = round_with_error(before, error_before);
    fixed[k] = round_with_error(after, error_after);
    wanted += before + after;
  }
  const double middle = weights[0] * unit;
  error_before += error_after;
  fixed[0] = round_with_error(middle, error_before);
  wanted += middle;
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

/// Samples on either side of the inner box where the line's major axis has `stretch` steps a pixel. A box that covers
/// the samples -b .. b ends at b + 1 / 2: the kernel's ends between those of the two boxes.
int box_half_of(const LineKernel& kernel, double stretch) {
  return static_cast<int>(std::floor((kernel.box_extent_px * stretch - 1) / 2));
}

int steps_of(const LineKernel& kernel, double stretch) {
  return static_cast<int>(std::ceil(kernel.radius() * stretch));
}

/// Coarse weights on either side that cover so many steps.
int coarse_radius_of(int steps, int decimation) { return (steps + decimation - 1) / decimation; }

}  // namespace

void add_two_scale_shapes(const LineKernel& kernel, std::set<TwoScaleShape>& shapes) {
  const double least = std::sqrt(0.5);  // at 45 degrees
  constexpr double kBelow = 1 - 1e-9;
  for (int box_half = box_half_of(kernel, least); box_half <= box_half_of(kernel, 1); ++box_half) {
    const int d = TwoScaleDesign::decimation_for(box_half);
    const double from = std::max(least, (2 * box_half + 1) / kernel.box_extent_px);
    const double to = std::min(1.0, (2 * box_half + 3) / kernel.box_extent_px * kBelow);
    const int last = coarse_radius_of(steps_of(kernel, to), d);
    for (int radius = coarse_radius_of(steps_of(kernel, from), d); radius <= last; ++radius) {
      shapes.insert({box_half, radius});
    }
  }
}

// The kernel along the major axis jumps at the ends of its box and is smooth elsewhere: two boxes carry the jumps, and
// few coarse weights the rest.
void make_two_scale_taps(const LineKernel& kernel, double major, bool fixed_point, const TapSimd& simd,
                         TwoScaleDesigns& designs, TwoScaleTaps& taps) {
  const double stretch = std::abs(major);  // steps of the major axis in one pixel of the line
  const int box_half = box_half_of(kernel, stretch), steps = steps_of(kernel, stretch);
  const int d = TwoScaleDesign::decimation_for(box_half), radius = coarse_radius_of(steps, d);
  const TwoScaleDesign& design = designs.get({box_half, radius}, [&] { return TwoScaleDesign(box_half, radius); });

  taps.on_axis.resize(steps + kRowGroup);
  simd.resample_kernel(kernel.taps.data() + kernel.radius(), kernel.radius(), stretch, steps, taps.on_axis.data());
  design.fit(taps.on_axis.data(), steps, simd, taps.weights);
  taps.coarse.assign(2 * radius + 1 + 2 * kCoarseGuard, 0.0f);
  float* middle = taps.coarse.data() + kCoarseGuard + radius;
  for (int k = 0; k <= radius; ++k) middle[k] = middle[-k] = taps.weights.coarse[k];

  taps.filter = {box_half, taps.weights.inner_box, taps.weights.outer_box, taps.coarse.data() + kCoarseGuard, radius,
                 d};
  if (fixed_point) fix_coarse_weights(taps);
}

// With nodes of one sample the spline between nodes is 1/8, 3/4, 1/8, which is taken out of the weights by running over
// them forwards and backwards (M. Unser, IEEE Signal Processing Magazine 16 (6), 1999): what is left of a weight's
// share in the next is kPole.
void make_sheared_taps(const LineKernel& kernel, double major, bool fixed_point, TwoScaleTaps& taps) {
  const double kPole = 2 * std::sqrt(2.0) - 3;
  constexpr int kBeyond = 6;  // weights beyond the taps until kPole to their number is nothing
  kernel_on_major_axis(kernel, major, taps.on_axis);
  const int steps = static_cast<int>(taps.on_axis.size() / 2), radius = steps + kBeyond, count = 2 * radius + 1;
  taps.coarse.assign(count + 2 * kCoarseGuard, 0.0f);
  float* weights = taps.coarse.data() + kCoarseGuard;
  // In correlation order: reversed.
  double before = 0;
  taps.running.resize(count);
  for (int i = 0; i < count; ++i) {
    const int tap = 2 * steps - (i - kBeyond);
    before = (tap >= 0 && tap <= 2 * steps ? taps.on_axis[tap] : 0.0f) + kPole * before;
    taps.running[i] = before;
  }
  double after = -kPole / (1 - kPole * kPole) * before;
  for (int i = count - 1;; --i) {
    weights[i] = static_cast<float>(8 * after);
    if (i == 0) break;
    after = kPole * (after - taps.running[i - 1]);
  }

  taps.filter = {0, 0, 0, weights, radius, 1};  // the boxes weigh nothing
  if (fixed_point) fix_coarse_weights(taps);
}

}  // namespace gyro_deblur
