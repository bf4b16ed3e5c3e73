// Fits the common change of residual velocities between two images.
#include "features/scene_change.hpp"

#include <cmath>
#include <complex>

#include <Eigen/Cholesky>

#include "base/median.hpp"
#include "features/robust_weight.hpp"

namespace gyro_deblur {
namespace {

using Complex = std::complex<double>;

Complex to_complex(const Eigen::Vector2d& v) { return {v.x(), v.y()}; }

}  // namespace

std::vector<Eigen::Vector2d> common_changes(const std::vector<BlockChange>& blocks) {
  std::vector<Eigen::Vector2d> changes_px_s;
  for (const BlockChange& block : blocks) changes_px_s.push_back(block.change_px_s);
  if (blocks.size() < kLeastBlocksOfScene) return changes_px_s;

  Eigen::Vector2d mean_px = Eigen::Vector2d::Zero();
  for (const BlockChange& block : blocks) mean_px += block.center_px / static_cast<double>(blocks.size());
  Eigen::MatrixXcd rows(blocks.size(), 3);
  Eigen::VectorXcd right(blocks.size());
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    // The velocity in between: its noise has nothing to do with that of the change.
    rows.row(row) << to_complex(blocks[i].velocity_px_s - blocks[i].change_px_s / 2), Complex(1),
        to_complex(blocks[i].center_px - mean_px);
    right(row) = to_complex(blocks[i].change_px_s);
  }

  // Where all velocities are equal, a and b are not determined separately: the prior keeps the solution finite.
  constexpr double kPrior = 1e-4;
  constexpr int kIterations = 5;
  Eigen::VectorXd weights = Eigen::VectorXd::Ones(right.size());
  Eigen::VectorXcd fitted;
  std::vector<double> distances(blocks.size());
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    Eigen::Matrix3cd normal = rows.adjoint() * weights.asDiagonal() * rows;
    for (int k = 0; k < 3; ++k) normal(k, k) *= 1 + kPrior;
    const Eigen::Vector3cd weighted_right = rows.adjoint() * (weights.asDiagonal() * right);
    fitted = rows * normal.ldlt().solve(weighted_right);
    for (std::size_t i = 0; i < blocks.size(); ++i) distances[i] = std::abs(right(i) - fitted(i));
    const double spread_px_s = spread_of(distances);
    for (std::size_t i = 0; i < blocks.size(); ++i) weights(i) = robust_weight(distances[i], spread_px_s);
  }

  constexpr double kExplained = 3;  // standard deviations
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    if (!(distances[i] <= kExplained * blocks[i].stddev_px_s * std::sqrt(2.0))) continue;
    changes_px_s[i] = {fitted(i).real(), fitted(i).imag()};
  }
  return changes_px_s;
}

}  // namespace gyro_deblur
