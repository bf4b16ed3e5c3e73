// Rays near a known one, by the lens model's derivative.
#include "features/nearby_rays.hpp"

#include <Eigen/LU>

namespace gyro_deblur {

NearbyRays::NearbyRays(const Camera& camera, const Eigen::Vector2d& pixel_px, const Eigen::Vector3d& ray)
    : camera_(&camera), pixel_px_(pixel_px), ray_(ray) {
  // A tenth of a pixel or so. Newton's steps with its error of a hundredth gain two digits each.
  constexpr double kStep = 2e-4;
  for (int axis = 0; axis < 2; ++axis) {
    px_per_ray_.col(axis) = (camera.project(ray + kStep * Eigen::Vector3d::Unit(axis)) - pixel_px) / kStep;
  }
  ray_per_px_ = px_per_ray_.inverse();
}

Eigen::Vector3d NearbyRays::ray(const Eigen::Vector2d& pixel_px) const {
  constexpr double kDonePx = 1e-6;
  constexpr int kIterations = 8;
  Eigen::Vector3d ray = ray_;
  Eigen::Vector2d away_px = pixel_px - pixel_px_;
  double distance_px = away_px.norm();
  if (distance_px < kDonePx && ray.allFinite()) return ray;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    ray.head<2>() += ray_per_px_ * away_px;
    away_px = pixel_px - camera_->project(ray);
    const double left_px = away_px.norm();
    if (!(left_px < distance_px)) break;  // not so for NaN either
    // A step leaves about the same part of the distance as the one before.
    if (left_px * left_px < kDonePx * distance_px) {
      ray.head<2>() += ray_per_px_ * away_px;
      return ray;
    }
    distance_px = left_px;
  }
  return camera_->ray(pixel_px);
}

}  // namespace gyro_deblur
