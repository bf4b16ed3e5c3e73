// Motion around a point, by that of its neighbours.
#pragma once

#include <optional>
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

/// Plane through the displacements of the nearest points, robust against those of another depth or object. Nothing
/// where there are fewer than six.
/// @param expected_slope  in directions in which the points do not extend, the slope stays near it
std::optional<LocalMotion> local_motion(const std::vector<DisplacedPoint>& points, const Eigen::Vector2d& place_px,
                                        const Eigen::Matrix2d& expected_slope = Eigen::Matrix2d::Zero());

}  // namespace gyro_deblur
