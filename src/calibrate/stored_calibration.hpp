// The calibration that was estimated from the images, kept on disk from one start to the next.
#pragma once

#include <optional>
#include <string>

#include "calibrate/self_calibration.hpp"

namespace gyro_deblur {

/// The file of a node and an image size [px]: below $ROS_HOME/gyro_deblur, by default ~/.ros/gyro_deblur. Empty where
/// neither ROS_HOME nor HOME is set.
/// @param node_name  resolved, e.g. "/camera/gyro_deblur"
std::string stored_calibration_path(const std::string& node_name, int width_px, int height_px);

/// Nothing where there is no file. Throws std::runtime_error with the path when it cannot be read, or its values cannot
/// be.
std::optional<LearnedCalibration> load_stored_calibration(const std::string& path);

/// Writes what is known, and makes the folder. A process that dies meanwhile leaves the former file. Throws
/// std::runtime_error with the path.
void save_stored_calibration(const std::string& path, const LearnedCalibration& calibration);

/// There need not be a file. Throws std::runtime_error with the path.
void remove_stored_calibration(const std::string& path);

}  // namespace gyro_deblur
