// Fits a plane to the velocities of corners.
#include "features/velocity_plane.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "features/robust_weight.hpp"

namespace gyro_deblur {
namespace {

/// Weighted median of one component.
double median_of(const std::vector<NearbyVelocity>& neighbours, int axis) {
  std::vector<std::pair<double, double>> values;
  double half = 0;
  for (const NearbyVelocity& neighbour : neighbours) {
    values.emplace_back(neighbour.velocity_px_s[axis], neighbour.nearness);
    half += neighbour.nearness / 2;
  }
  std::sort(values.begin(), values.end());
  for (const auto& [value, nearness] : values) {
    half -= nearness;
    if (half <= 0) return value;
  }
  return values.back().first;
}

}  // namespace

VelocityPlane fit_plane(const std::vector<NearbyVelocity>& velocities, int iterations, double slope_prior) {
  VelocityPlane plane;
  plane.coefficients.row(0) = Eigen::RowVector2d(median_of(velocities, 0), median_of(velocities, 1));
  double reach_px2 = 0;
  for (const NearbyVelocity& near : velocities) reach_px2 = std::max(reach_px2, near.distance_px2);
  Eigen::Matrix3d normal = Eigen::Matrix3d::Identity(), squares = Eigen::Matrix3d::Zero();
  std::vector<double> distances(velocities.size());
  double inlier_weight = 0;
  for (int iteration = 0;; ++iteration) {
    for (std::size_t k = 0; k < velocities.size(); ++k) {
      distances[k] = (velocities[k].velocity_px_s - plane.at(velocities[k].from_center_px)).norm();
    }
    plane.spread_px_s = spread_of(distances);
    if (iteration == iterations) break;
    normal.setZero();
    squares.setZero();
    inlier_weight = 0;
    // A slope is used where the corners show it.
    normal(1, 1) = normal(2, 2) = slope_prior * reach_px2;
    Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
    for (std::size_t k = 0; k < velocities.size(); ++k) {
      const Eigen::Vector3d row(1, velocities[k].from_center_px.x(), velocities[k].from_center_px.y());
      const double inlier = robust_weight(distances[k], plane.spread_px_s), weight = inlier * velocities[k].nearness;
      inlier_weight += inlier;
      normal += weight * row * row.transpose();
      squares += weight * weight * row * row.transpose();
      right += weight * row * velocities[k].velocity_px_s.transpose();
    }
    plane.coefficients = normal.ldlt().solve(right);
  }
  // Three corners lie on a plane whatever they say.
  constexpr double kParameters = 3, kLeastFreedom = 0.5;
  const double freedom = std::max(inlier_weight - kParameters, kLeastFreedom);
  const Eigen::Matrix3d inverse = normal.inverse();
  plane.stddev_px_s = plane.spread_px_s * std::sqrt((inverse * squares * inverse)(0, 0) * inlier_weight / freedom);
  return plane;
}

double seen_from_px(const VelocityPlane& plane, const std::vector<NearbyVelocity>& velocities) {
  constexpr std::size_t kSeenBy = 3;
  constexpr double kShows = 0.5;  // of the weight of one that shows exactly this
  std::vector<double> distances_px2;
  double farthest_px2 = 0;
  for (const NearbyVelocity& near : velocities) {
    farthest_px2 = std::max(farthest_px2, near.distance_px2);
    const double off_px_s = (near.velocity_px_s - plane.at(near.from_center_px)).norm();
    if (robust_weight(off_px_s, plane.spread_px_s) > kShows) distances_px2.push_back(near.distance_px2);
  }
  if (distances_px2.size() < kSeenBy) return std::sqrt(farthest_px2);
  std::nth_element(distances_px2.begin(), distances_px2.begin() + kSeenBy - 1, distances_px2.end());
  return std::sqrt(distances_px2[kSeenBy - 1]);
}

}  // namespace gyro_deblur
