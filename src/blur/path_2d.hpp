// Path of a scene point on the image during the exposure.
#pragma once

#include <array>

#include <Eigen/Core>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Width and height [px] of what the path covers, the place at the middle of the exposure included.
Eigen::Vector2f extent_of(const Path2d& path_px);

/// What the path covers [px] along a line (x) and across it (y).
Eigen::Vector2f extent_along(const Path2d& path_px, float angle_rad);

/// The path that a rolling shutter records. Rows to which a scene point moves are exposed later or earlier than the row
/// where it is at mid-exposure: a point that moves with the readout is exposed for longer, by 1 / (1 - v t) at v [px/s]
/// along the columns and t [s] from row to row.
/// @param path_px  places at kPathInstants of the exposure of one row, that which sees the point at mid-exposure,
///                 relative to its place then
/// @return places at kPathInstants of the exposure of the row that the point is in then; path_px itself for a global
///         shutter, at most 5 times as long for one that the point keeps up with
std::array<Eigen::Vector2d, kPathInstants> rolling_shutter_path(
    const std::array<Eigen::Vector2d, kPathInstants>& path_px, const RowExposure& exposure);

}  // namespace gyro_deblur
