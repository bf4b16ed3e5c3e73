// Distortion of each lens model and its inverse.
#include "motion/lens_models.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/LU>

#include "base/format.hpp"
#include "base/join.hpp"
#include "base/require_range.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/options.hpp"
#include "motion/sphere_lenses.hpp"

namespace gyro_deblur {
namespace {

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

/// How far from the axis a ray comes out that goes in at u: u * n(u^2) / d(u^2). u is a radius or an angle.
struct RadialCurve {
  Polynomial numerator{1, 0, 0, 0, 0};
  Polynomial denominator{1, 0, 0, 0, 0};
  bool is_polynomial = denominator == Polynomial{1, 0, 0, 0, 0};

  /// n(s) / d(s) and its derivative by s. NaN where the denominator has crossed its pole.
  ValueAndSlope factor(double s) const {
    const ValueAndSlope num = evaluate(numerator, s);
    if (is_polynomial) return num;
    const ValueAndSlope den = evaluate(denominator, s);
    if (!(den.value > 0)) return {kNan, kNan};
    const double factor = num.value / den.value;
    return {factor, (num.slope - factor * den.slope) / den.value};
  }

  /// The distorted radius (or angle), and its derivative by u.
  ValueAndSlope at(double u) const {
    const ValueAndSlope f = factor(u * u);
    return {u * f.value, f.value + 2 * u * u * f.slope};
  }

  bool increases(double u) const { return at(u).slope > 0; }
};

/// Where the curve stops increasing; infinity (of an angle: pi/2) when it never does.
double monotone_limit(const RadialCurve& curve, bool is_angle) {
  // Steps of an angle from the axis, up to 89.99 degrees: every range a perspective image can use.
  constexpr int kSteps = 9000;
  constexpr double kLastAngleRad = kHalfPi * 0.9999;
  double inside = 0;
  for (int i = 1; i <= kSteps; ++i) {
    const double angle_rad = kLastAngleRad * i / kSteps;
    double outside = is_angle ? angle_rad : std::tan(angle_rad);
    if (curve.increases(outside)) {
      inside = outside;
      continue;
    }
    for (int bisection = 0; bisection < 60; ++bisection) {
      const double middle = 0.5 * (inside + outside);
      (curve.increases(middle) ? inside : outside) = middle;
    }
    return inside;
  }
  return is_angle ? kHalfPi : std::numeric_limits<double>::infinity();
}

/// Inverts the curve, which increases on [0, limit], by Newton steps safeguarded by bisection.
/// Values beyond the curve's end give NaN.
/// @param done  relative; a step below this is the last
double invert(const RadialCurve& curve, double limit, double target,
              double done = 4 * std::numeric_limits<double>::epsilon()) {
  if (target == 0) return 0;
  double low = 0;
  double high = limit;
  if (std::isinf(limit)) {
    constexpr double kLargestRadius = 1e6;  // a ten thousandth of a degree from the image plane
    for (high = target; curve.at(high).value < target; high *= 2) {
      if (high > kLargestRadius) return kNan;
    }
  } else if (!(curve.at(high).value >= target)) {
    return kNan;
  }
  double u = std::min(target, high);
  for (int iteration = 0; iteration < 100; ++iteration) {
    const ValueAndSlope point = curve.at(u);
    const double error = point.value - target;
    double next = u - error / point.slope;
    // Rounding may lead the last step out of the bracket: bisection would begin again from the bracket's other end.
    if (std::abs(next - u) <= done * u) return std::clamp(next, low, high);
    (error < 0 ? low : high) = u;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    const double step = std::abs(next - u);
    u = next;
    if (step <= done * u) break;
  }
  return u;
}

/// Radial distortion of the radius with a rational factor, and tangential distortion: OpenCV's model. By itself,
/// without coefficients, the ideal lens.
class RadialTangential : public LensModel {
 public:
  explicit RadialTangential(const std::vector<double>& = {}) : RadialTangential(RadialCurve{}, 0, 0) {}

  double max_angle_rad() const override { return std::atan(limit_); }

