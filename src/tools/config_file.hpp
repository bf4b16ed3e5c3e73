// The configuration of a tool.
#pragma once

#include <string>

#include "gyro_deblur/config.hpp"

namespace gyro_deblur {

/// Reads a configuration; keys of it that are not known are written to stderr. Throws OptionError as load_config()
/// does.
/// @param tool  its name, which begins each line
Config read_config(const std::string& tool, const std::string& path);

}  // namespace gyro_deblur
