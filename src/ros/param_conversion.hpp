// Private parameters of a node: as the text that parse_config reads, and as the values of dynamic_reconfigure.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <XmlRpcValue.h>
#include <dynamic_reconfigure/Config.h>

namespace gyro_deblur {

/// The same value in YAML, on one line. Strings stay strings, also where their text is a number; doubles keep every
/// bit.
std::string to_yaml(XmlRpc::XmlRpcValue& value);

/// Puts a parameter into `value` and returns true, where it is given and of that type. A whole number is an integer and
/// a floating-point number.
bool read_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, std::uint8_t& truth_value);
bool read_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, int& value);
bool read_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, double& value);
bool read_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, std::string& value);

/// Sets a parameter.
void write_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, std::uint8_t truth_value);
void write_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, int value);
void write_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, double value);
void write_parameter(XmlRpc::XmlRpcValue& parameters, const std::string& name, const std::string& value);

/// Calls function(entry...) for every parameter that dynamic_reconfigure serves, with its name and value in each of the
/// messages, which are all of one configuration type.
template <typename Function, typename... Messages>
void for_each_entry(Function function, Messages&... messages) {
  const auto side_by_side = [&function](auto& first, auto&... others) {
    for (std::size_t i = 0; i < first.size(); ++i) function(first[i], others[i]...);
  };
  side_by_side(messages.bools...);
  side_by_side(messages.ints...);
  side_by_side(messages.strs...);
  side_by_side(messages.doubles...);
}

}  // namespace gyro_deblur
