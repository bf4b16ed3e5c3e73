// Velocities of corners as a linear function of their place, robustly.
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Velocities of corners near a centre, a column for each quantity.
struct NearbyVelocities {
  std::vector<float> x_px, y_px;      ///< from the centre
  std::vector<float> distance_px2;    ///< from there, squared
  std::vector<float> x_px_s, y_px_s;  ///< the velocity
  std::vector<float> nearness;        ///< (0, 1]: its weight

  std::size_t size() const { return x_px.size(); }
  void resize(std::size_t count) {
    for (std::vector<float>* column : {&x_px, &y_px, &distance_px2, &x_px_s, &y_px_s, &nearness}) column->resize(count);
  }
  /// @param i  < size()
  void set(std::size_t i, const Eigen::Vector2d& from_center_px, const Eigen::Vector2d& velocity_px_s);
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
VelocityPlane fit_plane(const NearbyVelocities& velocities, int iterations, double slope_prior);

/// How far from the centre [px] a velocity is seen: where the third of the corners is that show it.
/// @param velocities  that the plane was fitted to
double seen_from_px(const VelocityPlane& plane, const NearbyVelocities& velocities);

}  // namespace gyro_deblur
