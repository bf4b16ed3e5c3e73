// Projection of fisheyes and mirrors.
#include "motion/sphere_lenses.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Geometry>

namespace gyro_deblur {
namespace {

const Eigen::Vector2d kInvalid = Eigen::Vector2d::Constant(kNan);

/// (x/z, y/z) of a ray; NaN outside of the cone about the optical axis, and for rays that are not in front of the image
/// plane, which these coordinates cannot express.
Eigen::Vector2d in_front(const Eigen::Vector3d& ray, double max_angle_rad) {
  if (!(ray.z() > 0) || !(std::atan2(ray.head<2>().norm(), ray.z()) <= max_angle_rad)) return kInvalid;
  return ray.hnormalized();
}

/// The weight w of the valid range z > -w d of a unified model.
double range_weight(double alpha) { return alpha <= 0.5 ? alpha / (1 - alpha) : (1 - alpha) / alpha; }

class DoubleSphere : public LensModel {
 public:
  DoubleSphere(double xi, double alpha) : xi_(xi), alpha_(alpha) {
    const double w1 = range_weight(alpha);
    // Usenko et al., equation 43. It is where the projection ends for w1 = 1 and xi = 0, and near it otherwise. The
    // exact end is where the ray from the second sphere meets that sphere's own range, z2 > -w1 d2.
    const double w2 = (w1 + xi) / std::sqrt(2 * w1 * xi + xi * xi + 1);
    const double exact = xi * (1 - w1 * w1) + w1 * std::sqrt(1 - xi * xi * (1 - w1 * w1));
    const double min_cosine = -std::min(w2, exact);
    max_angle_rad_ = min_cosine > 0 ? std::acos(std::min(1.0, min_cosine)) : kHalfPi;
  }

  double max_angle_rad() const override { return max_angle_rad_; }

  Eigen::Vector2d project(const Eigen::Vector2d& undistorted) const override {
    if (!(std::atan(undistorted.norm()) <= max_angle_rad_)) return kInvalid;
    const double d1 = std::sqrt(undistorted.squaredNorm() + 1);
    const double z2 = xi_ * d1 + 1;
    const double d2 = std::sqrt(undistorted.squaredNorm() + z2 * z2);
    return undistorted / (alpha_ * d2 + (1 - alpha_) * z2);
  }

  Eigen::Vector2d unproject(const Eigen::Vector2d& distorted, double /*focal_px*/) const override {
    const double r2 = distorted.squaredNorm();
    const double root = 1 - (2 * alpha_ - 1) * r2;
    if (!std::isfinite(r2) || root < 0) return kInvalid;
    // The ray from the second sphere's centre, and where it meets the first sphere.
    const double mz = (1 - alpha_ * alpha_ * r2) / (alpha_ * std::sqrt(root) + 1 - alpha_);
    const double on_sphere = (mz * xi_ + std::sqrt(mz * mz + (1 - xi_ * xi_) * r2)) / (mz * mz + r2);
    return in_front({on_sphere * distorted.x(), on_sphere * distorted.y(), on_sphere * mz - xi_}, max_angle_rad_);
  }

 private:
  double xi_, alpha_, max_angle_rad_;
};

class ExtendedUnified : public LensModel {
 public:
  ExtendedUnified(double alpha, double beta) : alpha_(alpha), beta_(beta) {}

  // The valid range, z > -w d with w >= 0, has all rays in front of the image plane.
  double max_angle_rad() const override { return kHalfPi; }

  Eigen::Vector2d project(const Eigen::Vector2d& undistorted) const override {
    const double d = std::sqrt(beta_ * undistorted.squaredNorm() + 1);
    if (!std::isfinite(d)) return kInvalid;
    return undistorted / (alpha_ * d + 1 - alpha_);
  }

  Eigen::Vector2d unproject(const Eigen::Vector2d& distorted, double /*focal_px*/) const override {
    const double r2 = beta_ * distorted.squaredNorm();
    const double root = 1 - (2 * alpha_ - 1) * r2;
    if (!std::isfinite(r2) || root < 0) return kInvalid;
    const double mz = (1 - alpha_ * alpha_ * r2) / (alpha_ * std::sqrt(root) + 1 - alpha_);
    return in_front({distorted.x(), distorted.y(), mz}, kHalfPi);
  }

 private:
  double alpha_, beta_;
};

class Mei : public LensModel {
 public:
  /// @param plane  the distortion of the plane that the sphere is projected to
  Mei(double xi, std::unique_ptr<const LensModel> plane) : xi_(xi), plane_(std::move(plane)) {
    // With xi >= 0 the sphere's range, z > -min(xi, 1 / xi) d, has all rays in front of the image plane.
    if (plane_->max_angle_rad() >= kHalfPi) return;
    const Eigen::Vector3d ray = lift({std::tan(plane_->max_angle_rad()), 0});
    if (ray.z() > 0) max_angle_rad_ = std::atan2(ray.x(), ray.z());
  }

  double max_angle_rad() const override { return max_angle_rad_; }

  Eigen::Vector2d project(const Eigen::Vector2d& undistorted) const override {
    if (!(std::atan(undistorted.norm()) <= max_angle_rad_)) return kInvalid;
    return plane_->project(undistorted / (1 + xi_ * std::sqrt(undistorted.squaredNorm() + 1)));
  }

  Eigen::Vector2d unproject(const Eigen::Vector2d& distorted, double focal_px) const override {
    return in_front(lift(plane_->unproject(distorted, focal_px)), max_angle_rad_);
  }

 private:
  /// From the plane to the sphere, whose centre is xi before the centre of projection; NaN for a point that no ray
  /// reaches.
  Eigen::Vector3d lift(const Eigen::Vector2d& plane) const {
    const double r2 = plane.squaredNorm();
    const double on_sphere = (xi_ + std::sqrt(1 + (1 - xi_ * xi_) * r2)) / (r2 + 1);
    return {on_sphere * plane.x(), on_sphere * plane.y(), on_sphere - xi_};
  }

  double xi_;
  std::unique_ptr<const LensModel> plane_;
  double max_angle_rad_ = kHalfPi;
};

}  // namespace

std::unique_ptr<const LensModel> make_double_sphere(const std::vector<double>& c) {
  return std::make_unique<DoubleSphere>(c[0], c[1]);
}

std::unique_ptr<const LensModel> make_extended_unified(const std::vector<double>& c) {
  return std::make_unique<ExtendedUnified>(c[0], c[1]);
}

std::unique_ptr<const LensModel> make_mei(const std::vector<double>& c) {
  return std::make_unique<Mei>(c[0], make_lens(lens_model("plumb_bob"), {c[1], c[2], c[3], c[4]}));
}

}  // namespace gyro_deblur
