// Directions of pixels near one whose direction is known.
#pragma once

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"

namespace gyro_deblur {

/// Newton's method from a neighbour takes a tenth of the time of undistorting a pixel from scratch. Refers to the
/// camera.
class NearbyRays {
 public:
  /// @param ray  of the pixel, z = 1; NaN: each pixel is undistorted from scratch
  NearbyRays(const Camera& camera, const Eigen::Vector2d& pixel_px, const Eigen::Vector3d& ray);

  /// As Camera::ray(), to a hundred-thousandth of a pixel.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel_px) const;
  const Camera& camera() const { return *camera_; }
  /// Jacobian of the pixel by x and y of a direction with z = 1, to a few ten-thousandths; and its inverse.
  const Eigen::Matrix2d& px_per_ray() const { return px_per_ray_; }
  const Eigen::Matrix2d& ray_per_px() const { return ray_per_px_; }

 private:
  const Camera* camera_;
  Eigen::Vector2d pixel_px_;
  Eigen::Vector3d ray_;
  Eigen::Matrix2d px_per_ray_, ray_per_px_;
};

}  // namespace gyro_deblur
