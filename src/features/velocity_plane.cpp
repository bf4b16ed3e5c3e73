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

/// Weighted median of one component of the velocities.
float median_of(const std::vector<float>& values, const std::vector<float>& weights) {
  thread_local std::vector<std::pair<float, float>> weighted;
  weighted.resize(values.size());
  float half = 0;
  for (std::size_t k = 0; k < values.size(); ++k) {
    weighted[k] = {values[k], weights[k]};
    half += weights[k] / 2;
  }
  std::sort(weighted.begin(), weighted.end());
  for (const auto& [value, weight] : weighted) {
    half -= weight;
    if (half <= 0) return value;
  }
  return weighted.back().first;
}

/// How far the velocities are from a plane [px/s].
void take_distances(const NearbyVelocities& velocities, const Eigen::Matrix<double, 3, 2>& coefficients,
                    std::vector<float>* distances) {
  const Eigen::Matrix<float, 3, 2> plane = coefficients.cast<float>();
  const float x0 = plane(0, 0), xx = plane(1, 0), xy = plane(2, 0), y0 = plane(0, 1), yx = plane(1, 1),
              yy = plane(2, 1);
  distances->resize(velocities.size());
  const float *x = velocities.x_px.data(), *y = velocities.y_px.data(), *vx = velocities.x_px_s.data(),
              *vy = velocities.y_px_s.data();
  float* distance = distances->data();
  const auto count = static_cast<int>(velocities.size());
#pragma omp simd
  for (int k = 0; k < count; ++k) {
    const float off_x = vx[k] - (x0 + xx * x[k] + xy * y[k]), off_y = vy[k] - (y0 + yx * x[k] + yy * y[k]);
    distance[k] = std::sqrt(off_x * off_x + off_y * off_y);
  }
}

/// Normal equations of the corners' planes.
struct NormalEquations {
  Eigen::Matrix3d normal;   ///< with weights
  Eigen::Matrix3d squares;  ///< with their squares
  Eigen::Matrix<double, 3, 2> right;
  double inlier_weight = 0;  ///< sum of the weights that do not depend on the distance from the centre
};

Eigen::Matrix3d symmetric(float a, float b, float c, float d, float e, float f) {
  Eigen::Matrix3f matrix;
  matrix << a, b, c, b, d, e, c, e, f;
  return matrix.cast<double>();
}

/// @param per_px  unit of the corners' places: sums of squares keep their precision
NormalEquations equations_of(const NearbyVelocities& velocities, const std::vector<float>& distances, double spread,
                             float per_px) {
  const float *x_px = velocities.x_px.data(), *y_px = velocities.y_px.data(), *vx = velocities.x_px_s.data(),
              *vy = velocities.y_px_s.data(), *nearness = velocities.nearness.data(), *distance = distances.data();
  const auto count = static_cast<int>(velocities.size());
  float inliers = 0, w = 0, wx = 0, wy = 0, wxx = 0, wxy = 0, wyy = 0, s = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
  float u = 0, ux = 0, uy = 0, v = 0, vx_x = 0, vy_y = 0;
#pragma omp simd reduction(+ : inliers, w, wx, wy, wxx, wxy, wyy, s, sx, sy, sxx, sxy, syy, u, ux, uy, v, vx_x, vy_y)
  for (int k = 0; k < count; ++k) {
    const float inlier = robust_weight(distance[k], static_cast<float>(spread)), weight = inlier * nearness[k];
    const float x = per_px * x_px[k], y = per_px * y_px[k], square = weight * weight;
    inliers += inlier;
    w += weight;
    wx += weight * x;
    wy += weight * y;
    wxx += weight * x * x;
    wxy += weight * x * y;
    wyy += weight * y * y;
    s += square;
    sx += square * x;
    sy += square * y;
    sxx += square * x * x;
    sxy += square * x * y;
    syy += square * y * y;
    u += weight * vx[k];
    ux += weight * x * vx[k];
    uy += weight * y * vx[k];
    v += weight * vy[k];
    vx_x += weight * x * vy[k];
    vy_y += weight * y * vy[k];
  }
  Eigen::Matrix<float, 3, 2> right;
  right << u, v, ux, vx_x, uy, vy_y;
  return {symmetric(w, wx, wy, wxx, wxy, wyy), symmetric(s, sx, sy, sxx, sxy, syy), right.cast<double>(), inliers};
}

}  // namespace

void NearbyVelocities::set(std::size_t i, const Eigen::Vector2d& from_center_px, const Eigen::Vector2d& velocity_px_s) {
  x_px[i] = static_cast<float>(from_center_px.x());
  y_px[i] = static_cast<float>(from_center_px.y());
  distance_px2[i] = static_cast<float>(from_center_px.squaredNorm());
  x_px_s[i] = static_cast<float>(velocity_px_s.x());
  y_px_s[i] = static_cast<float>(velocity_px_s.y());
  nearness[i] = 1;
}

VelocityPlane fit_plane(const NearbyVelocities& velocities, int iterations, double slope_prior) {
  VelocityPlane plane;
  plane.coefficients(0, 0) = median_of(velocities.x_px_s, velocities.nearness);
  plane.coefficients(0, 1) = median_of(velocities.y_px_s, velocities.nearness);
  const float reach_px2 = *std::max_element(velocities.distance_px2.begin(), velocities.distance_px2.end());
  const float per_px = 1 / std::sqrt(std::max(reach_px2, 1.0f));
  thread_local std::vector<float> distances;
  NormalEquations equations{Eigen::Matrix3d::Identity(), Eigen::Matrix3d::Zero(), {}};
  for (int iteration = 0;; ++iteration) {
    take_distances(velocities, plane.coefficients, &distances);
    plane.spread_px_s = spread_of(distances);
    if (iteration == iterations) break;
    equations = equations_of(velocities, distances, plane.spread_px_s, per_px);
    // A slope is used where the corners show it.
    const double prior = slope_prior * reach_px2 * per_px * per_px;
    equations.normal(1, 1) += prior;
    equations.normal(2, 2) += prior;
    plane.coefficients = equations.normal.ldlt().solve(equations.right);
    plane.coefficients.bottomRows<2>() *= per_px;
  }
  // Three corners lie on a plane whatever they say.
  constexpr double kParameters = 3, kLeastFreedom = 0.5;
  const double freedom = std::max(equations.inlier_weight - kParameters, kLeastFreedom);
  const Eigen::Matrix3d inverse = equations.normal.inverse();
  const double variance = (inverse * equations.squares * inverse)(0, 0);
  plane.stddev_px_s = plane.spread_px_s * std::sqrt(variance * equations.inlier_weight / freedom);
  return plane;
}

double seen_from_px(const VelocityPlane& plane, const NearbyVelocities& velocities) {
  constexpr std::size_t kSeenBy = 3;
  constexpr float kShows = 0.5;  // of the weight of one that shows exactly this
  thread_local std::vector<float> distances, distances_px2;
  take_distances(velocities, plane.coefficients, &distances);
  distances_px2.clear();
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    const float weight = robust_weight(distances[k], static_cast<float>(plane.spread_px_s));
    if (weight > kShows) distances_px2.push_back(velocities.distance_px2[k]);
  }
  if (distances_px2.size() < kSeenBy) {
    return std::sqrt(*std::max_element(velocities.distance_px2.begin(), velocities.distance_px2.end()));
  }
  std::nth_element(distances_px2.begin(), distances_px2.begin() + kSeenBy - 1, distances_px2.end());
  return std::sqrt(distances_px2[kSeenBy - 1]);
}

}  // namespace gyro_deblur
