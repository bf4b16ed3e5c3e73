// Path of a scene point on the image during the exposure.
#pragma once

#include <Eigen/Core>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Width and height [px] of what the path covers, the place at the middle of the exposure included.
Eigen::Vector2f extent_of(const Path2d& path_px);

}  // namespace gyro_deblur
