// Corners of a recording: how many are followed, and how well they agree with one translation of the camera.
#pragma once

#include <string>
#include <vector>

namespace gyro_deblur::experiments {

/// Corners of one tracker that are in two images.
struct SharedCorners {
  std::string tracker;  ///< and the images that it had
  int images_apart = 1;
  int pairs = 0;                     ///< of images
  std::vector<double> distances_px;  ///< of all corners from their epipolar lines, where the rotation is known
};

/// FeatureTracker on raw images, and Lucas-Kanade on raw and on deblurred ones. Epipolar lines are those of the
/// gyroscope's rotation and the translation that agrees with most corners.
/// @param folder       of images and gyroscope samples
/// @param description  of the folder, see config/recordings/
/// Throws std::runtime_error when it cannot be read, OptionError when the description cannot be used.
std::vector<SharedCorners> recorded_tracks(const std::string& folder, const std::string& description);

}  // namespace gyro_deblur::experiments
