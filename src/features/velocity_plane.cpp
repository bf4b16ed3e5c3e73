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

/// What the fit works with: a column for each quantity of the corners.
struct Columns {
  std::vector<float> x, y;  ///< places, in a unit in which sums of squares keep their precision
  std::vector<float> distances, weights, squared_weights;
};

/// Sum of w (1, x, y)^T (1, x, y).
Eigen::Matrix3d sum_of_squares(const Columns& columns, const std::vector<float>& weights) {
  const float *x = columns.x.data(), *y = columns.y.data(), *weight = weights.data();
  const auto count = static_cast<int>(weights.size());
  float sum = 0, sum_x = 0, sum_y = 0, sum_xx = 0, sum_xy = 0, sum_yy = 0;
#pragma omp simd reduction(+ : sum, sum_x, sum_y, sum_xx, sum_xy, sum_yy)
  for (int k = 0; k < count; ++k) {
    const float weighted_x = weight[k] * x[k], weighted_y = weight[k] * y[k];
    sum += weight[k];
    sum_x += weighted_x;
    sum_y += weighted_y;
    sum_xx += weighted_x * x[k];
    sum_xy += weighted_x * y[k];
    sum_yy += weighted_y * y[k];
  }
  Eigen::Matrix3f sums;
  sums << sum, sum_x, sum_y, sum_x, sum_xx, sum_xy, sum_y, sum_xy, sum_yy;
  return sums.cast<double>();
}

/// Sum of w (1, x, y) v.
Eigen::Vector3d sum_of_products(const Columns& columns, const std::vector<float>& values) {
  const float *x = columns.x.data(), *y = columns.y.data(), *weight = columns.weights.data(), *value = values.data();
  const auto count = static_cast<int>(values.size());
  float sum = 0, sum_x = 0, sum_y = 0;
#pragma omp simd reduction(+ : sum, sum_x, sum_y)
  for (int k = 0; k < count; ++k) {
    const float weighted = weight[k] * value[k];
    sum += weighted;
    sum_x += weighted * x[k];
    sum_y += weighted * y[k];
  }
  return Eigen::Vector3f(sum, sum_x, sum_y).cast<double>();
}

/// Weights of the corners by their distances from a plane.
/// @return their sum before nearness
float take_weights(const std::vector<float>& nearness, double spread, Columns* columns) {
  const auto count = static_cast<int>(nearness.size());
  const float *near = nearness.data(), *distance = columns->distances.data();
  float *weight = columns->weights.data(), *square = columns->squared_weights.data(), inliers = 0;
#pragma omp simd reduction(+ : inliers)
  for (int k = 0; k < count; ++k) {
    const float inlier = robust_weight(distance[k], static_cast<float>(spread));
    inliers += inlier;
    weight[k] = inlier * near[k];
    square[k] = weight[k] * weight[k];
  }
  return inliers;
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
  thread_local Columns columns;
  for (std::vector<float>* column : {&columns.x, &columns.y, &columns.weights, &columns.squared_weights}) {
    column->resize(velocities.size());
  }
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    columns.x[k] = per_px * velocities.x_px[k];
    columns.y[k] = per_px * velocities.y_px[k];
  }
  Eigen::Matrix3d normal = Eigen::Matrix3d::Identity(), squares = Eigen::Matrix3d::Zero();
  double inlier_weight = 0;
  for (int iteration = 0;; ++iteration) {
    take_distances(velocities, plane.coefficients, &columns.distances);
    plane.spread_px_s = spread_of(columns.distances);
    if (iteration == iterations) break;
    inlier_weight = take_weights(velocities.nearness, plane.spread_px_s, &columns);
    normal = sum_of_squares(columns, columns.weights);
    squares = sum_of_squares(columns, columns.squared_weights);
    // A slope is used where the corners show it.
    const double prior = slope_prior * reach_px2 * per_px * per_px;
    normal(1, 1) += prior;
    normal(2, 2) += prior;
    Eigen::Matrix<double, 3, 2> right;
    right << sum_of_products(columns, velocities.x_px_s), sum_of_products(columns, velocities.y_px_s);
    plane.coefficients = normal.ldlt().solve(right);
    plane.coefficients.bottomRows<2>() *= per_px;
  }
  // Three corners lie on a plane whatever they say.
  constexpr double kParameters = 3, kLeastFreedom = 0.5;
  const double freedom = std::max(inlier_weight - kParameters, kLeastFreedom);
  const Eigen::Matrix3d inverse = normal.inverse();
  const double variance = (inverse * squares * inverse)(0, 0);
  plane.stddev_px_s = plane.spread_px_s * std::sqrt(variance * inlier_weight / freedom);
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
