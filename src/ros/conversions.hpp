// All conversions between ROS messages and the core's types.
#pragma once

#include "ros/calibration_conversion.hpp"
#include "ros/compressed_image.hpp"
#include "ros/image_conversion.hpp"
#include "ros/output_conversion.hpp"
#include "ros/tf_conversion.hpp"
#include "ros/value_conversion.hpp"
