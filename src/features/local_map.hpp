// Where the neighbourhood of a point goes, to second order.
#pragma once

#include <Eigen/Core>

namespace gyro_deblur {

/// Takes an offset from a point in one image to the offset from it in another. A Jacobian alone is wrong by 0.1 px at
/// 20 px from a point when a camera with a focal length of 460 px rotates by 6 degrees, and to the same side all around
/// it.
struct LocalMap {
  /// Of x^2, x y and y^2 [1/px].
  using Bend = Eigen::Matrix<double, 2, 3>;

  Eigen::Matrix2d jacobian = Eigen::Matrix2d::Identity();
  Bend bend = Bend::Zero();

  LocalMap() = default;
  LocalMap(const Eigen::Matrix2d& of_affine) : jacobian(of_affine) {}  // NOLINT(google-explicit-constructor)
  LocalMap(const Eigen::Matrix2d& first_order, const Bend& second_order) : jacobian(first_order), bend(second_order) {}
};

/// The bend of a map, of what a linear map made of the offset.
inline LocalMap::Bend bend_after(const LocalMap::Bend& bend, const Eigen::Matrix2d& linear) {
  const double a = linear(0, 0), b = linear(0, 1), c = linear(1, 0), d = linear(1, 1);
  Eigen::Matrix3d squares;
  squares << a * a, 2 * a * b, b * b,  //
      a * c, a * d + b * c, b * d,     //
      c * c, 2 * c * d, d * d;
  return bend * squares;
}

/// First `first`, then `second`, to second order.
inline LocalMap combined(const LocalMap& second, const LocalMap& first) {
  return {second.jacobian * first.jacobian, second.jacobian * first.bend + bend_after(second.bend, first.jacobian)};
}

}  // namespace gyro_deblur
