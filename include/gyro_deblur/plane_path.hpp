// How a scene point runs in the image plane during the exposure.
#pragma once

#include <array>

#include <Eigen/Core>

#include "gyro_deblur/line_path.hpp"

namespace gyro_deblur {

/// Places [px] of a scene point at kPathInstants, from where it is at the middle of the exposure. Straight and even in
/// between.
using PlanePath = std::array<Eigen::Vector2f, kPathInstants>;

/// How far a path may lead that is filtered in the plane [px]: tiles have 1024 px, of which 128 are the window and one
/// and a half times the extent is around it (src/engine/plane_filter.hpp).
constexpr float kMaxPlaneExtentPx = 596;

/// Width and height [px] of what the path covers, the place at the middle of the exposure included.
Eigen::Vector2f extent_of(const PlanePath& path_px);

}  // namespace gyro_deblur
