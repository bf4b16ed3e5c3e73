// A recorded burst with real motion blur: what the images add to its gyroscope.
#pragma once

#include <string>
#include <vector>

namespace gyro_deblur::experiments {

struct BurstFrame {
  int number = 0;           ///< the first is 1
  double extent_px = 0;     ///< by the gyroscope, median of the blocks that have optical flow, or of all without any
  double ratio_median = 0;  ///< extent with the images over the gyroscope's, of those blocks; NaN without any
  double ratio_low = 0, ratio_high = 0;                                  ///< quartiles
  double from_images = 0;                                                ///< share of blocks
  int deblurred_alone = 0, deblurred_images = 0;                         ///< blocks
  int keypoints_blurred = 0, keypoints_alone = 0, keypoints_images = 0;  ///< SIFT
  /// With the frame before: SIFT matches that a homography explains to 3 px; 0 for the first.
  int matches_blurred = 0, matches_alone = 0, matches_images = 0;
};

/// @param folder       shield_burst of the recorded data
/// @param description  config/recordings/shield_burst.yaml
/// Throws std::runtime_error when it cannot be read.
std::vector<BurstFrame> burst_frames(const std::string& folder, const std::string& description);

}  // namespace gyro_deblur::experiments
