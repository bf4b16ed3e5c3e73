// Values of parameters that are allowed and not the default.
#pragma once

#include <string>
#include <vector>

#include "config/config_table.hpp"

namespace gyro_deblur {
namespace test {

template <typename T>
T last_named(const T& value) {
  return names_of(value).back().second;
}
inline ExposureSource last_named(ExposureSource value) {
  std::tie(value.kind, value.unit) = names_of(value).back().second;
  return value;
}

/// An allowed value that is not the default, which is given.
template <typename T>
T other_value(const Row& row, const T& standard) {
  if constexpr (std::is_same_v<T, bool>) {
    return !standard;
  } else if constexpr (std::is_same_v<T, TimeNs>) {
    return to_ns(row.limits->max);
  } else if constexpr (std::is_arithmetic_v<T>) {
    return static_cast<T>(row.limits->max);
  } else if constexpr (std::is_same_v<T, std::string>) {
    return row.choices.empty() ? "other" : row.choices.back();
  } else if constexpr (std::is_same_v<T, std::vector<std::string>>) {
    return {"other"};
  } else if constexpr (std::is_same_v<T, Eigen::Vector3d>) {
    return {0.1, 0.2, 0.3};
  } else if constexpr (std::is_same_v<T, std::optional<Eigen::Matrix3d>>) {
    return Eigen::Matrix3d::Identity().eval();
  } else {
    return last_named(standard);
  }
}

}  // namespace test
}  // namespace gyro_deblur
