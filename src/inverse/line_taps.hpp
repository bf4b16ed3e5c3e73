// A kernel along a line as weights of pixels.
#pragma once

#include <cstdint>
#include <vector>

#include "inverse/filter_bank.hpp"

namespace gyro_deblur {

/// How a line lies on the grid of pixels.
struct LineDirection {
  bool major_is_y;  ///< the major axis, the one that is nearer to the line, is y
  double major;     ///< sine (y) or cosine (x) of the line's angle, whichever is larger in size
  double slope;     ///< pixels across for a step of the major axis, [-1, 1]
};
LineDirection direction_of(double angle_rad);

/// The taps at a step of the major axis: neighbours across.
struct StepTaps {
  std::int32_t across;  ///< of the lower one
  float lower, upper;   ///< weights of `across` and across + 1; one or both may be 0
};

/// A rotated kernel step by step.
struct LineSteps {
  bool major_is_y = false;
  int first_m = 0;              ///< step of the major axis that steps.front() is
  std::vector<StepTaps> steps;  ///< one for each step from there on; the first and the last have weight
  std::vector<float> on_axis;   ///< room that making them takes
};

/// `kernel` rotated onto a line (paper section IV-B); the weights sum to the kernel's sum. Uses the room that `line`
/// has.
void make_line_steps(const LineKernel& kernel, const LineDirection& direction, LineSteps& line);

/// A non-zero element of a rotated kernel.
struct KernelTap {
  int dx, dy;
  float weight;
};

/// The same, tap by tap in rising order.
std::vector<KernelTap> rotate_kernel(const LineKernel& kernel, double angle_rad);

/// The kernel on unit steps of a line's major axis: each tap, at position * major, is weighted onto the two nearest
/// steps. major: cosine or sine of the line's angle, whichever is larger in size: 0.7 to 1, or the negative of it.
/// @param on_axis  set to steps -n .. n, n = ceil(radius * |major|)
void kernel_on_major_axis(const LineKernel& kernel, double major, std::vector<float>& on_axis);

}  // namespace gyro_deblur
