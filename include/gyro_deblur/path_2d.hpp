// Path of a scene point on the image during the exposure.
#pragma once

#include <array>

#include <Eigen/Core>

#include "gyro_deblur/path_1d.hpp"

namespace gyro_deblur {

/// Places [px] of a scene point at kPathInstants, relative to the place at mid-exposure. Straight and uniform in
/// between.
using Path2d = std::array<Eigen::Vector2f, kPathInstants>;

/// Largest width or height [px] of a path for the 2-D filter: its tiles have at most 1024 px
/// (doc/design/blur_model.md).
constexpr float kMax2dExtentPx = 596;

/// Width and height [px] of what the path covers, the place at the middle of the exposure included.
Eigen::Vector2f extent_of(const Path2d& path_px);

}  // namespace gyro_deblur
