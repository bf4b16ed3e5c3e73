// The median.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace gyro_deblur {

/// Middle element in order of size, the upper one of two; T{} of nothing. Precondition: no NaN.
template <typename T>
T median(std::vector<T> values) {
  if (values.empty()) return T{};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace gyro_deblur
