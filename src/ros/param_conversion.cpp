// Converts ROS parameters to and from the configuration's text.
#include "ros/param_conversion.hpp"

#include <cmath>
#include <limits>
#include <locale>
#include <optional>
#include <sstream>

#include "config/text_value.hpp"

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

/// With YAML's double quotes, which make it a string whatever it says.
std::string quoted(const std::string& value) {
  static const char kHexDigits[] = "0123456789ABCDEF";
  std::string text = "\"";
  for (const char c : value) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x20 || byte == 0x7F) {
      text += {'\\', 'x', kHexDigits[byte / 16], kHexDigits[byte % 16]};
    } else {
      if (c == '"' || c == '\\') text += '\\';
      text += c;
    }
  }
  return text + '"';
}

XmlRpcValue::Type type_of(XmlRpcValue& parameters, const std::string& name) {
  return parameters.hasMember(name) ? parameters[name].getType() : XmlRpcValue::TypeInvalid;
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

bool read_parameter(XmlRpcValue& parameters, const std::string& name, std::uint8_t& truth_value) {
  std::optional<bool> value;
  const XmlRpcValue::Type type = type_of(parameters, name);
  if (type == XmlRpcValue::TypeBoolean) value = static_cast<bool>(parameters[name]);
  if (type == XmlRpcValue::TypeString) value = to_truth_value(static_cast<std::string>(parameters[name]));
  if (value) truth_value = *value ? 1 : 0;
  return value.has_value();
}

bool read_parameter(XmlRpcValue& parameters, const std::string& name, int& value) {
  double number = 0;
  if (!read_parameter(parameters, name, number) || number != std::trunc(number)) return false;
  if (number < std::numeric_limits<int>::min() || number > std::numeric_limits<int>::max()) return false;
  value = static_cast<int>(number);
  return true;
}

bool read_parameter(XmlRpcValue& parameters, const std::string& name, double& value) {
  std::optional<double> number;
  const XmlRpcValue::Type type = type_of(parameters, name);
  if (type == XmlRpcValue::TypeInt) number = static_cast<int>(parameters[name]);
  if (type == XmlRpcValue::TypeDouble) number = static_cast<double>(parameters[name]);
  if (type == XmlRpcValue::TypeString) number = to_number(static_cast<std::string>(parameters[name]));
  if (number) value = *number;
  return number.has_value();
}

bool read_parameter(XmlRpcValue& parameters, const std::string& name, std::string& value) {
  if (type_of(parameters, name) != XmlRpcValue::TypeString) return false;
  value = static_cast<std::string>(parameters[name]);
  return true;
}

void write_parameter(XmlRpcValue& parameters, const std::string& name, std::uint8_t truth_value) {
  parameters[name] = truth_value != 0;
}

void write_parameter(XmlRpcValue& parameters, const std::string& name, int value) { parameters[name] = value; }

void write_parameter(XmlRpcValue& parameters, const std::string& name, double value) { parameters[name] = value; }

void write_parameter(XmlRpcValue& parameters, const std::string& name, const std::string& value) {
  parameters[name] = XmlRpcValue(value);
}

}  // namespace gyro_deblur
