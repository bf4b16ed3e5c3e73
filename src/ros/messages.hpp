// The package's messages.
#pragma once

#include <gyro_deblur/BlurField.h>
#include <gyro_deblur/Exposure.h>
#include <gyro_deblur/ImageQuality.h>
#include <gyro_deblur/Keypoint.h>
#include <gyro_deblur/KeypointArray.h>
