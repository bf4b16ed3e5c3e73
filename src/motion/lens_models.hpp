// Lens models: where the ray (x/z, y/z) meets the plane z = 1 of a distorted image, and back.
// A model is a class in lens_models.cpp and its row in the table at that file's end; nothing else knows it.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// A lens with its coefficients.
class LensModel {
 public:
  virtual ~LensModel() = default;

  /// Undistorted (x/z, y/z) to distorted; NaN beyond max_angle_rad().
  virtual Eigen::Vector2d project(const Eigen::Vector2d& undistorted) const = 0;

  /// Distorted to undistorted, so that project() gives it back to less than 1e-6 px; NaN where no ray within the valid
  /// range comes out.
  /// @param focal_px  the larger focal length, which makes a length of the plane z = 1 a number of pixels
  virtual Eigen::Vector2d unproject(const Eigen::Vector2d& distorted, double focal_px) const = 0;

  /// (0, pi / 2] rad from the optical axis: the valid range. A polynomial folds back somewhere outside the field of
  /// view that it was fitted to; the range ends where it does, or at the image plane.
  virtual double max_angle_rad() const = 0;
};

/// A model in a calibration file whose list of coefficients is in OpenCV's order.
struct ListedLens {
  std::string name;              ///< "": the format does not have the model
  std::size_t coefficients = 0;  ///< how many the format lists
};

/// A model in a file of camodocal (VINS), where each number has a key.
struct KeyedLens {
  std::string name;                       ///< "": the format does not have the model
  std::array<std::string, 4> intrinsics;  ///< fx, fy, cx, cy: keys of projection_parameters
  std::string section;                    ///< that has the coefficients
  std::vector<std::string> coefficients;  ///< keys, in OpenCV's order
};

/// A row of the table of lens models.
struct LensModelRow {
  std::string name;                             ///< of sensor_msgs/CameraInfo; "none" is the ideal lens
  std::string camera_info_name;                 ///< what to send in a CameraInfo, which has no name for the ideal lens
  std::vector<std::size_t> coefficient_counts;  ///< allowed numbers of coefficients, rising
  ListedLens kalibr;
  ListedLens euroc;
  KeyedLens camodocal;
  /// @param coefficients  finite, in OpenCV's order, as many as coefficient_counts allows
  std::unique_ptr<const LensModel> (*make)(const std::vector<double>& coefficients);
};

/// All lens models.
const std::vector<LensModelRow>& lens_models();

/// The row of sensor_msgs' name. Throws OptionError that lists the known names.
const LensModelRow& lens_model(const std::string& name);

/// Their names in the table's order.
std::vector<std::string> lens_model_names();

}  // namespace gyro_deblur
