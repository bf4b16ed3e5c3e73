// Distributes the taps of a rotated line over pixels.
#include "inverse/line_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace gyro_deblur {
namespace {

// Closer to a pixel than this counts as on it: cos(pi / 2) is not quite 0.
constexpr double kOnPixel = 1e-6;

/// Sum over taps i, which are `step` pixels apart, 1/2 < step <= 1, of their linear weight at `position` >= 0, which is
/// in units of taps. At most four taps are less than a pixel from it.
template <typename Tap>
inline float splat_at(double position, float step, Tap tap) {
  const int i = static_cast<int>(position);
  const float before = static_cast<float>(position - i) * step, after = step - before;
  return (tap(i) * (1 - before) + tap(i + 1) * (1 - after)) +
         (tap(i - 1) * std::max(1 - step - before, 0.0f) + tap(i + 2) * std::max(1 - step - after, 0.0f));
}

}  // namespace

LineDirection direction_of(double angle_rad) {
  const double dx = std::cos(angle_rad), dy = std::sin(angle_rad);
  const bool major_is_y = std::abs(dy) > std::abs(dx);
  const double major = major_is_y ? dy : dx;
  return {major_is_y, major, (major_is_y ? dx : dy) / major};
}

// Splat on unit steps of the major axis: the fewest taps of five rotations that restore the same
// (doc/reports/filter_constants.md).
void make_line_steps(const LineKernel& kernel, const LineDirection& direction, LineSteps& line) {
  kernel_on_major_axis(kernel, direction.major, line.on_axis);
  const std::vector<float>& on_axis = line.on_axis;
  const int middle = static_cast<int>(on_axis.size() / 2);
  // What lies beyond the first and the last weight is left out.
  int begin = 0, end = static_cast<int>(on_axis.size());
  while (begin < end && on_axis[begin] == 0) ++begin;
  while (begin < end && on_axis[end - 1] == 0) --end;
  line.major_is_y = direction.major_is_y;
  line.first_m = begin - middle;
  line.steps.resize(end - begin);
  for (int i = begin; i < end; ++i) {
    const double across = (i - middle) * direction.slope, weight = on_axis[i];
    int lower = static_cast<int>(across);
    if (across < lower) --lower;    // std::floor, which is a call where SSE4 is not assumed
    double share = across - lower;  // of the upper one
    if (share < kOnPixel) share = 0;
    if (share > 1 - kOnPixel) {
      ++lower;
      share = 0;
    }
    line.steps[i - begin] = {lower, static_cast<float>(weight * (1 - share)), static_cast<float>(weight * share)};
  }
}

std::vector<KernelTap> rotate_kernel(const LineKernel& kernel, double angle_rad) {
  LineSteps line;
  make_line_steps(kernel, direction_of(angle_rad), line);
  std::vector<KernelTap> taps;
  int m = line.first_m;
  for (const StepTaps& step : line.steps) {
    const auto add = [&](int n, float weight) {
      if (weight != 0) taps.push_back(line.major_is_y ? KernelTap{n, m, weight} : KernelTap{m, n, weight});
    };
    add(step.across, step.lower);
    add(step.across + 1, step.upper);
    ++m;
  }
  return taps;
}

void kernel_on_major_axis(const LineKernel& kernel, double major, std::vector<float>& on_axis) {
  const int radius = kernel.radius();
  const float step = static_cast<float>(std::abs(major));
  const double taps_a_pixel = 1 / std::abs(major);
  const int steps = static_cast<int>(std::ceil(radius * std::abs(major)));
  on_axis.resize(2 * steps + 1);
  float* out = on_axis.data() + steps;
  const float* taps = kernel.taps.data() + radius;
  const auto in_direction = [&](int direction) {
    return [=](int i) { return std::abs(i) > radius ? 0.0f : taps[i * direction]; };
  };
  const int direction = major > 0 ? 1 : -1;
  if (kernel.box_extent_px <= 0) {
    for (int m = 0; m <= steps; ++m) {
      out[m] = splat_at(m * taps_a_pixel, step, in_direction(direction));
      out[-m] = splat_at(m * taps_a_pixel, step, in_direction(-direction));
    }
    return;
  }
  // Symmetric: one half, mirrored, nearly all of it far from the end.
  const int inner = std::max(0, static_cast<int>((radius - 3) * std::abs(major)));
  for (int m = 0; m < inner; ++m) out[m] = splat_at(m * taps_a_pixel, step, [taps](int i) { return taps[i]; });
  for (int m = inner; m <= steps; ++m) out[m] = splat_at(m * taps_a_pixel, step, in_direction(1));
  for (int m = 1; m <= steps; ++m) out[-m] = out[m];
}

}  // namespace gyro_deblur
