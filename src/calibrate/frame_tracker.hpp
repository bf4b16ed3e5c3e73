// Points followed from frame to frame, for calibration.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace gyro_deblur {

/// Where one point of the scene is in two frames [px], in the pixels of the image as it arrives.
struct PointPair {
  Eigen::Vector2d from_px, to_px;
};

struct FrameTrackerOptions {
  int max_points = 200;        ///< [10, 10000] for each pair of frames
  double max_return_px = 0.3;  ///< (0, 10]: a point tracked there and back must come back to within this

  void validate() const;  ///< throws OptionError
};

/// Corners tracked from each frame to the next by pyramidal Lucas-Kanade, and back as a check. Every pair of frames
/// starts with corners of its own, so that no drift builds up.
class FrameTracker {
 public:
  /// Throws OptionError.
  explicit FrameTracker(const FrameTrackerOptions& options = {});

  /// @param luminance  CV_8UC1, all of the same size
  /// @return the points of the frame before that are found in this one; none for the first frame
  /// Throws std::invalid_argument for another type or size.
  std::vector<PointPair> next(const cv::Mat& luminance);

 private:
  FrameTrackerOptions options_;
  std::vector<cv::Mat> pyramid_;  // of the frame before
  cv::Mat previous_;
};

}  // namespace gyro_deblur
