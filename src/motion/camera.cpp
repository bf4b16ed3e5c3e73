#include "gyro_deblur/camera.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kHalfPi = 1.57079632679489661923;

using Polynomial = std::array<double, 5>;

struct ValueAndSlope {
  double value, slope;
};

ValueAndSlope evaluate(const Polynomial& p, double s) {
  ValueAndSlope result{0, 0};
  for (std::size_t i = p.size(); i-- > 0;) {
    result.slope = result.slope * s + result.value;
    result.value = result.value * s + p[i];
  }
  return result;
}

/// Radial factor n(s) / d(s) and its derivative by s. NaN where the denominator has crossed its pole.
ValueAndSlope radial_factor(const Polynomial& n, const Polynomial& d, double s) {
  const ValueAndSlope num = evaluate(n, s);
  const ValueAndSlope den = evaluate(d, s);
  if (!(den.value > 0)) return {kNan, kNan};
  const double factor = num.value / den.value;
  return {factor, (num.slope - factor * den.slope) / den.value};
}

/// u * factor(u^2), the distorted radius (or angle), and its derivative.
ValueAndSlope radial_curve(const Polynomial& n, const Polynomial& d, double u) {
  const ValueAndSlope factor = radial_factor(n, d, u * u);
  return {u * factor.value, factor.value + 2 * u * u * factor.slope};
}

/// Where the radial curve stops increasing; infinity (equidistant: pi/2) when it never does.
double monotone_limit(const Polynomial& n, const Polynomial& d, bool is_angle) {
  const auto increases = [&](double u) { return radial_curve(n, d, u).slope > 0; };
  // Steps of an angle from the axis, up to 89.99 degrees: every range a perspective image can use.
  constexpr int kSteps = 9000;
  constexpr double kLastAngleRad = kHalfPi * 0.9999;
  double inside = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double angle_rad = kLastAngleRad * i / kSteps;
    double outside = is_angle ? angle_rad : std::tan(angle_rad);
    if (increases(outside)) {
      inside = outside;
      continue;
    }
    for (int bisection = 0; bisection < 60; ++bisection) {
      const double middle = 0.5 * (inside + outside);
      (increases(middle) ? inside : outside) = middle;
    }
    return inside;
  }
  return is_angle ? kHalfPi : std::numeric_limits<double>::infinity();
}

/// Inverts the radial curve, which increases on [0, limit], by Newton steps safeguarded by bisection.
/// Values beyond the curve's end give NaN.
double invert_radial_curve(const Polynomial& n, const Polynomial& d, double limit, double target) {
  if (target == 0) return 0;
  double low = 0;
  double high = limit;
  if (std::isinf(limit)) {
    constexpr double kLargestRadius = 1e6;  // a ten thousandth of a degree from the image plane
    for (high = target; radial_curve(n, d, high).value < target; high *= 2) {
      if (high > kLargestRadius) return kNan;
    }
  } else if (!(radial_curve(n, d, high).value >= target)) {
    return kNan;
  }
  double u = std::min(target, high);
  for (int iteration = 0; iteration < 100; ++iteration) {
    const ValueAndSlope curve = radial_curve(n, d, u);
    const double error = curve.value - target;
    (error < 0 ? low : high) = u;
    double next = u - error / curve.slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    const double step = std::abs(next - u);
    u = next;
    if (step <= 4 * std::numeric_limits<double>::epsilon() * u) break;
  }
  return u;
}

}  // namespace

DistortionModel parse_distortion_model(const std::string& name) {
  if (name.empty() || name == "none") return DistortionModel::NONE;
  if (name == "plumb_bob") return DistortionModel::PLUMB_BOB;
  if (name == "rational_polynomial") return DistortionModel::RATIONAL_POLYNOMIAL;
  if (name == "equidistant") return DistortionModel::EQUIDISTANT;
  throw OptionError("distortion_model = \"" + name + "\" is not one of plumb_bob rational_polynomial equidistant none");
}

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
  const std::size_t count = coefficients.size();
  const auto require_count = [count](bool ok, const char* model_name, const char* allowed) {
    if (ok) return;
    throw OptionError("camera distortion has " + std::to_string(count) + " coefficients; " + model_name + " takes " +
                      allowed);
  };
  switch (model) {
    case DistortionModel::NONE:
      require_count(count == 0, "no model", "0");
      break;
    case DistortionModel::PLUMB_BOB:
      require_count(count == 0 || count == 4 || count == 5, "plumb_bob", "0, 4 or 5");
      break;
    case DistortionModel::RATIONAL_POLYNOMIAL:
      require_count(count == 8, "rational_polynomial", "8");
      break;
    case DistortionModel::EQUIDISTANT:
      require_count(count == 4, "equidistant", "4");
      break;
  }
  for (const double coefficient : coefficients) {
    require_range("camera distortion coefficient", coefficient, -largest, largest);
  }
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
  const std::vector<double>& k = calibration.coefficients;
  switch (calibration.model) {
    case DistortionModel::NONE:
      break;
    case DistortionModel::PLUMB_BOB:
      if (k.empty()) break;
      numerator_ = {1, k[0], k[1], k.size() > 4 ? k[4] : 0, 0};
      p1_ = k[2];
      p2_ = k[3];
      break;
    case DistortionModel::RATIONAL_POLYNOMIAL:
      numerator_ = {1, k[0], k[1], k[4], 0};
      denominator_ = {1, k[5], k[6], k[7], 0};
      p1_ = k[2];
      p2_ = k[3];
      break;
    case DistortionModel::EQUIDISTANT:
      numerator_ = {1, k[0], k[1], k[2], k[3]};
      break;
  }
  limit_ = monotone_limit(numerator_, denominator_, calibration.model == DistortionModel::EQUIDISTANT);
}

