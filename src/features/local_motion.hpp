// Motion around a point, by that of its neighbours.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Displacement [px] around a point: at it, and what it changes by for each pixel away from it.
struct LocalMotion {
  Eigen::Vector2d displacement_px;
  Eigen::Matrix2d slope;
};

/// Where points were, and by how much they were displaced.
struct DisplacedPoint {
  Eigen::Vector2d place_px, displacement_px;
};

/// Plane through the displacements of the nearest points, robust against those of another depth or object. Without
/// enough points nothing is displaced.
LocalMotion local_motion(const std::vector<DisplacedPoint>& points, const Eigen::Vector2d& place_px);

}  // namespace gyro_deblur
