// Numbers in text.
#pragma once

#include <cmath>
#include <string>

namespace gyro_deblur {

inline constexpr double kDegPerRad = 180 / M_PI;

/// As std::printf, to a string of any length.
__attribute__((format(printf, 1, 2))) std::string format(const char* pattern, ...);

}  // namespace gyro_deblur
