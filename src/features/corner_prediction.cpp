#include "features/corner_prediction.hpp"

#include <algorithm>

namespace gyro_deblur {

std::optional<Eigen::Vector3d> turned_ray(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                          const CameraMotion& motion, TimeNs from_ns, TimeNs to_ns) {
  if (!motion.covers({std::min(from_ns, to_ns), std::max(from_ns, to_ns)})) return std::nullopt;
  return motion.rotation(from_ns, to_ns) * camera.ray(pixel_px);
}

std::optional<Eigen::Vector2d> predicted_pixel(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                               const CameraMotion& motion, const RowExposure& from, TimeNs to_ns) {
  const auto direction = turned_ray(pixel_px, camera, motion, from.middle(pixel_px.y()), to_ns);
  if (!direction) return std::nullopt;
  const Eigen::Vector2d at_px = camera.project(*direction);
  if (!at_px.allFinite()) return std::nullopt;
  return at_px;
}

std::optional<Eigen::Vector2d> predicted_pixel(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                               const CameraMotion& motion, const RowExposure& from,
                                               const RowExposure& to) {
  const double last_row = camera.calibration().height_px - 1.0;
  Eigen::Vector2d at_px = pixel_px;
  // The row decides when it is seen, and that decides the row.
  for (int iteration = 0; iteration < 3; ++iteration) {
    const auto next_px =
        predicted_pixel(pixel_px, camera, motion, from, to.middle(std::clamp(at_px.y(), 0.0, last_row)));
    if (!next_px) return std::nullopt;
    at_px = *next_px;
  }
  return at_px;
}

}  // namespace gyro_deblur
