// Loads the configuration of a tool.
#include "tools/config_file.hpp"

#include <iostream>
#include <vector>

namespace gyro_deblur {

Config read_config(const std::string& tool, const std::string& path) {
  std::vector<std::string> unknown;
  Config config = load_config(path, &unknown);
  for (const std::string& key : unknown) {
    if (key == "image_transport") continue;  // of the nodelet; a bag's messages say by their type how to read them
    std::cerr << tool << ": " << path << ": " << unknown_key_message(key) << '\n';
  }
  return config;
}

}  // namespace gyro_deblur
