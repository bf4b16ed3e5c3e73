// What is said of a parameter that cannot be used.
#pragma once

#include <stdexcept>
#include <string>

namespace gyro_deblur {

/// A parameter that cannot be used; what() names it, its value and the allowed range.
class OptionError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// Throws OptionError "NAME = VALUE is outside [MIN, MAX] UNIT" unless min <= value <= max (NaN never passes).
void require_range(const char* name, double value, double min, double max, const char* unit = "");

}  // namespace gyro_deblur
