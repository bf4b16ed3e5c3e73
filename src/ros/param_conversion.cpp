// Converts ROS parameters to the configuration's text.
#include "ros/param_conversion.hpp"

#include <cmath>
#include <limits>
#include <locale>
#include <sstream>

#include <nlohmann/json.hpp>

namespace gyro_deblur {
namespace {

using XmlRpc::XmlRpcValue;

std::string number(double value) {
  if (std::isnan(value)) return ".nan";
  if (std::isinf(value)) return value > 0 ? ".inf" : "-.inf";
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text.precision(std::numeric_limits<double>::max_digits10);
  text << value;
  return text.str();
}

/// JSON's strings are YAML's, too, and are strings whatever they say.
std::string quoted(const std::string& value) {
  return nlohmann::json(value).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

std::string to_yaml(XmlRpcValue& value) {
  std::string text;
  switch (value.getType()) {
    case XmlRpcValue::TypeBoolean:
      return static_cast<bool>(value) ? "true" : "false";
    case XmlRpcValue::TypeInt:
      return std::to_string(static_cast<int>(value));
    case XmlRpcValue::TypeDouble:
      return number(static_cast<double>(value));
    case XmlRpcValue::TypeString:
      return quoted(static_cast<std::string>(value));
    case XmlRpcValue::TypeArray:
      for (int i = 0; i < value.size(); ++i) text += (i == 0 ? "" : ", ") + to_yaml(value[i]);
      return '[' + text + ']';
    case XmlRpcValue::TypeStruct:
      for (auto& [key, member] : value) text += (text.empty() ? "" : ", ") + quoted(key) + ": " + to_yaml(member);
      return '{' + text + '}';
    default:
      return "~";
  }
}

}  // namespace gyro_deblur
