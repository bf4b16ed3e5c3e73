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

/// Three times what the fit has unknowns; fewer blocks tell nothing of the scene.
constexpr std::size_t kLeastBlocksOfScene = 9;

/// The changes without most of their noise. The residual velocity of a camera that moves across its optical axis is its
/// own velocity over depth: when that changes, the velocities of all blocks are turned and scaled alike, whatever their
/// depth. Approach, and what all depths have in common, is linear in the image. So, with vectors as complex numbers,
///   change = a velocity + b + c (center - mean center)
/// with a, b, c of all blocks, and the velocity half-way through its change. A block whose own change is farther off
/// than its noise explains, such as one on an object that moves by itself, keeps it; so do all where they are fewer
/// than kLeastBlocksOfScene.
std::vector<Eigen::Vector2d> common_changes(const std::vector<BlockChange>& blocks);

}  // namespace gyro_deblur
