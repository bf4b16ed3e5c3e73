// Pinhole camera with lens distortion: pixels to rays and back.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

class LensModel;

/// The name of the lens model that a file or message means by `name`: that of sensor_msgs/CameraInfo, "none" (the ideal
/// lens, which takes no coefficients) also for "". Throws OptionError that lists the known names.
std::string require_distortion_model(const std::string& name);

/// Calibration of the image as it arrives (region of interest and binning already applied).
struct CameraCalibration {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;  ///< pixel centres at integers
  std::string model = "none";                         ///< sensor_msgs/CameraInfo's name of the lens model, or "none"
  /// OpenCV's order: plumb_bob k1 k2 p1 p2 k3; rational_polynomial k1 k2 p1 p2 k3 k4 k5 k6; equidistant k1 k2 k3 k4.
  /// ds: xi alpha; eucm: alpha beta; mei: xi k1 k2 p1 p2. Zeros at the end may be missing, or too many.
  /// plumb_bob without any is an ideal lens (drivers of uncalibrated and simulated cameras send that).
  std::vector<double> coefficients;
  /// Camera frame of the calibration to the frame of the image: identity for raw images, camera_info's R for rectified
  /// ones (whose intrinsics are those of P).
  Eigen::Matrix3d R_image_cam = Eigen::Matrix3d::Identity();

  /// Throws OptionError: sizes >= 1, finite focal lengths > 0, a known model, and coefficients that it has.
  void validate() const;
  bool operator==(const CameraCalibration& other) const;
  bool operator!=(const CameraCalibration& other) const { return !(*this == other); }
};

/// The projection of one calibration.
class Camera {
 public:
  /// Throws OptionError when the calibration is not valid.
  explicit Camera(const CameraCalibration& calibration);

  const CameraCalibration& calibration() const { return calibration_; }

  /// Pixels [px] to rays (x/z, y/z, 1) of the camera frame, undistorted iteratively to about 1e-6 px.
  /// A pixel beyond the model's range gives non-finite coordinates.
  std::vector<Eigen::Vector3d> rays(const std::vector<Eigen::Vector2d>& pixels_px) const;
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel_px) const;

  /// Direction (any positive length) to pixel [px]. NaN for z <= 0 in the image's frame, and beyond the radius where
  /// the distortion model folds back (a polynomial does so somewhere outside the field of view it was fitted to).
  Eigen::Vector2d project(const Eigen::Vector3d& direction) const;

  /// Direction (any length, z > 0 in the image's frame) to where an ideal image of focal length 1 has it: x/z, y/z of
  /// the image's frame, which for rectified images is rotated against the camera's.
  Eigen::Vector2d normalized(const Eigen::Vector3d& direction) const;

 private:
  CameraCalibration calibration_;
  Eigen::Matrix3d R_image_cam_;
  std::shared_ptr<const LensModel> lens_;
};

}  // namespace gyro_deblur
