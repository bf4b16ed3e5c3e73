// Parameters and constants of the algorithm. Each has one row in src/base/option_table.hpp with its key, allowed
// values, and whether it may change while running. doc/guides/parameters.md prints the parameters. A constant has the
// same value in every configuration; tests and experiments set its member.
#pragma once

#include <stdexcept>
#include <string>

#include <Eigen/Core>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// A parameter that cannot be used; what() names it, its value and the allowed range.
class OptionError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// Blur field and its division into blocks (paper section IV).
struct BlurFieldOptions {
  int block_size_px = 64;  ///< a multiple of 2, for Bayer mosaics
  /// Smaller blur is passed through: there noise costs more than deblurring gains (doc/reports/experiments.md).
  double min_extent_px = 3.0;
  double max_extent_px = 150.0;  ///< >= min_extent_px; larger blur is TOO_LARGE
  /// A path is curved if it deviates from a straight line by more than this plus 2 % of the extent
  /// (kStraightPathShare), or from uniform speed by more than this plus even_path_px(). Curved paths get the 2-D
  /// filter. Paths that deviate by less than 0.1 px gain no more by a 2-D filter than straight ones do
  /// (doc/reports/filter_constants.md).
  double curved_path_threshold_px = 0.1;

  void validate() const;  ///< throws OptionError
};

/// How a block is compared with its predicted blur.
enum class ValidationRule {
  /// The block's power spectrum has to fit the predicted blur better than less blur, see BlurLikelihood. Noise, low
  /// contrast, hot pixels and saturation do not deceive it. Blocks with little texture follow their neighbours and the
  /// frame. Blur below 5 px changes a spectrum little: there GRADIENT has to agree.
  LIKELIHOOD,
  /// The strongest gradient along the motion may be at most tau(r) = tau + tau_contrast / r (paper section III-D). A
  /// box of extent r cannot leave more than contrast / r grey levels a pixel, so the threshold falls with the extent.
  /// The paper's threshold is constant: tau_contrast = 0.
  GRADIENT,
  NONE  ///< no block is rejected
};

/// Blur validation (paper section III-D). Grey levels are those of an 8-bit image; 16-bit images are scaled by their
/// significant bits.
struct ValidationOptions {
  ValidationRule rule = ValidationRule::LIKELIHOOD;
  /// Constant: share that LIKELIHOOD may accept of blocks with a third of the predicted blur. More accepts blocks of
  /// objects that move by themselves, less rejects recorded blur whose path is roughly known
  /// (doc/reports/validation.md). Blocks without evidence are accepted from 0.025 on.
  double false_accept_rate = 0.1;
  double tau = 6.0;             ///< constant of GRADIENT: [grey levels / px] that noise and compression may add
  double tau_contrast = 200.0;  ///< constant of GRADIENT: [grey levels] of a step that the scene may contain

  double threshold(double extent_px) const { return tau + tau_contrast / extent_px; }
  void validate() const;  ///< throws OptionError
};

/// How the noise-to-signal ratio of a block and the taps of an inverse of limited length are found.
enum class Regularization {
  /// As FIXED, but noise_to_signal_ratio is doubled as often as makes the error least that noise and texture of the
  /// block predict. Blocks that would still become worse are passed through.
  ADAPTIVE,
  /// The taps that minimise |h * w - g|^2 + gamma (s |w'|^2 + (1 - s) |w|^2), gamma being noise_to_signal_ratio, h the
  /// blur, g a unit pulse, w' the steps from tap to tap and from and to 0 at the ends, under the condition that their
  /// sum is the filter's. The power of photographs falls with the square of the frequency (D. J. Field, J. Opt. Soc.
  /// Am. A 4 (12), 1987), that of noise does not, so that the noise-to-signal ratio rises with it, as |w'|^2 does. s
  /// falls linearly from 1 without blur to 0 at an extent of 36 px; whatever it is, the ratio is gamma at 1/6
  /// cycles/px.
  FIXED,
  /// The inverse transform of the Wiener filter with the same noise-to-signal ratio at every frequency, on as many
  /// samples (paths: on as many more as make the transform fast), as in the paper. What the filter has beyond them
  /// wraps around.
  PAPER
};

