// Checks a number and describes its allowed range.
#include "base/require_range.hpp"

#include <sstream>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

void require_range(const char* name, double value, double min, double max, const char* unit) {
  if (value >= min && value <= max) return;
  std::ostringstream message;
  message.precision(10);  // distinguishes an open end one nanosecond from its bound
  message << name << " = " << value << " is outside [" << min << ", " << max << "]";
  if (*unit != '\0') message << ' ' << unit;
  throw OptionError(message.str());
}

}  // namespace gyro_deblur
