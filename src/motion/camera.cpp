// Projects rays to pixels and back.
#include "gyro_deblur/camera.hpp"

#include <algorithm>
#include <limits>

#include <Eigen/Geometry>

#include "base/require_range.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/lens_models.hpp"

namespace gyro_deblur {

std::string require_distortion_model(const std::string& name) { return name.empty() ? "none" : lens_model(name).name; }

void CameraCalibration::validate() const {
  constexpr double kMaxSizePx = 65535;
  require_range("camera width", width_px, 1, kMaxSizePx, "px");
  require_range("camera height", height_px, 1, kMaxSizePx, "px");
  const double smallest = std::numeric_limits<double>::min();
  const double largest = std::numeric_limits<double>::max();
  require_range("camera fx", fx_px, smallest, largest, "px");
  require_range("camera fy", fy_px, smallest, largest, "px");
  require_range("camera cx", cx_px, -largest, largest, "px");
  require_range("camera cy", cy_px, -largest, largest, "px");
  require_coefficients(lens_model(model), coefficients);
  require_rotation("camera R", R_image_cam);
}

bool CameraCalibration::operator==(const CameraCalibration& other) const {
  return width_px == other.width_px && height_px == other.height_px && fx_px == other.fx_px && fy_px == other.fy_px &&
         cx_px == other.cx_px && cy_px == other.cy_px && model == other.model && coefficients == other.coefficients &&
         R_image_cam == other.R_image_cam;
}

Camera::Camera(const CameraCalibration& calibration) : calibration_(calibration) {
  calibration.validate();
  R_image_cam_ = require_rotation("camera R", calibration.R_image_cam);
  lens_ = make_lens(lens_model(calibration.model), calibration.coefficients);
}

Eigen::Vector3d Camera::ray(const Eigen::Vector2d& pixel_px) const {
  const Eigen::Vector2d distorted((pixel_px.x() - calibration_.cx_px) / calibration_.fx_px,
                                  (pixel_px.y() - calibration_.cy_px) / calibration_.fy_px);
  const double focal_px = std::max(calibration_.fx_px, calibration_.fy_px);
  const Eigen::Vector3d direction = R_image_cam_.transpose() * lens_->unproject(distorted, focal_px).homogeneous();
  if (!(direction.z() > 0)) return Eigen::Vector3d::Constant(kNan);
  return direction / direction.z();
}

std::vector<Eigen::Vector3d> Camera::rays(const std::vector<Eigen::Vector2d>& pixels_px) const {
  std::vector<Eigen::Vector3d> result;
  result.reserve(pixels_px.size());
  for (const Eigen::Vector2d& pixel_px : pixels_px) result.push_back(ray(pixel_px));
  return result;
}

Eigen::Vector2d Camera::project(const Eigen::Vector3d& direction) const {
  const Eigen::Vector3d in_image = R_image_cam_ * direction;
  if (!(in_image.z() > 0)) return {kNan, kNan};
  const Eigen::Vector2d distorted = lens_->project(in_image.hnormalized());
  return {calibration_.fx_px * distorted.x() + calibration_.cx_px,
          calibration_.fy_px * distorted.y() + calibration_.cy_px};
}

Eigen::Vector2d Camera::normalized(const Eigen::Vector3d& direction) const {
  return (R_image_cam_ * direction).hnormalized();
}

}  // namespace gyro_deblur
