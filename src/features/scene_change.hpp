// How the residual velocities of a scene change from image to image, all together.
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// What one block shows.
struct BlockChange {
  Eigen::Vector2d center_px;
  Eigen::Vector2d velocity_px_s;  ///< residual velocity, the mean since the image before
  double stddev_px_s;             ///< of each component of it, and of the one before
  Eigen::Vector2d change_px_s;    ///< of it, since the mean before that
};

/// Three times the number of unknowns of the fit; fewer blocks are no measure of the scene.
constexpr std::size_t kLeastBlocksOfScene = 9;

/// The changes without most of their noise: with vectors as complex numbers,
///   change = a velocity + b + c (center - mean center),
/// where a, b and c are fitted to all blocks and the velocity is that half-way through its change
/// (doc/design/optical_flow.md). A block whose own change differs by more than its noise explains keeps it, such as one
/// on a moving object; so do all if they are fewer than kLeastBlocksOfScene.
std::vector<Eigen::Vector2d> common_changes(const std::vector<BlockChange>& blocks);

}  // namespace gyro_deblur