  Eigen::Vector2d project(const Eigen::Vector2d& undistorted) const override { return distort(undistorted, nullptr); }

  Eigen::Vector2d unproject(const Eigen::Vector2d& distorted, double focal_px) const override {
    const Eigen::Vector2d invalid(kNan, kNan);
    if (!distorted.allFinite()) return invalid;
    const double distorted_radius = distorted.norm();
    const bool only_radial = p1_ == 0 && p2_ == 0;
    if (distorted_radius == 0 && only_radial) return distorted;
    if (only_radial) return invert(curve_, limit_, distorted_radius) / distorted_radius * distorted;

    // The radial solution starts a two-dimensional search, near the end of the range just inside it. A last step of a
    // hundredth has an error of about its square, as small as what tangential distortion adds.
    constexpr double kStart = 1e-2;
    const double radius = invert(curve_, limit_, distorted_radius, kStart);
    const double start_radius = std::isfinite(radius) ? radius : 0.999 * limit_;
    if (!std::isfinite(start_radius)) return invalid;
    return refine(distorted_radius == 0 ? distorted : Eigen::Vector2d(start_radius / distorted_radius * distorted),
                  distorted, focal_px);
  }

 protected:
  RadialTangential(const RadialCurve& curve, double p1, double p2)
      : curve_(curve), p1_(p1), p2_(p2), limit_(monotone_limit(curve, false)) {}

 private:
  Eigen::Vector2d distort(const Eigen::Vector2d& undistorted, Eigen::Matrix2d* jacobian) const {
    const double x = undistorted.x(), y = undistorted.y();
    const double r2 = x * x + y * y;
    if (!(r2 <= limit_ * limit_)) return {kNan, kNan};
    const ValueAndSlope factor = curve_.factor(r2);
    if (jacobian != nullptr) {
      const double mixed = 2 * (x * y * factor.slope + p1_ * x + p2_ * y);
      *jacobian << factor.value + 2 * x * x * factor.slope + 2 * p1_ * y + 6 * p2_ * x, mixed,  //
          mixed, factor.value + 2 * y * y * factor.slope + 6 * p1_ * y + 2 * p2_ * x;
    }
    return {x * factor.value + 2 * p1_ * x * y + p2_ * (r2 + 2 * x * x),
            y * factor.value + p1_ * (r2 + 2 * y * y) + 2 * p2_ * x * y};
  }

  /// Inverts distort() by Newton steps from an estimate. They are halved until the error falls, so that none jumps onto
  /// the folded part of the model.
  Eigen::Vector2d refine(Eigen::Vector2d estimate, const Eigen::Vector2d& distorted, double focal_px) const {
    const Eigen::Vector2d invalid(kNan, kNan);
    Eigen::Matrix2d jacobian;
    Eigen::Vector2d error = distort(estimate, &jacobian) - distorted;
    constexpr double kDonePx = 1e-10;     // an error below this ends the iteration
    constexpr double kAcceptedPx = 1e-7;  // largest error of an answer, when projected again
    constexpr int kMaxIterations = 50, kMaxHalvings = 30;
    for (int iteration = 0; iteration < kMaxIterations && error.norm() * focal_px > kDonePx; ++iteration) {
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
    if (!(error.norm() * focal_px <= kAcceptedPx) || !(jacobian.determinant() > 0)) return invalid;
    return estimate;
  }

  RadialCurve curve_;
  double p1_, p2_;  // tangential
  double limit_;    // undistorted radius up to which the curve increases
};

/// k1 k2 p1 p2 k3.
class PlumbBob : public RadialTangential {
 public:
  explicit PlumbBob(const std::vector<double>& k) : RadialTangential({{1, k[0], k[1], k[4], 0}}, k[2], k[3]) {}
};

/// k1 k2 p1 p2 k3 k4 k5 k6.
class RationalPolynomial : public RadialTangential {
 public:
  explicit RationalPolynomial(const std::vector<double>& k)
      : RadialTangential({{1, k[0], k[1], k[4], 0}, {1, k[5], k[6], k[7], 0}}, k[2], k[3]) {}
};

/// k1 k2 k3 k4: the distorted radius is a polynomial of the angle from the axis (OpenCV's fisheye, Kannala and Brandt).
class Equidistant : public LensModel {
 public:
  explicit Equidistant(const std::vector<double>& k)
      : curve_{{1, k[0], k[1], k[2], k[3]}}, limit_rad_(monotone_limit(curve_, true)) {}

