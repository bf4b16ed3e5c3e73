// Fits a plane to the displacements around a point.
#include "features/local_motion.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <utility>

#include <Eigen/Dense>

#include "features/robust_weight.hpp"

namespace gyro_deblur {
namespace {

constexpr std::size_t kNeighbours = 12, kMinNeighbours = 6;

/// Called for each corner of each image: nothing here allocates.
double median_of(std::array<double, kNeighbours> values, std::size_t count) {
  const auto begin = values.begin(), middle = begin + static_cast<std::ptrdiff_t>(count / 2);
  std::nth_element(begin, middle, begin + static_cast<std::ptrdiff_t>(count));
  return *middle;
}

}  // namespace

std::optional<LocalMotion> local_motion(const std::vector<DisplacedPoint>& points, const Eigen::Vector2d& place_px,
                                        const Eigen::Matrix2d& expected_slope) {
  // Slopes are used where displacements known to 0.1 px say more than that they are within about 0.02 of the expected.
  constexpr double kSlopePriorPx2 = 25;
  constexpr int kIterations = 2;
  if (points.size() < kMinNeighbours) return std::nullopt;
  // Farthest last of those kept so far, by insertion: most points are farther than all of them.
  std::array<std::pair<double, const DisplacedPoint*>, kNeighbours> nearest;
  std::size_t count = 0;
  for (const DisplacedPoint& point : points) {
    const double distance_px2 = (point.place_px - place_px).squaredNorm();
    if (count == kNeighbours && distance_px2 >= nearest[count - 1].first) continue;
    std::size_t at = count < kNeighbours ? count++ : count - 1;
    for (; at > 0 && nearest[at - 1].first > distance_px2; --at) nearest[at] = nearest[at - 1];
    nearest[at] = {distance_px2, &point};
  }

  // From the median on.
  Eigen::Matrix<double, 3, 2> plane;
  plane.bottomRows<2>() = expected_slope.transpose();
  for (int axis = 0; axis < 2; ++axis) {
    std::array<double, kNeighbours> values;
    for (std::size_t k = 0; k < count; ++k) {
      const DisplacedPoint& point = *nearest[k].second;
      values[k] = (point.displacement_px - expected_slope * (point.place_px - place_px))[axis];
    }
    plane(0, axis) = median_of(values, count);
  }
  const auto row_of = [&](const DisplacedPoint& point) {
    const Eigen::Vector2d away_px = point.place_px - place_px;
    return Eigen::Vector3d(1, away_px.x(), away_px.y());
  };
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    std::array<double, kNeighbours> distances_px;
    for (std::size_t k = 0; k < count; ++k) {
      const DisplacedPoint& point = *nearest[k].second;
      distances_px[k] = (point.displacement_px - plane.transpose() * row_of(point)).norm();
    }
    const double spread_px = spread_of_median(median_of(distances_px, count));
    Eigen::Matrix3d normal = Eigen::Vector3d(0, kSlopePriorPx2, kSlopePriorPx2).asDiagonal();
    Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
    right.bottomRows<2>() = kSlopePriorPx2 * expected_slope.transpose();
    for (std::size_t k = 0; k < count; ++k) {
      const DisplacedPoint& point = *nearest[k].second;
      const Eigen::Vector3d row = row_of(point);
      const double weight = robust_weight(distances_px[k], spread_px);
      normal += weight * row * row.transpose();
      right += weight * row * point.displacement_px.transpose();
    }
    plane = normal.inverse() * right;
  }
  if (!plane.allFinite()) return std::nullopt;
  return LocalMotion{plane.row(0).transpose(), plane.bottomRows<2>().transpose()};
}

}  // namespace gyro_deblur
