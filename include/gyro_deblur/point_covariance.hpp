// How exactly it is known where a feature of a deblurred image is.
#pragma once

#include <string>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Standard deviations that a covariance is made of. Lengths of blur are e, a deblurred block's extent, and
/// e^2 / (e + from_px) of one left blurred: extents well below from_px leave features where they are.
struct PointErrors {
  double noise;      ///< > 0: over that of the best unbiased estimate,
  double unseen_px;  ///< > 0: and what is left where texture tells nothing, of a point that was found all the same
  double deblurred_along;   ///< of the length, along the line of a deblurred block
  double deblurred_across;  ///< and across
  double blurred_along;     ///< the same of one left blurred
  double blurred_across;
  double from_px;
  double least_px;   ///< what the detector, or the tracker, does by itself: in all directions,
  double of_radius;  ///< or of the patch's radius
};

/// Fits to simulated frames, see doc/reports/point_covariance.md: blobs (SIFT, AKAZE), corners that are placed on whole
/// pixels of their scale (the other detectors).
extern const PointErrors kBlobErrors, kCornerErrors;

/// Covariance of the places of features in one image as it leaves, deblurred or not: 2x2 [px^2], x right, y down,
/// symmetric and positive definite. It is the sum of
///
/// - noise: (A / (n^2 v) + 1 / u^2)^-1, n and u PointErrors' noise and unseen_px, v the variance of the image's noise
///   as it leaves, A the sum of the gradients' outer products over a window, less what noise adds to it (W. Foerstner,
///   E. Guelch, ISPRS Intercommission Workshop 1987). It is large along an edge, and u^2 where there is no texture at
///   all: what was matched or followed, and passed the checks on it, is not farther off;
/// - blur: along the block's line, in proportion to its extent where it was deblurred, and far more where it was not;
///   less of it across; in all directions what the block's motion is uncertain by within the exposure;
/// - the detector, or the tracker, itself.
///
/// Where the blur of a block (NO_GYRO) or the noise of the image is not known, nothing is: both variances are infinite,
/// and the covariance is 0.
///
/// Refers to both arguments.
class PointCovariance {
 public:
  /// @param luminance  CV_8UC1 of the field's size, as it leaves
  /// @param field      validated
  /// Throws std::invalid_argument when they do not fit.
  PointCovariance(const cv::Mat& luminance, const FrameBlur& field);

  /// Of a detected keypoint, against where the same detector puts it in a sharp image without noise.
  /// @param keypoint  in pixels of the image
  Eigen::Matrix2d of_keypoint(const cv::KeyPoint& keypoint, const std::string& detector) const;

  /// @param radius_px  > 0: of the window
  Eigen::Matrix2d at(const Eigen::Vector2d& pixel_px, double radius_px, const PointErrors& errors) const;

 private:
  const cv::Mat& luminance_;
  const FrameBlur& field_;
};

/// What moving a point for so long adds to its covariance in a block: its residual velocity is not certain.
Eigen::Matrix2d covariance_of_moving(const BlockBlur& block, double seconds);

}  // namespace gyro_deblur
