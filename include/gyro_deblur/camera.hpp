// Pinhole camera with lens distortion: pixels to rays and back.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

enum class DistortionModel { NONE, PLUMB_BOB, RATIONAL_POLYNOMIAL, EQUIDISTANT };

/// Parses sensor_msgs/CameraInfo's name of a model; "" and "none" are NONE, which takes no coefficients.
/// Throws OptionError that lists the supported names.
DistortionModel parse_distortion_model(const std::string& name);

/// Calibration of the image as it arrives (region of interest and binning already applied).
struct CameraCalibration {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;  ///< pixel centres at integers
  DistortionModel model = DistortionModel::NONE;
  /// OpenCV's order: plumb_bob k1 k2 p1 p2 [k3]; rational_polynomial k1 k2 p1 p2 k3 k4 k5 k6; equidistant k1 k2 k3 k4.
  /// plumb_bob without any is an ideal lens (drivers of uncalibrated and simulated cameras send that).
  std::vector<double> coefficients;
  /// Camera frame of the calibration to the frame of the image: identity for raw images, camera_info's R for rectified
  /// ones (whose intrinsics are those of P).
  Eigen::Matrix3d R_image_cam = Eigen::Matrix3d::Identity();

  void validate() const;  ///< throws OptionError: sizes >= 1, finite focal lengths > 0, coefficients to the model
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

 private:
  // Undistorted to distorted (x/z, y/z) in the image's frame, and back; NaN beyond the model's range.
  Eigen::Vector2d distort(const Eigen::Vector2d& normalized, Eigen::Matrix2d* jacobian) const;
  Eigen::Vector2d undistort(const Eigen::Vector2d& distorted) const;

  CameraCalibration calibration_;
  Eigen::Matrix3d R_image_cam_;
  // Radial factor as numerator / denominator: polynomials in r^2 (equidistant: in the squared angle from the axis).
  std::array<double, 5> numerator_{1, 0, 0, 0, 0};
  std::array<double, 5> denominator_{1, 0, 0, 0, 0};
  double p1_ = 0, p2_ = 0;  // tangential
  double limit_ = 0;        // undistorted radius (equidistant: angle [rad]) up to which the radial part increases
};

}  // namespace gyro_deblur
