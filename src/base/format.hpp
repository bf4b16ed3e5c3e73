// Numbers in text.
#pragma once

#include <cmath>
#include <string>

#include <Eigen/Core>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

inline constexpr double kDegPerRad = 180 / M_PI;

/// As std::printf, to a string of any length.
__attribute__((format(printf, 1, 2))) std::string format(const char* pattern, ...);

/// Seconds with all nine digits: doubles have too few for stamps.
std::string seconds_text(TimeNs time_ns);
/// "[0.100000, -0.200000, 0.300000]".
std::string vector_text(const Eigen::Vector3d& v);
/// "640x480".
std::string size_text(double width, double height);

}  // namespace gyro_deblur
