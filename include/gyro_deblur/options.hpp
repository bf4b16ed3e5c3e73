// Parameters of the algorithm and their defaults. Each has one row in src/config/parameters.cpp, which says what it is
// called, what values it takes and whether it may change while running; doc/guides/parameters.md prints them.
#pragma once

#include <string>

#include <Eigen/Core>

#include "gyro_deblur/option_error.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Blur field and its division into blocks (paper section IV).
struct BlurFieldOptions {
  int block_size_px = 64;  ///< a multiple of 2 so that Bayer planes divide into the same blocks
  /// Smaller blur is left alone. The paper's kernels start at 2 px; the filter gains 2.6 dB at 2.25 px with
  /// noise of 1 grey level and loses 0.3 dB with noise of 4, at 3 px it gains 3.4 and 0.9 dB
  /// (doc/reports/experiments.md).
  double min_extent_px = 3.0;
  double max_extent_px = 150.0;  ///< >= min_extent_px; larger blur is TOO_LARGE
  /// How far the path within the exposure may lie to either side of a straight line, less 2 % of the extent
  /// (kStraightPathShare); more is undone by the 2-D filter, which takes three times as long. At 0.1 px the box along
  /// the line restores 2.4, 2.3, 2.4, 2.4, 2.0, 1.9 and 1.7 dB less than the inverse of the whole path, for extents of
  /// 5, 10, 20, 40, 60, 90 and 120 px, on Oxford images with noise of 1.5 grey levels, at 1.5 px 9.7 to 2.6 dB less; on
  /// a straight line 1.4 to 0.1 dB less. Of a recorded shake of 30 ms and 20 px (doc/reports/hand_shake.md) 1.5, 0.8
  /// and 0.1 px leave 26, 48 and 68 % of the blocks to the 2-D filter, and 332, 389 and 398 SIFT matches with a sharp
  /// frame, of 225 where what is curved stays as it is.
  double curved_path_threshold_px = 0.8;

  void validate() const;  ///< throws OptionError
};

/// How a block's predicted blur is checked against its pixels.
enum class ValidationRule {
  /// Whether its power spectrum fits the predicted blur better than less blur, see BlurLikelihood: robust to noise, low
  /// contrast, hot pixels and saturation, and told by neighbours and frame where the block has too little texture. Of
  /// blur below 5 px a spectrum tells little, and the paper's rule is asked too.
  LIKELIHOOD,
  /// Whether its strongest gradient along the motion is below tau(r) = tau + tau_contrast / r (paper section III-D). A
  /// box of extent r cannot leave more than contrast / r grey levels a pixel, so the threshold falls with the extent;
  /// tau alone (tau_contrast = 0) is the paper's constant threshold.
  PAPER
};

/// Blur validation (paper section III-D). Grey levels are those of an 8-bit image; 16-bit images are scaled by their
/// significant bits.
struct ValidationOptions {
  bool enabled = true;
  ValidationRule rule = ValidationRule::LIKELIHOOD;
  /// Of blocks blurred by a third of what is predicted, how many may be accepted; of sharp ones it is two thirds as
  /// many. Measured over 18 photographs (experiments/validation.cpp), extents of 5 to 40 px, noise of 1 to 8 grey
  /// levels and contrasts of both 1 and .35; of truly blurred blocks .1 accepts 99 %, .02 89 %, .01 81 %. Recorded
  /// blur is a fifth longer than predicted at times (shield_burst, frame 3): .1 accepts 93 % of that, .07 88 %.
  /// Up to .052 blocks of which nothing is known are rejected, above they are accepted.
  double false_accept_rate = 0.1;
  /// The paper's rule. The defaults accept at least 98.6 % of truly blurred 64 px blocks at every extent from 5 to 90
  /// px (first images of the Oxford sets, noise up to 2 grey levels) and reject 68 / 86 / 94 / 97 / 97 % of sharp ones
  /// at 5 / 10 / 20 / 40 / 90 px.
  double tau = 6.0;             ///< grey levels / px: what noise and compression may add
  double tau_contrast = 200.0;  ///< grey levels: step that the scene may contain

  double threshold(double extent_px) const { return tau + tau_contrast / extent_px; }
  void validate() const;  ///< throws OptionError
};

/// What gamma and the taps of an inverse of limited length are found by.
enum class Regularization {
  /// As FIXED, with gamma doubled as often as makes the error least that noise and texture of the block let expect,
  /// see FilterBank::choose().
  /// Blocks that it would still lose by are left alone.
  NOISE,
  /// The taps that minimise |h * w - g|^2 + gamma (s |w'|^2 + (1 - s) |w|^2), h the blur, g a unit pulse (the Gaussian
  /// of smoothing_px), w' the steps from tap to tap and from and to 0 at the ends, under the condition that their sum
  /// is the filter's. The power of photographs falls with the square of the frequency (D. J. Field, J. Opt. Soc. Am. A
  /// 4 (12), 1987), that of noise does not, so that the noise-to-signal ratio rises with it, as |w'|^2 does. For s see
  /// spectral_share(); whatever it is, the ratio is gamma at 1/6 cycles/px.
  FIXED,
  /// The inverse transform of the Wiener filter with the same noise-to-signal ratio at every frequency, on as many
  /// samples (paths: on as many more as make the transform fast), as in the paper. What the filter has beyond them
  /// wraps around.
  PAPER
};

