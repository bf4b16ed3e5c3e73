// Reads values from YAML nodes.
#include "config/yaml_reading.hpp"

#include <fstream>
#include <limits>
#include <sstream>

#include "base/require_range.hpp"

namespace gyro_deblur {

YAML::Node load_yaml_file(const std::string& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  if (!file) throw OptionError(path + ": cannot be opened: no such file, or no right to read it");
  std::string content = text.str();
  if (content.rfind("%YAML:", 0) == 0) content.front() = '#';  // no directive that YAML itself knows
  try {
    return YAML::Load(content);
  } catch (const YAML::Exception& error) {
    throw OptionError(path + ": " + error.what());
  }
}

bool is_quoted(const YAML::Node& node) { return node.IsScalar() && node.Tag() == "!"; }

bool is_empty(const YAML::Node& node) {
  return node.IsNull() || (node.IsScalar() && node.Scalar().empty()) || (node.IsSequence() && node.size() == 0);
}

std::string describe(const YAML::Node& node) {
  if (is_quoted(node)) return '"' + node.Scalar() + '"';
  YAML::Emitter emitter;
  emitter.SetSeqFormat(YAML::Flow);
  emitter.SetMapFormat(YAML::Flow);
  emitter << node;
  std::string text = emitter.good() ? emitter.c_str() : "?";
  constexpr std::size_t kLongest = 80;
  if (text.size() > kLongest) text = text.substr(0, kLongest) + "...";
  return text;
}

void refuse(const std::string& key, const YAML::Node& node, const std::string& allowed) {
  throw OptionError(key + " = " + describe(node) + " is not " + allowed);
}

int read_integer(const std::string& key, const YAML::Node& node) {
  const std::string allowed = "an integer";
  int value = 0;
  if (node.IsScalar() && YAML::convert<int>::decode(node, value)) return value;
  const double number = read_scalar<double>(key, node, allowed);  // 1e3, 20.0
  const bool is_integer = number == std::trunc(number) && number >= std::numeric_limits<int>::min() &&
                          number <= std::numeric_limits<int>::max();
  if (!is_integer) refuse(key, node, allowed);
  return static_cast<int>(number);
}

double read_number(const std::string& key, const YAML::Node& node, const std::string& allowed) {
  const double value = read_scalar<double>(key, node, allowed);
  if (!std::isfinite(value)) refuse(key, node, allowed);
  return value;
}

TimeNs read_seconds(const std::string& key, const YAML::Node& node) {
  // The bound only keeps the conversion to 64 bits of nanoseconds (292 years) from overflowing.
  constexpr double kLongestS = 9e9;
  const double seconds = read_number(key, node, "a finite number of seconds");
  require_range(key.c_str(), seconds, -kLongestS, kLongestS, "s");
  return to_ns(seconds);
}

}  // namespace gyro_deblur
