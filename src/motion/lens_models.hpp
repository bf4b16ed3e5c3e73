// Lens models: where the ray (x/z, y/z) meets the plane z = 1 of a distorted image, and back.
// A model is a class in lens_models.cpp and its row in the table at that file's end; nothing else knows it.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

inline constexpr double kHalfPi = 1.57079632679489661923;
/// Coordinates of points that the lens does not show.
inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

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

/// A model in a file of Kalibr.
struct KalibrLens {
  std::string camera_model;       ///< "": the format does not have the model
  std::string distortion_model;   ///< "none" in a file leaves out the listed coefficients
  std::size_t in_intrinsics = 0;  ///< coefficients before fu, fv, pu, pv in `intrinsics`
  std::size_t in_distortion = 0;  ///< how many `distortion_coeffs` lists
};

/// A model in EuRoC's file of a camera, whose list of coefficients is in OpenCV's order.
struct EurocLens {
  std::string name;               ///< "": the format does not have the model
  std::size_t in_distortion = 0;  ///< how many the format lists
};

/// A model in a file where each number has a key.
struct KeyedLens {
  std::string name;                       ///< "": the format does not have the model
  std::array<std::string, 4> intrinsics;  ///< keys of fx, fy, cx, cy, with those of the maps that they are in: "a.b"
  std::vector<std::string> coefficients;  ///< keys of the model's first coefficients
};

/// A coefficient that shapes the lens, so that 0 is no substitute for it.
struct ShapeCoefficient {
  std::string name;
  double min, max;
};

/// A row of the table of lens models.
struct LensModelRow {
  std::string name;        ///< that of sensor_msgs/CameraInfo where it has the model; "none" is the ideal lens
  bool is_in_camera_info;  ///< sensor_msgs/CameraInfo says what D means
  std::size_t coefficient_count;
  std::size_t fewest_given;             ///< coefficients that a source must have; missing ones after these are 0
  std::vector<ShapeCoefficient> shape;  ///< the first coefficients, where they have a range
  KalibrLens kalibr;
  EurocLens euroc;
  KeyedLens camodocal;  ///< VINS
  KeyedLens basalt;     ///< relative to an element of value0.intrinsics
  /// @param coefficients  coefficient_count finite numbers
  std::unique_ptr<const LensModel> (*make)(const std::vector<double>& coefficients);
};

/// All lens models.
const std::vector<LensModelRow>& lens_models();

/// The row of a name. Throws OptionError that lists the known names.
const LensModelRow& lens_model(const std::string& name);

/// The row of a model whose coefficients a sensor_msgs/CameraInfo has; "" is the ideal lens. Throws OptionError that
/// lists those names, for the other models with the remedy.
const LensModelRow& camera_info_model(const std::string& name);

/// Their names in the table's order.
std::vector<std::string> lens_model_names();

/// The one rule for coefficients from any source: zeros at the end may be missing, and there may be too many.
/// Throws OptionError with the model, the count and what is allowed for coefficients that the model does not have, for
/// too few, and for those that are not finite or out of range.
void require_coefficients(const LensModelRow& model, const std::vector<double>& coefficients);

/// A lens. Throws what require_coefficients() throws.
std::unique_ptr<const LensModel> make_lens(const LensModelRow& model, std::vector<double> coefficients);

}  // namespace gyro_deblur
