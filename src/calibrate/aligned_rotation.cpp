// Rotations in closed form, robust against outliers.
#include "calibrate/aligned_rotation.hpp"

#include <algorithm>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

#include "base/median.hpp"

namespace gyro_deblur {

Eigen::Vector3d log_rotation(const Eigen::Matrix3d& R) {
  const Eigen::AngleAxisd rotation(R);
  return rotation.angle() * rotation.axis();
}

Eigen::Matrix3d solve_wahba(const Eigen::Matrix3d& moment) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(moment, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = svd.matrixU().determinant() * svd.matrixV().determinant();
  return svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
}

double wahba_trace(const Eigen::Matrix3d& moment) {
  const Eigen::Vector3d values = Eigen::JacobiSVD<Eigen::Matrix3d>(moment).singularValues();
  return values[0] + values[1] + (moment.determinant() < 0 ? -values[2] : values[2]);
}

std::vector<double> cauchy_weights(const std::vector<double>& errors, double least_scale) {
  const double scale = std::max(2 * median(errors), least_scale);
  std::vector<double> weights;
  weights.reserve(errors.size());
  for (const double error : errors) weights.push_back(1 / (1 + error * error / (scale * scale)));
  return weights;
}

Eigen::Matrix3d robust_rotation(const std::vector<Eigen::Vector3d>& from, const std::vector<Eigen::Vector3d>& to,
                                int iterations, Eigen::Matrix3d* moment) {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  std::vector<double> weights(from.size(), 1.0), errors(from.size());
  for (int iteration = 0; iteration < iterations; ++iteration) {
    Eigen::Matrix3d weighted = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < from.size(); ++i) weighted += weights[i] * to[i] * from[i].transpose();
    R = solve_wahba(weighted);
    for (std::size_t i = 0; i < from.size(); ++i) errors[i] = (to[i] - R * from[i]).norm();
    weights = cauchy_weights(errors);
    if (moment != nullptr) *moment = weighted;
  }
  return R;
}

}  // namespace gyro_deblur
