// The files that repeat the tables of parameters, as they have to be, and values of parameters in YAML.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "config/config_table.hpp"

namespace gyro_deblur {
namespace test {

/// A value as a configuration writes it. Numbers have the fewest digits that give the same number again, with a point:
/// 64.0, 0.01, 1e-05.
std::string to_yaml(bool value);
std::string to_yaml(int value);
std::string to_yaml(double value);
std::string to_yaml(TimeNs value_ns);  ///< in seconds
std::string to_yaml(const std::string& value);
std::string to_yaml(const std::vector<std::string>& value);
std::string to_yaml(const Eigen::Vector3d& value);
std::string to_yaml(const std::optional<Eigen::Matrix3d>& value);
template <typename T>
std::enable_if_t<HasNames<T>::value, std::string> to_yaml(const T& value) {
  return name_of(value);
}

/// config/default.yaml: every key with its default.
std::string default_yaml();

/// cfg/Deblur.cfg: what may change while running.
std::string deblur_cfg();

/// The part of doc/guides/parameters.md between its markers.
std::string parameter_tables();

}  // namespace test
}  // namespace gyro_deblur
