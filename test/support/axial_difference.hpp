// Comparison of blur angles.
#pragma once

#include <cmath>

namespace gyro_deblur::test {

/// Difference of two axial angles [rad], in [0, pi/2].
inline double axial_difference(double a_rad, double b_rad) { return std::abs(std::remainder(a_rad - b_rad, M_PI)); }

}  // namespace gyro_deblur::test
