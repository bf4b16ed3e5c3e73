// Private parameters of a node as the map that parse_config reads.
#pragma once

#include <XmlRpcValue.h>
#include <yaml-cpp/yaml.h>

namespace gyro_deblur {

/// The same value as a YAML node. Strings stay strings, also where their text is a number.
YAML::Node to_yaml(XmlRpc::XmlRpcValue& value);

}  // namespace gyro_deblur
