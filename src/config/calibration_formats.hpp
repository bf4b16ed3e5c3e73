// The formats of calibration files.
#pragma once

#include <string>

#include "gyro_deblur/calibration.hpp"

namespace gyro_deblur {

/// "cam0", "cam1", ...
bool is_camera_name(const std::string& key);

/// Reads a file in any of the formats that load_calibration() documents. Sets everything but the origin. Throws
/// OptionError that begins with the path.
/// @param camera  a name as above
SensorCalibration read_calibration_file(const std::string& path, const std::string& camera);

}  // namespace gyro_deblur
