// The methods that the paper compares: deblurring in space (proposed) and in the frequency domain, the detector with a
// scale space adapted to motion blur, and a restoration beyond the paper.
#pragma once

#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur::experiments {

/// One linear blur for a whole image.
struct LineBlur {
  double angle_rad = 0;  ///< x right, y down
  double extent_px = 0;  ///< >= 0
};

/// The field of the blurred image itself, for keypoints that are found there: DEBLURRED blocks are copied (SHARP), so
/// that their points are rectified from the middle of the smear in time.
FrameBlur as_blurred(FrameBlur field);

/// The proposed method: the package's own deconvolution with one blur in every block. Image: CV_8UC1; the result, too.
/// Throws OptionError for extents outside [kMinKernelExtentPx, kMaxKernelExtentPx].
cv::Mat deblur_in_space(const cv::Mat& image, const LineBlur& blur, const FilterOptions& options = {});

/// Edge tapering, as usual before a deconvolution in the frequency domain: towards the border the image gives way to
/// its own periodic blur, weighted by the autocorrelation of the blur's projection on either axis, so that opposite
/// borders agree. Image: one channel; returns CV_64F.
cv::Mat taper_edges(const cv::Mat& image, const LineBlur& blur);

/// Wiener deconvolution in the frequency domain, the whole image as one period: W = H* / (|H|^2 + gamma) scaled to unit
/// gain, gamma being noise_to_signal_ratio and H = sinc(extent * frequency along the line), with the image's edges
/// tapered before or not. Image: one channel; returns CV_64F, not clipped.
cv::Mat deblur_in_frequency(const cv::Mat& image, const LineBlur& blur, double noise_to_signal_ratio, bool taper);

/// Parameters of restore_beyond_borders.
struct RestorationOptions {
  double noise_to_signal_ratio = 0.007;  ///< [1e-5, 1]
  double length_factor = 6;              ///< [2, 8]; length of the inverse kernel in extents
  int iterations = 4;                    ///< [0, 100]
  double padding = 1.5;                  ///< [0.5, 10]; extents that the scene continues beyond the image
  double prior_sigma_px = 2;             ///< [0, 20]; Gaussian before every correction
  double output_sigma_px = 3;            ///< [0, 20]; Gaussian of the result; below 20 px of extent prior_sigma_px

  void validate() const;  ///< throws OptionError
};

/// Beyond the paper: the scene is estimated on a domain larger than the image, and only where the camera saw something
/// does the prediction have to agree with it. x = W y, then again and again z = G x, x = z + W [M (y - h z)], with the
/// blur h, its Wiener inverse W, a Gaussian G that stands for a smooth scene, and the mask M of what the camera saw.
/// Image: CV_8UC1; the result, too.
cv::Mat restore_beyond_borders(const cv::Mat& image, const LineBlur& blur, const RestorationOptions& options = {});

/// The baseline of Pretto et al. (ICRA 2009): DoG keypoints in a scale space that smooths less along the motion. See
/// the source for what is assumed. extent_px = 0 gives the ordinary DoG. Image: CV_8UC1. Keypoints as detect_dog().
std::vector<cv::KeyPoint> detect_motion_adapted_dog(const cv::Mat& image, const LineBlur& blur);

}  // namespace gyro_deblur::experiments
