// Detection and description with any OpenCV feature.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/features2d.hpp>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/pixel_mask.hpp"

namespace gyro_deblur {

/// Keypoints and their descriptors; row i of `descriptors` (CV_8U or CV_32F, empty for NONE) belongs to keypoint i.
struct Features {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
};

/// Where a keypoint is, and where it would be had every row been exposed at the reference time.
struct RectifiedPoint {
  Eigen::Vector2d rectified_px;  ///< distorted pixel; the raw one when `rectified` is false
  Eigen::Vector2d normalized;    ///< undistorted (x/z, y/z) of rectified_px in the image's frame; NaN beyond the model
  bool deblurred = false;        ///< lies in a DEBLURRED block
  bool rectified = false;        ///< was moved to the reference time
};

/// Those of KeypointOptions that the OpenCV which this was built with has: SIFT is in its main modules since 4.4.
std::vector<std::string> available_detectors();
std::vector<std::string> available_descriptors();

/// Radius of the patch that determines where the detector puts a keypoint [px], > 0. What it calls a keypoint's size is
/// that patch (FAST, GFTT), a multiple of it (ORB's and BRISK's descriptors), or the scale of a blob (SIFT, AKAZE).
double corner_radius_px(const cv::KeyPoint& keypoint, const std::string& detector);

/// A detector and a descriptor by name, a limit by response, and an optional grid that spreads it evenly.
/// Not thread-safe (OpenCV's features are not).
class FeatureExtractor {
 public:
  /// Throws OptionError for options that are not valid, and for a name that OpenCV does not have (it lists those that
  /// it has).
  explicit FeatureExtractor(const KeypointOptions& options);

  /// @param luminance CV_8UC1; smaller than about 16x16 gives no keypoints
  /// @param mask      empty, or of the image's size; no keypoint is on a masked pixel
  /// Keypoints are ordered by falling response; equal input gives equal output.
  Features extract(const cv::Mat& luminance, const PixelMask& mask = {});

 private:
  KeypointOptions options_;
  cv::Ptr<cv::Feature2D> detector_;
  cv::Ptr<cv::Feature2D> descriptor_;  // null for NONE
};

}  // namespace gyro_deblur
