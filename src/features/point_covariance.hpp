// How exactly it is known where a feature of a deblurred image is.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Parameters of the covariance of a point: standard deviations in px, or as a share of a length. The length of blur is
/// the extent e [px] in a deblurred block, e^2 / (e + from_px) in a blurred one. All are >= 0.
struct PointErrors {
  double noise;             ///< > 0, without unit: error by noise over that of the best unbiased estimate
  double unseen_px;         ///< > 0: largest error by noise, that of a point without texture
  double deblurred_along;   ///< share of the length of blur along its line, deblurred block
  double deblurred_across;  ///< the same across the line
  double blurred_along;     ///< share of the length of blur along its line, blurred block
  double blurred_across;    ///< the same across the line
  double from_px;           ///< blur with an extent well below this moves no feature
  double least_px;          ///< own error of the detector or tracker, in all directions
  double of_radius;         ///< own error as a share of the patch's radius
};

/// Values for blobs (SIFT, AKAZE) and for corners (other detectors), fitted to simulated frames
/// (doc/reports/point_covariance.md).
extern const PointErrors kBlobErrors, kCornerErrors;

/// Covariance of the positions of features in one output image: 2x2 [px^2], x right, y down, symmetric and positive
/// definite. It is the sum of
///
/// - noise: (A / (n^2 v) + 1 / u^2)^-1, with n and u PointErrors::noise and unseen_px, v the variance of the output
///   image's noise [grey levels^2], and A the sum of the gradients' outer products over a window without the part of
///   noise [grey levels^2/px^2] (W. Foerstner, E. Guelch, ISPRS Intercommission Workshop 1987). It is large along an
///   edge, and u^2 without texture;
/// - blur: along the block's line and across, in proportion to the length of blur (PointErrors);
/// - the uncertainty of the block's residual velocity, times the exposure time;
/// - the detector's, or the tracker's, own error.
///
/// Both variances are infinite, and the covariance between x and y is 0, if the block's blur (NO_GYRO, MASKED) or the
/// image's noise is not known.
///
/// Keeps references to both arguments of the constructor.
class PointCovariance {
 public:
  /// @param luminance  of the output image, CV_8UC1 of the field's size
  /// @param field      validated
  /// Throws std::invalid_argument when they do not fit.
  PointCovariance(const cv::Mat& luminance, const FrameBlur& field);

  /// Covariance [px^2] of a feature at a pixel, relative to where the same detector finds it in a sharp image without
  /// noise.
  /// @param radius_px  of the window, > 0
  Eigen::Matrix2d at(const Eigen::Vector2d& pixel_px, double radius_px, const PointErrors& errors) const;

 private:
  const cv::Mat& luminance_;
  const FrameBlur& field_;
};

/// Covariance [px^2] by the uncertainty of the block's residual velocity over `seconds` (>= 0) of motion.
Eigen::Matrix2d covariance_of_moving(const BlockBlur& block, double seconds);

}  // namespace gyro_deblur