/// Wiener kernels (paper section IV-A).
struct FilterOptions {
  double gamma = 0.01;         ///< noise-to-signal ratio of the Wiener filter at 1/6 cycles/px, at least
  double length_factor = 4.0;  ///< length of the inverse kernel in extents
  /// Standard deviation of a Gaussian that the inverse is smoothed with along the line. Where the blur has left
  /// less than the noise, at the finest detail first, it leaves out what would be noise and ringing. Above 0 the
  /// kernels have no jumps at places that are known, which the fast engine makes use of: extents above 36 px are then
  /// filtered tap by tap.
  double smoothing_px = 0.0;
  Regularization regularization = Regularization::NOISE;

  void validate() const;  ///< throws OptionError
};

/// Noise of the camera's images, by its sensor's model: the variance is read_noise^2 + noise_gain * grey level. Grey
/// levels are those of an 8-bit image.
struct NoiseModel {
  double read_noise = 0;  ///< [grey levels]; both 0: noise is estimated from each image
  double noise_gain = 0;  ///< [grey levels], of light's own noise

  bool is_known() const { return read_noise > 0 || noise_gain > 0; }
  void validate() const;  ///< throws OptionError
};

/// Keypoint detection.
struct KeypointOptions {
  std::string detector = "SIFT";  ///< SIFT, ORB, AKAZE, BRISK, GFTT or FAST
  /// SIFT, ORB (not of SIFT's keypoints), AKAZE (of AKAZE's alone), BRISK or NONE
  std::string descriptor = "SIFT";
  int max_keypoints = 1000;  ///< strongest by response
  int grid_cols = 1;         ///< with more than one cell the limit is shared evenly among cells
  int grid_rows = 1;

  void validate() const;  ///< throws OptionError
};

/// Tracking of corners. The defaults are those of VINS-Mono's tracker for 752 x 480 px.
struct TrackerOptions {
  int max_tracks = 150;
  /// How far from the image's edge corners are started, a quarter of the image's height or width at most.
  /// Nearer to it a shake takes most of them out again within a few images. Tracks are followed to the edge itself.
  int border_px = 32;
  double min_distance_px = 30;     ///< between two tracks
  double max_round_trip_px = 1.0;  ///< how far from its start a corner may end up when tracked back
  double max_epipolar_px = 1.0;    ///< distance from the epipolar line
  int window_px = 21;              ///< odd: side of the patch that is compared
  int levels = 3;                  ///< halvings of the image

  void validate() const;  ///< throws OptionError
};

/// The instant at which rectified keypoints, and the global-shutter image, hold.
enum class RectifyTo { FIRST_ROW, MIDDLE_ROW, LAST_ROW, STAMP };

/// What a global-shutter image has where the rolling-shutter one ends.
enum class ImageBorder {
  BLACK,
  REPLICATE  ///< the nearest pixel
};

/// What to do when the blur says for seconds that an exposure time is another one than was given.
enum class OnExposureConflict {
  IMAGES,      ///< exposure_time is replaced by what the images say; a message's value is reported and kept
  CONFIGURED,  ///< what is given is reported and kept
};

/// Gyroscope input_buffers.
struct GyroOptions {
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();  ///< subtracted once, in RotationTrack
  TimeNs time_offset_ns = 0;                             ///< t_imu = t_cam + time_offset
  TimeNs buffer_ns = 5'000'000'000;                      ///< how much is kept
  TimeNs max_gap_ns = 50'000'000;                        ///< a longer hole between samples is not integrated across
  /// What the sensor can measure on each axis, before the bias is subtracted; 0: not known. A sample
  /// that reaches it tells no rate, see is_saturated.
  double range_rad_s = 0;

  void validate() const;  ///< throws OptionError
};

/// Everything about the algorithm that may change while running.
struct PipelineOptions {
  BlurFieldOptions blur_field;
  ValidationOptions validation;
  FilterOptions kernel;
  NoiseModel noise;
  KeypointOptions keypoints;
  bool optical_flow = true;  ///< what the gyroscope does not know of a motion, see ResidualFlow
  /// Which frames that the gyroscope does not cover go by the images alone: "absent", where there is no gyroscope or
  /// it is silent; "always", also at its gaps and where it is saturated; "never".
  std::string flow_without_gyro = "absent";
  RectifyTo rectify_to = RectifyTo::MIDDLE_ROW;
  ImageBorder global_shutter_border = ImageBorder::BLACK;
  std::string engine = "auto";  ///< see make_engine
  int threads = 0;              ///< of this package's loops, at most; 0: one for each core
  int significant_bits = 0;     ///< of 16-bit images, 8 to 16; 0: guessed, see BitDepth

  void validate() const;  ///< throws OptionError
};

/// The same value in every member: what was built with one need not be built again for the other.
bool operator==(const BlurFieldOptions& a, const BlurFieldOptions& b);
bool operator==(const FilterOptions& a, const FilterOptions& b);
bool operator==(const KeypointOptions& a, const KeypointOptions& b);

}  // namespace gyro_deblur
