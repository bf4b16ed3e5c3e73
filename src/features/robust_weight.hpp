// Least squares in two dimensions that do not follow outliers.
#pragma once

#include <algorithm>
#include <vector>

#include "base/median.hpp"

namespace gyro_deblur {

/// Standard deviation of each component of vectors, from their lengths' median; not 0.
inline double spread_of_median(double distance) {
  /// Median length of a vector whose two components are normal, with a standard deviation of 1.
  constexpr double kMedianLength = 1.1774;
  constexpr double kLeast = 1e-3;
  return std::max(distance / kMedianLength, kLeast);
}
template <typename T>
double spread_of(const std::vector<T>& distances) {
  return spread_of_median(median(distances));
}

/// Geman and McClure's.
template <typename T>
T robust_weight(T distance, T spread) {
  constexpr T kScale = 2;
  const T off = distance / (kScale * spread);
  return 1 / ((1 + off * off) * (1 + off * off));
}

}  // namespace gyro_deblur
