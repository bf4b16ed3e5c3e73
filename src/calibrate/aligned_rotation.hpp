// Rotations between directions, and between rates, in closed form.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Rotation vector [rad] of a rotation matrix.
Eigen::Vector3d log_rotation(const Eigen::Matrix3d& R);

/// The rotation R that minimises sum of weight |b - R a|^2 (Wahba's problem; Markley's SVD solution).
/// @param moment  sum of weight * b a^T
Eigen::Matrix3d solve_wahba(const Eigen::Matrix3d& moment);

/// The largest value of trace(R^T moment) over all rotations R.
double wahba_trace(const Eigen::Matrix3d& moment);

/// Weights of Cauchy's loss, whose scale follows the errors.
/// @param least_scale  > 0
std::vector<double> cauchy_weights(const std::vector<double>& errors, double least_scale = 1e-6);

/// The rotation that takes vectors to others. Weights keep what disagrees from counting.
/// @param moment  [out] of solve_wahba(), with the last weights; not written if null
Eigen::Matrix3d robust_rotation(const std::vector<Eigen::Vector3d>& from, const std::vector<Eigen::Vector3d>& to,
                                int iterations = 5, Eigen::Matrix3d* moment = nullptr);

}  // namespace gyro_deblur
