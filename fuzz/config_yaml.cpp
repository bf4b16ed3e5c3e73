// Any text as a configuration: accepted and valid, or refused with OptionError.
#include <cstddef>
#include <cstdint>
#include <string>

#include <yaml-cpp/yaml.h>

#include "gyro_deblur/config.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  YAML::Node node;
  try {
    node = YAML::Load(std::string(reinterpret_cast<const char*>(data), size));
  } catch (const YAML::Exception&) {
    return 0;  // load_config turns it into an OptionError
  }
  try {
    gyro_deblur::parse_config(node).validate();
  } catch (const gyro_deblur::OptionError&) {
    // What anything else than a configuration has to give.
  }
  return 0;
}
