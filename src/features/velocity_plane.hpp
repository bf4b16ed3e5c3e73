// Velocities of corners as a linear function of their place, robustly.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Velocity of a corner near a centre.
struct NearbyVelocity {
  Eigen::Vector2d from_center_px = Eigen::Vector2d::Zero();
  double distance_px2 = 0;
  Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();
  double nearness = 1;  ///< (0, 1]: its weight
};

/// Velocities [px/s] over the image, by the distance from a centre [px].
struct VelocityPlane {
  Eigen::Matrix<double, 3, 2> coefficients = Eigen::Matrix<double, 3, 2>::Zero();
  double stddev_px_s = 0;  ///< at the centre
  double spread_px_s = 0;  ///< of the corners about it

  Eigen::Vector2d at(const Eigen::Vector2d& from_center_px) const {
    return (Eigen::RowVector3d(1, from_center_px.x(), from_center_px.y()) * coefficients).transpose();
  }
};

/// Weights of Geman and McClure, times nearness, from the median on.
/// @param velocities   at least one
/// @param iterations   >= 0
/// @param slope_prior  how many corners at the farthest one's distance speak for no slope
VelocityPlane fit_plane(const std::vector<NearbyVelocity>& velocities, int iterations, double slope_prior);

/// How far from the centre [px] a velocity is seen: where the third of the corners is that show it.
/// @param velocities  that the plane was fitted to
double seen_from_px(const VelocityPlane& plane, const std::vector<NearbyVelocity>& velocities);

}  // namespace gyro_deblur
