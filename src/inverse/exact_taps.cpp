// Rounds taps to fixed-point weights.
#include "inverse/exact_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "inverse/filter_bank.hpp"
#include "inverse/fixed_point.hpp"

namespace gyro_deblur {
namespace {

// Up to this radius weights have 12 bits even where bytes are faster: rounding to bytes costs up to 0.45 dB of short
// blur (doc/reports/filter_constants.md).
constexpr int kMaxFineRadius = 12;

}  // namespace

void make_exact_taps(const LineKernel& kernel, const LineDirection& direction, bool byte_weights, ExactTaps& exact) {
  make_line_steps(kernel, direction, exact.line);
  const std::vector<StepTaps>& steps = exact.line.steps;
  float largest = 0;
  double sum = 0;
  for (const StepTaps& step : steps) {
    largest = std::max(largest, std::max(std::abs(step.lower), std::abs(step.upper)));
    sum += static_cast<double>(step.lower) + step.upper;
  }
  // As large as there is room for, one unit left for errors of neighbours; and such that the sum, which decides the
  // brightness, is a whole number.
  const bool bytes = byte_weights && kernel.radius() > kMaxFineRadius;
  const int max_weight = bytes ? kMaxByteWeight : kMaxPairWeight;
  double unit = (max_weight - 1) / std::max<double>(largest, std::numeric_limits<float>::min());
  if (std::abs(sum) * unit >= 1) unit = std::floor(std::abs(sum) * unit) / std::abs(sum);

  exact.pairs.resize(steps.size());
  ExactFilter& filter = exact.filter;
  filter = {};
  filter.weights_are_bytes = bytes;
  filter.scale = static_cast<float>(1 / unit);
  filter.n_min = std::numeric_limits<int>::max();
  filter.n_max = std::numeric_limits<int>::min();
  // Rounding errors are passed on along the line, which is blurred in that direction and hardly sees their alternation:
  // that of a step's sum, and that of how it is shared between two neighbours.
  double sum_error = 0, share_error = 0;
  PairTap* pair = exact.pairs.data();
  int m = exact.line.first_m - 1;
  for (const StepTaps& step : steps) {
    ++m;
    if (step.lower == 0 && step.upper == 0) continue;
    // Convolution: output at p takes input at p - tap, so that the upper one of two neighbours comes first.
    const bool has_lower = step.lower != 0, has_upper = step.upper != 0;
    const double low = (has_upper ? step.upper : step.lower) * unit;
    const double high = has_upper ? step.lower * unit : 0.0;
    const std::int32_t both = round_with_error(low + high, sum_error);
    const std::int32_t fixed_low = has_lower && has_upper ? round_with_error(low, share_error) : both;
    const int n = -step.across - (has_upper ? 1 : 0);
    *pair++ = {-m, n, pack_int16(fixed_low, both - fixed_low)};
    filter.radius_m = std::max(filter.radius_m, std::abs(m));
    filter.n_min = std::min(filter.n_min, n);
    filter.n_max = std::max(filter.n_max, n);
  }
  filter.taps = exact.pairs.data();
  filter.count = static_cast<int>(pair - exact.pairs.data());
}

}  // namespace gyro_deblur
