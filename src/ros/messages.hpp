// The package's messages beside the core's types of the same name.
#pragma once

#include <gyro_deblur/Exposure.h>
#include <gyro_deblur/Keypoint.h>
#include <gyro_deblur/KeypointArray.h>

// The generated typedef gyro_deblur::BlurField would collide with the core's class, so it gets another name here. Type
// name, MD5 sum and serialisation of the message come from BlurField_ and from string literals: they stay as they are.
#define BlurField BlurFieldMessage
#include <gyro_deblur/BlurField.h>
#undef BlurField

namespace gyro_deblur {
using BlurFieldMessagePtr = BlurFieldPtr;
using BlurFieldMessageConstPtr = BlurFieldConstPtr;
}  // namespace gyro_deblur