Eigen::Vector2d Camera::distort(const Eigen::Vector2d& normalized, Eigen::Matrix2d* jacobian) const {
  const double x = normalized.x(), y = normalized.y();
  if (calibration_.model == DistortionModel::EQUIDISTANT) {
    const double r = normalized.norm();
    const double angle_rad = std::atan(r);
    if (!(angle_rad <= limit_)) return {kNan, kNan};
    if (r == 0) return normalized;
    return radial_curve(numerator_, denominator_, angle_rad).value / r * normalized;
  }
  const double r2 = x * x + y * y;
  if (!(r2 <= limit_ * limit_)) return {kNan, kNan};
  const ValueAndSlope factor = radial_factor(numerator_, denominator_, r2);
  if (jacobian != nullptr) {
    const double mixed = 2 * (x * y * factor.slope + p1_ * x + p2_ * y);
    *jacobian << factor.value + 2 * x * x * factor.slope + 2 * p1_ * y + 6 * p2_ * x, mixed,  //
        mixed, factor.value + 2 * y * y * factor.slope + 6 * p1_ * y + 2 * p2_ * x;
  }
  return {x * factor.value + 2 * p1_ * x * y + p2_ * (r2 + 2 * x * x),
          y * factor.value + p1_ * (r2 + 2 * y * y) + 2 * p2_ * x * y};
}

Eigen::Vector2d Camera::undistort(const Eigen::Vector2d& distorted) const {
  Eigen::Vector2d invalid(kNan, kNan);
  if (!distorted.allFinite()) return invalid;
  const double distorted_radius = distorted.norm();
  if (distorted_radius == 0 && p1_ == 0 && p2_ == 0) return distorted;
  const double radial = invert_radial_curve(numerator_, denominator_, limit_, distorted_radius);
  if (calibration_.model == DistortionModel::EQUIDISTANT) {
    if (!(radial < kHalfPi)) return invalid;
    return std::tan(radial) / distorted_radius * distorted;
  }
  if (p1_ == 0 && p2_ == 0) return radial / distorted_radius * distorted;

  // The radial solution starts a two-dimensional Newton iteration, near the end of the range just inside it. Steps are
  // halved until the error falls, so that it cannot jump onto the folded part of the model.
  const double start_radius = std::isfinite(radial) ? radial : 0.999 * limit_;
  if (!std::isfinite(start_radius)) return invalid;
  Eigen::Vector2d estimate =
      distorted_radius == 0 ? distorted : Eigen::Vector2d(start_radius / distorted_radius * distorted);
  Eigen::Matrix2d jacobian;
  Eigen::Vector2d error = distort(estimate, &jacobian) - distorted;
  const double pixel_per_unit = std::max(calibration_.fx_px, calibration_.fy_px);
  constexpr double kDonePx = 1e-10;     // a step below this ends the iteration
  constexpr double kAcceptedPx = 1e-7;  // largest error of an answer, when projected again
  constexpr int kMaxIterations = 50, kMaxHalvings = 30;
  for (int iteration = 0; iteration < kMaxIterations && error.norm() * pixel_per_unit > kDonePx; ++iteration) {
    const double determinant = jacobian.determinant();
    if (!(determinant > 0)) return invalid;
    Eigen::Vector2d step(jacobian(1, 1) * error.x() - jacobian(0, 1) * error.y(),
                         jacobian(0, 0) * error.y() - jacobian(1, 0) * error.x());
    step /= determinant;
    bool improved = false;
    for (int halving = 0; halving < kMaxHalvings && !improved; ++halving, step *= 0.5) {
      Eigen::Matrix2d next_jacobian;
      const Eigen::Vector2d next = estimate - step;
      const Eigen::Vector2d next_error = distort(next, &next_jacobian) - distorted;
      if (!(next_error.norm() < error.norm())) continue;  // not so for NaN either
      estimate = next;
      error = next_error;
      jacobian = next_jacobian;
      improved = true;
    }
    if (!improved) break;
  }
  if (!(error.norm() * pixel_per_unit <= kAcceptedPx) || !(jacobian.determinant() > 0)) return invalid;
  return estimate;
}

Eigen::Vector3d Camera::ray(const Eigen::Vector2d& pixel_px) const {
  const Eigen::Vector2d distorted((pixel_px.x() - calibration_.cx_px) / calibration_.fx_px,
                                  (pixel_px.y() - calibration_.cy_px) / calibration_.fy_px);
  const Eigen::Vector3d direction = R_image_cam_.transpose() * undistort(distorted).homogeneous();
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
  const Eigen::Vector2d distorted = distort(in_image.hnormalized(), nullptr);
  return {calibration_.fx_px * distorted.x() + calibration_.cx_px,
          calibration_.fy_px * distorted.y() + calibration_.cy_px};
}

}  // namespace gyro_deblur
