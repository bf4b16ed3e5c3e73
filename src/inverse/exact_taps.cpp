#include "inverse/exact_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "inverse/fixed_point.hpp"

namespace gyro_deblur {
namespace {

// Up to this radius weights have 12 bits even where bytes are faster: short blur is restored so well (to 43 dB at 2 px)
// that the rounding to bytes shows, by up to 0.45 dB, against 0.07 dB at 5 px.
constexpr int kMaxFineRadius = 12;

}  // namespace

void make_exact_taps(const LineKernel& kernel, double angle_rad, bool byte_weights, ExactTaps& exact) {
  const bool major_is_y = direction_of(angle_rad).major_is_y;
  const std::vector<KernelTap>& taps = exact.rotated;
  rotate_kernel(kernel, angle_rad, exact.rotated, exact.on_axis);
  float largest = 0;
  for (const KernelTap& tap : taps) largest = std::max(largest, std::abs(tap.weight));
  double sum = 0;
  for (const KernelTap& tap : taps) sum += tap.weight;
  // As large as there is room for, one unit left for errors of neighbours; and such that the sum, which decides the
  // brightness, is a whole number.
  const bool bytes = byte_weights && kernel.radius() > kMaxFineRadius;
  const int max_weight = bytes ? kMaxByteWeight : kMaxPairWeight;
  double unit = (max_weight - 1) / std::max<double>(largest, std::numeric_limits<float>::min());
  if (std::abs(sum) * unit >= 1) unit = std::floor(std::abs(sum) * unit) / std::abs(sum);

  exact.pairs.clear();
  ExactFilter& filter = exact.filter;
  filter = {};
  filter.weights_are_bytes = bytes;
  filter.scale = static_cast<float>(1 / unit);
  filter.n_min = std::numeric_limits<int>::max();
  filter.n_max = std::numeric_limits<int>::min();
  const auto m_of = [&](const KernelTap& tap) { return major_is_y ? tap.dy : tap.dx; };
  const auto n_of = [&](const KernelTap& tap) { return major_is_y ? tap.dx : tap.dy; };
  // Rounding errors are passed on along the line, which is blurred in that direction and hardly sees their alternation:
  // that of a step's sum, and that of how it is shared between two neighbours.
  double sum_error = 0, share_error = 0;
  const auto round_with = [](double value, double& error) {
    value += error;
    const std::int32_t rounded = round_to_int(value);
    error = value - rounded;
    return rounded;
  };
  for (std::size_t i = 0; i < taps.size(); ++i) {
    // Convolution: output at p takes input at p - tap. Two neighbours across make one pair.
    const bool paired =
        i + 1 < taps.size() && m_of(taps[i + 1]) == m_of(taps[i]) && n_of(taps[i + 1]) == n_of(taps[i]) + 1;
    const double low = (paired ? taps[i + 1].weight : taps[i].weight) * unit;
    const double high = paired ? taps[i].weight * unit : 0.0;
    const std::int32_t both = round_with(low + high, sum_error);
    const std::int32_t fixed_low = paired ? round_with(low, share_error) : both;
    const PairTap pair{-m_of(taps[i]), -n_of(taps[i]) - (paired ? 1 : 0), pack_int16(fixed_low, both - fixed_low)};
    filter.radius_m = std::max(filter.radius_m, std::abs(pair.m));
    filter.n_min = std::min(filter.n_min, pair.n);
    filter.n_max = std::max(filter.n_max, pair.n);
    exact.pairs.push_back(pair);
    if (paired) ++i;
  }
  filter.taps = exact.pairs.data();
  filter.count = static_cast<int>(exact.pairs.size());
}

}  // namespace gyro_deblur
