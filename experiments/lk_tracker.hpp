// Corners followed by pyramidal Lucas-Kanade from the gyroscope's prediction: what FeatureTracker is compared with.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur::experiments {

/// Follows corners through the images of one camera. Not thread-safe.
///
/// A corner is looked for where the gyroscope says it has gone, so that a rotation between two images costs no pyramid
/// levels; it is kept when tracking it back returns to where it came from, and when it agrees with the epipolar
/// geometry of the others, from which rotation (row by row) has been taken out first.
class LkTracker {
 public:
  /// Throws OptionError.
  explicit LkTracker(const TrackerOptions& options);

  /// Follows the corners into the next image and fills up with new ones.
  /// @param luminance  CV_8UC1 of the camera's size, sharp or deblurred; its pixels are copied
  /// @param motion     from the image before to this one; where it is not known, corners are looked for where they were
  /// @param exposure   of this image; all tracks are forgotten first when it is not after the one before, or more than
  /// kLongestTrackBreakNs later
  /// @return all corners in this image, longest tracks first
  const std::vector<Track>& track(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                  const RowExposure& exposure);

 private:
  void follow(const std::vector<cv::Mat>& pyramid, const Camera& camera, const CameraMotion& motion,
              const RowExposure& exposure);
  void add_corners(const cv::Mat& luminance, const Camera& camera);

  TrackerOptions options_;
  std::int32_t next_id_ = 0;
  std::vector<Track> tracks_;
  std::vector<cv::Mat> pyramid_;         // of the newest image
  std::optional<RowExposure> exposure_;  // of the newest image
};

}  // namespace gyro_deblur::experiments