/// Wiener kernels (paper section IV-A).
struct FilterOptions {
  double noise_to_signal_ratio = 0.01;  ///< of the Wiener filter at 1/6 cycles/px, at least
  double length_factor = 4.0;           ///< constant: length of the inverse kernel in extents
  Regularization regularization = Regularization::ADAPTIVE;

  void validate() const;  ///< throws OptionError
};

/// Keypoint detection.
struct KeypointOptions {
  std::string detector = "SIFT";  ///< SIFT, ORB, AKAZE, BRISK, GFTT or FAST
  /// SIFT, ORB (not of SIFT's keypoints), AKAZE (of AKAZE's alone), BRISK or NONE
  std::string descriptor = "SIFT";
  int max_keypoints = 1000;  ///< strongest by response
  int grid = 1;              ///< the cells of a grid of that many columns and rows share the limit evenly

  void validate() const;  ///< throws OptionError
};

/// Tracking of corners. The values are those of VINS-Mono's tracker for 752 x 480 px, apart from border_px.
struct TrackerOptions {
  int max_tracks = 150;
  /// Constant: distance from the image's edge within which no track starts, at most a quarter of the image's height or
  /// width. Tracks are followed to the edge itself.
  int border_px = 32;
  double min_distance_px = 30;   ///< between two tracks
  double max_epipolar_px = 1.0;  ///< constant: distance from the epipolar line
  int window_px = 21;            ///< constant, odd: side of the compared window, up to twice as much in blur

  void validate() const;  ///< throws OptionError
};

/// The instant at which rectified keypoints, and the global-shutter image, hold. The rows have the order of StampRow.
enum class RectifyTo { FIRST_ROW, MIDDLE_ROW, LAST_ROW, STAMP };

/// What to do when the blur contradicts a given exposure time for seconds.
enum class OnExposureConflict {
  IMAGES,      ///< exposure_time is replaced by the estimate from the blur; a message's value is reported and kept
  CONFIGURED,  ///< what is given is reported and kept
};

/// Gyroscope samples.
struct GyroOptions {
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();  ///< subtracted once, in RotationTrack
  TimeNs time_offset_ns = 0;                             ///< t_imu = t_cam + time_offset
  TimeNs buffer_ns = 5'000'000'000;                      ///< constant: samples kept, for images that arrive late
  TimeNs max_gap_ns = 50'000'000;                        ///< a longer gap between samples is not integrated across
  /// What the sensor can measure on each axis, before the bias is subtracted; 0: not known. A sample
  /// that reaches it gives no rate, see is_saturated.
  double range_rad_s = 0;

  void validate() const;  ///< throws OptionError
};

/// Options of a Pipeline.
struct PipelineOptions {
  BlurFieldOptions blur_field;
  ValidationOptions validation;
  FilterOptions filter;
  KeypointOptions keypoints;
  bool optical_flow = true;  ///< image motion that the rotation does not explain, see ResidualFlow
  /// Which frames that the gyroscope does not cover are deblurred by optical flow alone: "absent", where there is no
  /// gyroscope, it is silent or the camera is not calibrated; "always", also at its gaps and where it is saturated;
  /// "never".
  std::string flow_without_gyro = "absent";
  RectifyTo rectify_to = RectifyTo::MIDDLE_ROW;
  std::string engine = "auto";  ///< auto, cpu, fourier, float, opencl, opencl:INDEX or opencl:NAME
  int threads = 0;              ///< of this package's loops, at most; 0: one for each core
  int significant_bits = 0;     ///< of 16-bit images, 8 to 16; 0: guessed, see BitDepth

  void validate() const;  ///< throws OptionError
};

/// The same value in every member: what was built with one need not be built again for the other.
bool operator==(const BlurFieldOptions& a, const BlurFieldOptions& b);
bool operator==(const FilterOptions& a, const FilterOptions& b);
bool operator==(const KeypointOptions& a, const KeypointOptions& b);

}  // namespace gyro_deblur
