// Rolling-shutter rectification of keypoints (paper section III-C).
#pragma once

#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Takes points to `reference_ns` from the middle of their row's exposure: from where the scene point was then, which
/// is where the image shows it less BlockBlur::apparent_offset_px(). That and the residual velocities of blocks hold at
/// their centres, and between these what is linear between them: global_shutter_map() moves images by the same rule.
/// Points in REJECTED blocks are not rectified (paper section III-D), nor those in NO_GYRO blocks, those between whose
/// time and the reference time the motion is not known, and those that leave the range of the lens model; other points
/// are.
/// @param points_px  raw pixels, finite
/// @param field      of the whole image (at least one block)
std::vector<RectifiedPoint> rectify_points(const std::vector<Eigen::Vector2d>& points_px, const FrameBlur& field,
                                           const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, TimeNs reference_ns);

}  // namespace gyro_deblur
