// Values out of YAML nodes, with errors that name the key, its value and what is allowed.
#pragma once

#include <cmath>
#include <string>

#include <yaml-cpp/yaml.h>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Reads a YAML file, also one by OpenCV's writer, which starts with "%YAML:1.0". Throws OptionError with the path when
/// it cannot be read or parsed.
YAML::Node load_yaml_file(const std::string& path);

/// The value on one line, shortened for messages.
std::string describe(const YAML::Node& node);

/// A quoted scalar has the tag "!".
bool is_quoted(const YAML::Node& node);

/// Nothing, an empty string or an empty list.
bool is_empty(const YAML::Node& node);

/// Throws OptionError "KEY = VALUE is not ALLOWED".
[[noreturn]] void refuse(const std::string& key, const YAML::Node& node, const std::string& allowed);

/// A quoted scalar counts, too, where all of its text is a value of the type: rosparam's YAML 1.1 takes 2e-2 for a
/// string.
template <typename T>
T read_scalar(const std::string& key, const YAML::Node& node, const std::string& allowed) {
  T value;
  if (!node.IsScalar() || !YAML::convert<T>::decode(node, value)) refuse(key, node, allowed);
  return value;
}

/// An integer, also as 1e3 or 20.0.
int read_integer(const std::string& key, const YAML::Node& node);

/// A finite number.
double read_number(const std::string& key, const YAML::Node& node, const std::string& allowed);

/// A finite number of seconds, rounded to nanoseconds.
TimeNs read_seconds(const std::string& key, const YAML::Node& node);

}  // namespace gyro_deblur
