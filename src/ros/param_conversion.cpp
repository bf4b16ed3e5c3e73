#include "ros/param_conversion.hpp"

#include <string>

namespace gyro_deblur {

YAML::Node to_yaml(XmlRpc::XmlRpcValue& value) {
  switch (value.getType()) {
    case XmlRpc::XmlRpcValue::TypeBoolean:
      return YAML::Node(static_cast<bool>(value));
    case XmlRpc::XmlRpcValue::TypeInt:
      return YAML::Node(static_cast<int>(value));
    case XmlRpc::XmlRpcValue::TypeDouble:
      return YAML::Node(static_cast<double>(value));
    case XmlRpc::XmlRpcValue::TypeString: {
      YAML::Node node(static_cast<std::string>(value));
      node.SetTag("!");  // YAML's mark of a quoted scalar
      return node;
    }
    case XmlRpc::XmlRpcValue::TypeArray: {
      YAML::Node node(YAML::NodeType::Sequence);
      for (int i = 0; i < value.size(); ++i) node.push_back(to_yaml(value[i]));
      return node;
    }
    case XmlRpc::XmlRpcValue::TypeStruct: {
      YAML::Node node(YAML::NodeType::Map);
      for (auto& [key, member] : value) node[key] = to_yaml(member);
      return node;
    }
    default:
      return YAML::Node();
  }
}

}  // namespace gyro_deblur
