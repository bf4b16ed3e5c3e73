// How a scene point runs in the image plane during the exposure.
#pragma once

#include <array>

#include <Eigen/Core>

#include "gyro_deblur/path_1d.hpp"

namespace gyro_deblur {

/// Places [px] of a scene point at kPathInstants, from where it is at the middle of the exposure. Straight and even in
/// between.
using Path2d = std::array<Eigen::Vector2f, kPathInstants>;

/// How far a path may lead that the 2-D filter takes [px]: tiles have 1024 px, of which 128 are the window and one
/// and a half times the extent is around it (src/engine/fourier_filter.hpp).
constexpr float kMax2dExtentPx = 596;

/// Width and height [px] of what the path covers, the place at the middle of the exposure included.
Eigen::Vector2f extent_of(const Path2d& path_px);

}  // namespace gyro_deblur