  double max_angle_rad() const override { return limit_rad_; }

  Eigen::Vector2d project(const Eigen::Vector2d& undistorted) const override {
    const double r = undistorted.norm();
    const double angle_rad = std::atan(r);
    if (!(angle_rad <= limit_rad_)) return {kNan, kNan};
    if (r == 0) return undistorted;
    return curve_.at(angle_rad).value / r * undistorted;
  }

  Eigen::Vector2d unproject(const Eigen::Vector2d& distorted, double /*focal_px*/) const override {
    if (!distorted.allFinite()) return {kNan, kNan};
    const double distorted_radius = distorted.norm();
    if (distorted_radius == 0) return distorted;
    const double angle_rad = invert(curve_, limit_rad_, distorted_radius);
    if (!(angle_rad < kHalfPi)) return {kNan, kNan};
    return std::tan(angle_rad) / distorted_radius * distorted;
  }

 private:
  RadialCurve curve_;  // of the angle
  double limit_rad_;   // up to which it increases
};

template <typename Model>
std::unique_ptr<const LensModel> make(const std::vector<double>& coefficients) {
  return std::make_unique<Model>(coefficients);
}

LensModelRow row(const char* name, bool is_in_camera_info, std::size_t coefficient_count, std::size_t fewest_given,
                 const std::vector<ShapeCoefficient>& shape, const KalibrLens& kalibr, const EurocLens& euroc,
                 const KeyedLens& camodocal, const KeyedLens& basalt, decltype(LensModelRow::make) make_model) {
  return {name,   is_in_camera_info, coefficient_count, fewest_given, shape, kalibr, euroc, camodocal,
          basalt, make_model};
}

/// The table, whose rows a row's documentation explains.
std::vector<LensModelRow> make_table() {
  constexpr double kLargest = std::numeric_limits<double>::max();
  constexpr double kSmallest = std::numeric_limits<double>::min();
  const std::array<std::string, 4> kBasalt{"intrinsics.fx", "intrinsics.fy", "intrinsics.cx", "intrinsics.cy"};
  const auto in = [](const std::string& section, std::vector<std::string> keys) {
    for (std::string& key : keys) key = section + "." + key;
    return keys;
  };
  const auto projection = [](const char* fx, const char* fy, const char* cx, const char* cy) {
    const std::string section = "projection_parameters.";
    return std::array<std::string, 4>{section + fx, section + fy, section + cx, section + cy};
  };
  return {
      row("plumb_bob", true, 5,
          0,  // drivers of uncalibrated and simulated cameras send none
          {}, {"pinhole", "radtan", 0, 4}, {"radial-tangential", 4},
          {"PINHOLE", projection("fx", "fy", "cx", "cy"), in("distortion_parameters", {"k1", "k2", "p1", "p2"})}, {},
          make<PlumbBob>),
      row("rational_polynomial", true, 8, 0, {}, {}, {}, {},
          {"pinhole-radtan8", kBasalt, in("intrinsics", {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"})},
          make<RationalPolynomial>),
      row("equidistant", true, 4,
          1,  // without any it would still be no ideal lens
          {}, {"pinhole", "equidistant", 0, 4}, {"equidistant", 4},
          // Its k2 to k5 are OpenCV's k1 to k4 of the same polynomial.
          {"KANNALA_BRANDT", projection("mu", "mv", "u0", "v0"), in("projection_parameters", {"k2", "k3", "k4", "k5"})},
          {"kb4", kBasalt, in("intrinsics", {"k1", "k2", "k3", "k4"})}, make<Equidistant>),
      row("ds", false, 2, 2, {{"xi", -1, 1}, {"alpha", 0, 1}}, {"ds", "none", 2, 0}, {}, {},
          {"ds", kBasalt, in("intrinsics", {"xi", "alpha"})}, make_double_sphere),
      row("eucm", false, 2, 2, {{"alpha", 0, 1}, {"beta", kSmallest, kLargest}}, {"eucm", "none", 2, 0}, {}, {},
          {"eucm", kBasalt, in("intrinsics", {"alpha", "beta"})}, make_extended_unified),
      row("mei", false, 5, 1, {{"xi", 0, kLargest}}, {"omni", "radtan", 1, 4}, {},
          {"MEI",
           projection("gamma1", "gamma2", "u0", "v0"),
           {"mirror_parameters.xi", "distortion_parameters.k1", "distortion_parameters.k2", "distortion_parameters.p1",
            "distortion_parameters.p2"}},
          {}, make_mei),
      row("none", true, 0, 0, {}, {"pinhole", "none", 0, 0}, {}, {}, {"pinhole", kBasalt, {}}, make<RadialTangential>),
  };
}

}  // namespace

const std::vector<LensModelRow>& lens_models() {
  static const std::vector<LensModelRow> kModels = make_table();
  return kModels;
}

const LensModelRow& lens_model(const std::string& name) {
  for (const LensModelRow& row : lens_models()) {
    if (row.name == name) return row;
  }
  std::string names;
  for (const std::string& known : lens_model_names()) names += " " + known;
  throw OptionError("distortion_model = \"" + name + "\" is not one of" + names);
}

const LensModelRow& camera_info_model(const std::string& name) {
  const std::string model = require_distortion_model(name);  // named, or GCC 13 and later fear for the reference
  const LensModelRow& row = lens_model(model);
  if (row.is_in_camera_info) return row;
  std::string names;
  for (const LensModelRow& known : lens_models()) {
    if (known.is_in_camera_info) names += " " + known.name;
  }
  throw OptionError("distortion_model = \"" + name +
                    "\" has no coefficients in a camera_info, which can have those of" + names +
                    ": set calibration_file to the file that the lens was calibrated with");
}

std::vector<std::string> lens_model_names() {
  std::vector<std::string> names;
  for (const LensModelRow& row : lens_models()) names.push_back(row.name);
  return names;
}

void require_coefficients(const LensModelRow& model, const std::vector<double>& coefficients) {
  const auto refuse = [&](const std::string& what) {
    throw OptionError("camera distortion has " + std::to_string(coefficients.size()) + " coefficients, but " +
                      model.name + " has " + std::to_string(model.coefficient_count) + what);
  };
  if (coefficients.size() < model.fewest_given) {
    std::vector<std::string> names;
    for (const ShapeCoefficient& coefficient : model.shape) names.push_back(coefficient.name);
    refuse(names.empty() ? ", of which the first has to be given"
                         : ", of which " + join(names, "and") + " have to be given");
  }
  constexpr double kLargest = std::numeric_limits<double>::max();
  for (std::size_t i = 0; i < coefficients.size(); ++i) {
    const std::string name = "camera distortion coefficient " + std::to_string(i + 1);
    if (i < model.shape.size()) {
      const ShapeCoefficient& shape = model.shape[i];
      require_range((name + " (" + shape.name + " of " + model.name + ")").c_str(), coefficients[i], shape.min,
                    shape.max);
    } else {
      require_range(name.c_str(), coefficients[i], -kLargest, kLargest);
    }
    if (i < model.coefficient_count || coefficients[i] == 0) continue;
    refuse(format(": number %zu is %g, where only zeros are allowed", i + 1, coefficients[i]));
  }
}

std::unique_ptr<const LensModel> make_lens(const LensModelRow& model, std::vector<double> coefficients) {
  require_coefficients(model, coefficients);
  coefficients.resize(model.coefficient_count, 0.0);
  return model.make(coefficients);
}

}  // namespace gyro_deblur
