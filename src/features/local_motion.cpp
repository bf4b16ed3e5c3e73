#include "features/local_motion.hpp"

#include <algorithm>
#include <cstddef>
#include <utility>

#include <Eigen/Dense>

#include "base/median.hpp"
#include "features/robust_weight.hpp"

namespace gyro_deblur {

LocalMotion local_motion(const std::vector<DisplacedPoint>& points, const Eigen::Vector2d& place_px) {
  constexpr std::size_t kNeighbours = 12, kMinNeighbours = 6;
  // Slopes are believed where displacements known to 0.1 px say more than that they are about 0.01.
  constexpr double kSlopePriorPx2 = 100;
  constexpr int kIterations = 4;
  LocalMotion motion{Eigen::Vector2d::Zero(), Eigen::Matrix2d::Zero()};
  if (points.size() < kMinNeighbours) return motion;
  std::vector<std::pair<double, const DisplacedPoint*>> nearest;
  for (const DisplacedPoint& point : points) nearest.emplace_back((point.place_px - place_px).squaredNorm(), &point);
  const std::size_t count = std::min(kNeighbours, nearest.size());
  std::partial_sort(nearest.begin(), nearest.begin() + static_cast<std::ptrdiff_t>(count), nearest.end());
  nearest.resize(count);

  // From the median on.
  Eigen::Matrix<double, 3, 2> plane = Eigen::Matrix<double, 3, 2>::Zero();
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> values;
    for (const auto& neighbour : nearest) values.push_back(neighbour.second->displacement_px[axis]);
    plane(0, axis) = median(values);
  }
  const auto row_of = [&](const DisplacedPoint& point) {
    const Eigen::Vector2d away_px = point.place_px - place_px;
    return Eigen::Vector3d(1, away_px.x(), away_px.y());
  };
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    std::vector<double> distances_px;
    for (const auto& [unused, point] : nearest) {
      distances_px.push_back((point->displacement_px - plane.transpose() * row_of(*point)).norm());
    }
    const double spread_px = spread_of(distances_px);
    Eigen::Matrix3d normal = Eigen::Vector3d(0, kSlopePriorPx2, kSlopePriorPx2).asDiagonal();
    Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
    for (std::size_t k = 0; k < count; ++k) {
      const DisplacedPoint& point = *nearest[k].second;
      const Eigen::Vector3d row = row_of(point);
      const double weight = robust_weight(distances_px[k], spread_px);
      normal += weight * row * row.transpose();
      right += weight * row * point.displacement_px.transpose();
    }
    plane = normal.ldlt().solve(right);
  }
  if (!plane.allFinite()) return motion;
  motion.displacement_px = plane.row(0).transpose();
  motion.slope = plane.bottomRows<2>().transpose();
  return motion;
}

}  // namespace gyro_deblur
