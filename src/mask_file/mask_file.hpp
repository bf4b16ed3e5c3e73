// Masks from image files, without ROS. Not in the core, which reads no image files.
#pragma once

#include <string>

#include "gyro_deblur/pixel_mask.hpp"

namespace gyro_deblur {

/// Pixels of the file in which any colour is above 0 are used; alpha does not count.
/// Throws OptionError that names the file and says what is allowed: a file that cannot be read, is no image, is JPEG
/// (which does not keep zeros), or has no pixel that is used.
PixelMask load_mask(const std::string& path);

}  // namespace gyro_deblur
