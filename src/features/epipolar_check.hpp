// Which points move as one camera that has rotated and moved would see them.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Whether each point is within `max_distance_px` of its epipolar line. The rotation has been taken out: what is left
/// of a static scene is one translation, which two points determine and the others confirm. A small rotation that most
/// points share is taken out as well: a bias, or a readout time that is a little off, leaves one. Where most points
/// still do not confirm the translation, the rotation is not that of the camera (or not known), and any epipolar
/// geometry counts. Deterministic.
/// @param rotated   directions in the first image, rotated by the camera's rotation; any length, z > 0
/// @param seen      directions of the same points in the second image; the same
/// @param focal_px  pixels for a direction's change by 1
/// @return one for each point; too few points have nothing to disagree with
std::vector<char> agree_with_epipolar_geometry(const std::vector<Eigen::Vector3d>& rotated,
                                               const std::vector<Eigen::Vector3d>& seen, double focal_px,
                                               double max_distance_px);

}  // namespace gyro_deblur
