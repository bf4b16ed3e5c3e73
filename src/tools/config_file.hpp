// The configuration of a tool.
#pragma once

#include <string>

#include "gyro_deblur/config.hpp"

namespace gyro_deblur {

/// Reads a configuration; what of it and of its calibration files is not understood is written to stderr. Throws
/// OptionError as load_config() does.
/// @param tool  its name, which begins each line
Config read_config(const std::string& tool, const std::string& path);

}  // namespace gyro_deblur
