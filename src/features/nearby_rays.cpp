// Rays near a known one, by the lens model's derivative.
#include "features/nearby_rays.hpp"

#include <Eigen/LU>

namespace gyro_deblur {

NearbyRays::NearbyRays(const Camera& camera, const Eigen::Vector2d& pixel_px, const Eigen::Vector3d& ray)
    : camera_(camera), pixel_px_(pixel_px), ray_(ray) {
  // A tenth of a pixel or so. Newton's steps with its error of a hundredth gain two digits each.
  constexpr double kStep = 2e-4;
  Eigen::Matrix2d pixels;
  for (int axis = 0; axis < 2; ++axis) {
    pixels.col(axis) = (camera.project(ray + kStep * Eigen::Vector3d::Unit(axis)) - pixel_px) / kStep;
  }
  per_pixel_ = pixels.inverse();
}

Eigen::Vector3d NearbyRays::ray(const Eigen::Vector2d& pixel_px) const {
  constexpr double kDonePx2 = 1e-12;
  constexpr int kIterations = 8;
  Eigen::Vector3d ray = ray_;
  Eigen::Vector2d away_px = pixel_px - pixel_px_;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const double distance_px2 = away_px.squaredNorm();
    if (distance_px2 < kDonePx2) return ray;
    ray.head<2>() += per_pixel_ * away_px;
    away_px = pixel_px - camera_.project(ray);
    if (!(away_px.squaredNorm() < distance_px2)) break;  // not so for NaN either
  }
  return camera_.ray(pixel_px);
}

}  // namespace gyro_deblur
