// Where the gyroscope says that a corner has gone by the next image.
#pragma once

#include <optional>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Direction, at `to_ns`, of what was in direction `ray` at `from_ns`, by the camera's rotation; nothing where that is
/// not known.
std::optional<Eigen::Vector3d> rotated_ray(const Eigen::Vector3d& ray, const CameraMotion& motion, TimeNs from_ns,
                                           TimeNs to_ns);

/// Pixel, at `to_ns`, of what `pixel_px` shows in the image of `from`, whatever row it is in then.
std::optional<Eigen::Vector2d> predicted_pixel(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                               const CameraMotion& motion, const RowExposure& from, TimeNs to_ns);

/// Pixel, in the image of `to`, of what `pixel_px` shows in that of `from`.
std::optional<Eigen::Vector2d> predicted_pixel(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                               const CameraMotion& motion, const RowExposure& from,
                                               const RowExposure& to);

/// Where the camera's rotation takes a direction, and that rotation.
struct RotatedPixel {
  Eigen::Vector2d pixel_px;
  Eigen::Matrix3d rotation;
};
/// As predicted_pixel(), of a pixel whose direction is known.
std::optional<RotatedPixel> rotated_pixel(const Eigen::Vector2d& pixel_px, const Eigen::Vector3d& ray,
                                          const Camera& camera, const CameraMotion& motion, const RowExposure& from,
                                          const RowExposure& to);

/// Where what is at `pixel_px` in the middle of its row's exposure is on average within it, less `pixel_px`: a blurred
/// corner is seen there. Nothing where the rotation is not known.
std::optional<Eigen::Vector2d> mean_offset(const Eigen::Vector2d& pixel_px, const Camera& camera,
                                           const CameraMotion& motion, const RowExposure& exposure);

/// Derivative of Camera::project(): pixels for what a ray moves. Not finite beyond the range of the lens model.
Eigen::Matrix<double, 2, 3> projection_jacobian(const Camera& camera, const Eigen::Vector3d& ray);

}  // namespace gyro_deblur
