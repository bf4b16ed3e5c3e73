// Detection and description with any OpenCV feature.
#pragma once

#include <vector>

#include <opencv2/features2d.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

/// Keypoints and their descriptors; row i of `descriptors` (CV_8U or CV_32F, empty for NONE) belongs to keypoint i.
struct Features {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
};

/// A detector and a descriptor by name, a limit by response, and an optional grid that spreads it evenly.
/// Not thread-safe (OpenCV's features are not).
class FeatureExtractor {
 public:
  /// Throws OptionError for unknown names (it lists them), a descriptor that does not accept the detector, or SIFT with
  /// an OpenCV older than 4.4, where it is not in the main modules.
  explicit FeatureExtractor(const KeypointOptions& options);

  /// @param luminance CV_8UC1; smaller than about 16x16 gives no keypoints
  /// Keypoints are ordered by falling response; equal input gives equal output.
  Features extract(const cv::Mat& luminance);

  const KeypointOptions& options() const { return options_; }

 private:
  KeypointOptions options_;
  cv::Ptr<cv::Feature2D> detector_;
  cv::Ptr<cv::Feature2D> descriptor_;  // null for NONE
};

}  // namespace gyro_deblur
