// How exactly it is known where a feature of a deblurred image is.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// What the parts of a covariance are multiplied with: standard deviations. Those below are a fit to simulated frames,
/// see doc/reports/point_covariance.md.
struct PointErrorFactors {
  double noise;            ///< over that of the best unbiased estimate
  double deblurred;        ///< along the line of a deblurred block, of its extent
  double blurred;          ///< along the line of a block left blurred, of its extent
  double blurred_from_px;  ///< extents well below it leave features where they are
  double of_radius;        ///< of the detector or the tracker itself, of the radius
};
constexpr PointErrorFactors kKeypointErrors{2, 0.02, 0.2, 4, 0.05}, kTrackErrors{2, 0.02, 0.2, 4, 0.005};

/// Covariance of the places of features in one image as it leaves, deblurred or not: 2x2 [px^2], x right, y down,
/// symmetric and positive definite. It is the sum of
///
/// - noise: v (A + v / r^2)^-1, v the variance of the image's noise as it leaves, A the sum of the gradients' outer
///   products over a window of radius r, less what noise adds to it (W. Foerstner, E. Guelch, ISPRS Intercommission
///   Workshop 1987). It is large along an edge, and r^2 where there is no texture at all;
/// - blur: along the block's line, in proportion to its extent where it was deblurred, and far more where it was not;
///   in all directions what the block's motion is uncertain by within the exposure;
/// - the detector, or the tracker: a share of r.
///
/// Where the blur of a block (NO_GYRO)
/// or the noise of the image is not known, nothing is: both variances are infinite, and the covariance is 0.
///
/// Refers to both arguments.
class PointCovariance {
 public:
  /// @param luminance  CV_8UC1 of the field's size, as it leaves
  /// @param field      validated
  /// Throws std::invalid_argument when they do not fit.
  PointCovariance(const cv::Mat& luminance, const FrameBlur& field);

  /// Of a detected keypoint, against where the same detector puts it in a sharp image without noise.
  /// @param pixel_px   in the image
  /// @param radius_px  > 0: of the patch that settles the place, see corner_radius_px()
  Eigen::Matrix2d of_keypoint(const Eigen::Vector2d& pixel_px, double radius_px) const;

  /// Of a corner that was followed from image to image, against where the scene point is that it was found on.
  /// @param window_px  side of the patch that is compared
  Eigen::Matrix2d of_track(const Eigen::Vector2d& pixel_px, int window_px) const;

  /// @param radius_px  > 0: of the window
  Eigen::Matrix2d at(const Eigen::Vector2d& pixel_px, double radius_px, const PointErrorFactors& factors) const;

 private:
  const cv::Mat& luminance_;
  const FrameBlur& field_;
};

/// What moving a point for so long adds to its covariance in a block: its residual velocity is not certain.
Eigen::Matrix2d covariance_of_moving(const BlockBlur& block, double seconds);

}  // namespace gyro_deblur
