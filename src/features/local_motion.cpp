// Fits planes to the displacements around places.
#include "features/local_motion.hpp"

#include <algorithm>
#include <cstddef>
#include <limits>
#include <utility>

#include <Eigen/LU>

#include "features/robust_weight.hpp"

namespace gyro_deblur {
namespace {

constexpr int kNeighbours = 12, kMinNeighbours = 6;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

using Column = Eigen::Array<float, kNeighbours, 1>;
template <int kColumns>
using Rows = Eigen::Matrix<double, kNeighbours, kColumns>;

/// The upper of two. Comparisons of all pairs vectorise, and take a fraction of the time of std::nth_element.
/// @param count  how many of the values are finite
float median_of(const Column& values, int count) {
  int smaller[kNeighbours] = {};
  for (int k = 0; k < kNeighbours; ++k) {
    for (int i = 0; i < kNeighbours; ++i) smaller[i] += values[k] < values[i] ? 1 : 0;
  }
  float median = -kInfinity;
  for (int i = 0; i < kNeighbours; ++i) {
    if (smaller[i] <= count / 2) median = std::max(median, values[i]);
  }
  return median;
}

}  // namespace

LocalMotions::LocalMotions(std::vector<DisplacedPoint> points)
    : points_(std::move(points)), x_px_(points_.size()), y_px_(points_.size()) {
  for (std::size_t i = 0; i < points_.size(); ++i) {
    x_px_[static_cast<Eigen::Index>(i)] = static_cast<float>(points_[i].place_px.x());
    y_px_[static_cast<Eigen::Index>(i)] = static_cast<float>(points_[i].place_px.y());
  }
}

const std::vector<int>& LocalMotions::nearest_to(const Eigen::Vector2d& place_px) const {
  // Two more than are needed: a search for twelve themselves would often end below them.
  constexpr int kEnough = 14, kMaxSteps = 8;
  thread_local std::vector<int> nearest;
  thread_local Eigen::ArrayXf distances_px2;
  nearest.resize(points_.size());
  if (points_.empty()) return nearest;
  const auto count = static_cast<int>(points_.size());
  const Eigen::Vector2f place = place_px.cast<float>();
  distances_px2 = (x_px_ - place.x()).square() + (y_px_ - place.y()).square();
  const float* distance_px2 = distances_px2.data();
  // A limit that leaves little to sort. The number of points within a distance grows with its square.
  float limit_px2 = distances_px2.maxCoeff();
  for (int step = 0, within = count; step < kMaxSteps && within > kEnough; ++step) {
    const float closer_px2 = limit_px2 * kEnough / static_cast<float>(within);
    within = 0;
    for (int i = 0; i < count; ++i) within += distance_px2[i] <= closer_px2 ? 1 : 0;
    if (within >= kNeighbours) limit_px2 = closer_px2;
  }
  int* next = nearest.data();
  for (int i = 0; i < count; ++i) {
    *next = i;
    next += distance_px2[i] <= limit_px2 ? 1 : 0;  // without a branch, which could not be predicted
  }
  nearest.resize(static_cast<std::size_t>(next - nearest.data()));
  if (nearest.size() > kNeighbours) {
    std::nth_element(nearest.begin(), nearest.begin() + kNeighbours, nearest.end(),
                     [&](int a, int b) { return distance_px2[a] < distance_px2[b]; });
    nearest.resize(kNeighbours);
  }
  return nearest;
}

std::optional<LocalMotion> LocalMotions::at(const Eigen::Vector2d& place_px,
                                            const Eigen::Matrix2d& expected_slope) const {
  // Slopes are used where displacements known to 0.1 px say more than that they are within about 0.02 of the expected.
  constexpr double kSlopePriorPx2 = 25;
  constexpr int kIterations = 2;
  const std::vector<int>& nearest = nearest_to(place_px);
  const auto count = static_cast<int>(nearest.size());
  if (count < kMinNeighbours) return std::nullopt;
  Rows<3> rows = Rows<3>::Zero();  // 1, x, y
  Rows<2> displacements_px = Rows<2>::Zero();
  Column missing = Column::Constant(kInfinity);
  for (int k = 0; k < count; ++k) {
    const DisplacedPoint& point = points_[static_cast<std::size_t>(nearest[static_cast<std::size_t>(k)])];
    rows.row(k) << 1, (point.place_px - place_px).transpose();
    displacements_px.row(k) = point.displacement_px.transpose();
    missing[k] = 0;
  }

  // From the median on.
  Eigen::Matrix<double, 3, 2> plane = Eigen::Matrix<double, 3, 2>::Zero();
  plane.bottomRows<2>() = expected_slope.transpose();
  const Eigen::Matrix<double, 3, 2> prior = kSlopePriorPx2 * plane;
  Rows<2> residuals_px = displacements_px - rows.lazyProduct(plane);
  for (int axis = 0; axis < 2; ++axis) {
    plane(0, axis) = median_of(residuals_px.col(axis).cast<float>().array() + missing, count);
  }
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    residuals_px = displacements_px - rows.lazyProduct(plane);
    Column distances_px = residuals_px.rowwise().squaredNorm().cast<float>();
    distances_px = distances_px.sqrt() + missing;
    const auto spread_px = static_cast<float>(spread_of_median(median_of(distances_px, count)));
    Column weights;
    for (int k = 0; k < kNeighbours; ++k) weights[k] = robust_weight(distances_px[k], spread_px);
    const Rows<3> weighted = rows.array().colwise() * weights.cast<double>();
    Eigen::Matrix3d normal = rows.transpose().lazyProduct(weighted);
    normal.diagonal().tail<2>().array() += kSlopePriorPx2;
    plane = normal.inverse() * (prior + weighted.transpose().lazyProduct(displacements_px));
  }
  if (!plane.allFinite()) return std::nullopt;
  return LocalMotion{plane.row(0).transpose(), plane.bottomRows<2>().transpose()};
}

}  // namespace gyro_deblur
