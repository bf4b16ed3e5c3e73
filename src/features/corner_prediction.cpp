// Predicts corners by the camera's rotation.
#include "features/corner_prediction.hpp"

#include <algorithm>

namespace gyro_deblur {
namespace {

std::optional<Eigen::Matrix3d> rotation_between(const CameraMotion& motion, TimeNs from_ns, TimeNs to_ns) {
  if (!motion.covers({std::min(from_ns, to_ns), std::max(from_ns, to_ns)})) return std::nullopt;
  return motion.rotation(from_ns, to_ns);
}

std::optional<RotatedPixel> pixel_of(const Eigen::Vector3d& ray, const Camera& camera, const CameraMotion& motion,
                                     TimeNs from_ns, TimeNs to_ns) {
  const auto rotation = rotation_between(motion, from_ns, to_ns);
  if (!rotation) return std::nullopt;
  const Eigen::Vector2d at_px = camera.project(*rotation * ray);
  if (!at_px.allFinite()) return std::nullopt;
  return RotatedPixel{at_px, *rotation};
}

}  // namespace

std::optional<Eigen::Vector3d> rotated_ray(const Eigen::Vector3d& ray, const CameraMotion& motion, TimeNs from_ns,
                                           TimeNs to_ns) {
  const auto rotation = rotation_between(motion, from_ns, to_ns);
  if (!rotation) return std::nullopt;
  return *rotation * ray;
}

std::optional<Eigen::Vector2d> predicted_pixel(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                               const CameraMotion& motion, const RowExposure& from, TimeNs to_ns) {
  const auto rotated = pixel_of(camera.ray(pixel_px), camera, motion, from.middle(pixel_px.y()), to_ns);
  if (!rotated) return std::nullopt;
  return rotated->pixel_px;
}

std::optional<Eigen::Vector2d> predicted_pixel(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                               const CameraMotion& motion, const RowExposure& from,
                                               const RowExposure& to) {
  const auto rotated = rotated_pixel(pixel_px, camera.ray(pixel_px), camera, motion, from, to);
  if (!rotated) return std::nullopt;
  return rotated->pixel_px;
}

std::optional<RotatedPixel> rotated_pixel(const Eigen::Vector2d& pixel_px, const Eigen::Vector3d& ray,
                                          const Camera& camera, const CameraMotion& motion, const RowExposure& from,
                                          const RowExposure& to) {
  const double last_row = camera.calibration().height_px - 1.0;
  const TimeNs from_ns = from.middle(pixel_px.y());
  RotatedPixel rotated{pixel_px, Eigen::Matrix3d::Identity()};
  // The row decides when it is seen, and that decides the row.
  const int iterations = to.timing().readout_ns == 0 ? 1 : 3;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const auto next =
        pixel_of(ray, camera, motion, from_ns, to.middle(std::clamp(rotated.pixel_px.y(), 0.0, last_row)));
    if (!next) return std::nullopt;
    rotated = *next;
  }
  return rotated;
}

std::optional<Eigen::Vector2d> mean_offset(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                           const CameraMotion& motion, const RowExposure& exposure) {
  const Eigen::Vector3d ray = camera.ray(pixel_px);
  const TimeNs middle_ns = exposure.middle(pixel_px.y());
  const auto first = pixel_of(ray, camera, motion, middle_ns, exposure.start(pixel_px.y()));
  const auto last = pixel_of(ray, camera, motion, middle_ns, exposure.end(pixel_px.y()));
  if (!first || !last) return std::nullopt;
  return (first->pixel_px + last->pixel_px - 2 * pixel_px) / 6;  // Simpson's rule
}

Eigen::Matrix<double, 2, 3> projection_jacobian(const Camera& camera, const Eigen::Vector3d& ray) {
  constexpr double kStep = 1e-4;  // a twentieth of a pixel: far above rounding, far below what distorts a lens
  Eigen::Matrix<double, 2, 3> jacobian;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
    jacobian.col(axis) = (camera.project(ray + step) - camera.project(ray - step)) / (2 * kStep);
  }
  return jacobian;
}

}  // namespace gyro_deblur
