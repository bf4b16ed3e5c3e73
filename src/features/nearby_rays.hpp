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

  /// As Camera::ray(), to a millionth of a pixel.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel_px) const;
  const Camera& camera() const { return camera_; }

 private:
  const Camera& camera_;
  Eigen::Vector2d pixel_px_;
  Eigen::Vector3d ray_;
  Eigen::Matrix2d per_pixel_;  // what x and y of a direction with z = 1 change by
};

}  // namespace gyro_deblur
