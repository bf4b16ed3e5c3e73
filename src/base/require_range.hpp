// The check of a number that a user gives.
#pragma once

namespace gyro_deblur {

/// Throws OptionError "NAME = VALUE is outside [MIN, MAX] UNIT" unless min <= value <= max (NaN never passes).
void require_range(const char* name, double value, double min, double max, const char* unit = "");

}  // namespace gyro_deblur
