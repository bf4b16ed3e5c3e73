// Private parameters of a node, as the text that parse_config() reads.
#pragma once

#include <string>

#include <XmlRpcValue.h>

namespace gyro_deblur {

/// The same value in YAML, on one line. Strings stay strings, also where their text is a number; U+FFFD replaces bytes
/// that are not UTF-8. Doubles keep every bit.
std::string to_yaml(XmlRpc::XmlRpcValue& value);

}  // namespace gyro_deblur
