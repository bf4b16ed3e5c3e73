// Motion around a point, by that of its neighbours.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Displacement [px] around a point: at it, and what it changes by for each pixel away from it.
struct LocalMotion {
  Eigen::Vector2d displacement_px = Eigen::Vector2d::Zero();
  Eigen::Matrix2d slope = Eigen::Matrix2d::Zero();
};

/// Where points were, and by how much they were displaced.
struct DisplacedPoint {
  Eigen::Vector2d place_px, displacement_px;
};

/// Plane through the displacements of the nearest points, robust against those of another depth or object.
/// @param expected  the motion where there are not enough points, and the slope that the fit begins with
LocalMotion local_motion(const std::vector<DisplacedPoint>& points, const Eigen::Vector2d& place_px,
                         const LocalMotion& expected = {});

}  // namespace gyro_deblur
