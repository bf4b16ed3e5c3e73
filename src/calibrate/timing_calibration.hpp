// Estimates clock offset, readout time, gyroscope bias and extrinsic rotation from how the image moves.
#pragma once

#include <optional>
#include <stdexcept>
#include <vector>

#include <Eigen/Core>

#include "calibrate/frame_tracker.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The recording does not determine what was asked for; what() says why.
class TimingError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct TimingOptions {
  /// The readout is where the estimation begins, or what holds. The exposure is not used: frames have their own.
  ShutterTiming shutter;
  /// Where the search for the offset and the estimation of the bias begin, or the bias that holds. Pairs of frames
  /// across a gap between samples, or across a saturated sample, are left out.
  GyroOptions gyro;
  TimeNs search_ns = 500'000'000;  ///< [0, 5 s]: the offset lies at most this far from gyro's; 0: no search
  bool estimate_readout = true;
  bool estimate_bias = true;
  std::optional<Eigen::Matrix3d> R_cam_imu;  ///< absent: estimated from nothing
};

/// A value with its standard deviation, from how the value changes when parts of the recording are left out. It allows
/// for errors that the points of a second have in common, and, by experience, for those of tracking that never change.
struct Estimate {
  double value = 0;
  double stddev = 0;  ///< 0 when the value was not estimated
};

/// Mean rates between two frames, for a plot.
struct RatePair {
  TimeNs t_ns = 0;              ///< middle between the frames, camera clock
  Eigen::Vector3d image_rad_s;  ///< of the camera, as the image moved (a global shutter that only rotated)
  Eigen::Vector3d gyro_rad_s;   ///< of the camera, by the gyroscope with the estimated values
};

/// Where one point was found in a later frame of its window, less where it was predicted [px].
struct TimingResidual {
  double row_px = 0;             ///< in the later frame
  Eigen::Vector2d without_px;    ///< prediction: it does not move
  Eigen::Vector2d at_start_px;   ///< the rotation by the values after the search, before the estimation
  Eigen::Vector2d estimated_px;  ///< rotation and translation by the estimated values
};

struct TimingEstimate {
  Estimate time_offset_s;  ///< t_imu = t_cam + time_offset
  Estimate readout_s;      ///< first to one past the last row, signed
  Estimate bias_rad_s[3];
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
  Eigen::Vector3d rotation_stddev_rad = Eigen::Vector3d::Zero();  ///< about the camera's axes; 0 when not estimated
  double correlation = 0;  ///< [-1, 1] of the angular speeds of image and gyroscope at the offset that was searched for
  std::size_t pairs = 0;   ///< of frames that were used
  std::size_t points = 0;  ///< found again, each frame of a window counted
  double speed_per_s = 0;  ///< of the camera, root mean square of an axis, in depths of the scene a second
  double median_without_px = 0, median_at_start_px = 0, median_px = 0;  ///< of the residuals' lengths
  std::vector<RatePair> rates;
  std::vector<TimingResidual> residuals;
};

/// Compares the rotation by the gyroscope with the motion of points in the image. Coarse to fine: the offset where the
/// angular speeds correlate best; the rotation between the axes in closed form (Wahba's problem, by SVD), both for
/// a camera that only rotates; then all values together by robust least squares (Cauchy's weights, Levenberg-Marquardt)
/// on the points' positions, each predicted from the mean of its row's exposure in the first frame of its window to
/// that in a later one. The camera's translation in each window and the points' inverse depths are estimated with them
/// and eliminated by Schur complements, as in bundle adjustment (Triggs et al., 2000), so that of two frames only the
/// distance to the epipolar line counts, and of more also that a point has one depth. The mean speed of the
/// camera in the recording limits its translation in each window (empirical Bayes, MacKay 1992): for a camera that only
/// rotates both coordinates of every point count.
/// @param windows  in pixels of `camera`'s image; of two frames or more, the more of four the better
/// @param samples  IMU clock, strictly increasing
/// Throws OptionError for bad options, TimingError when the recording does not determine the values: too few pairs of
/// frames or points, no motion, no agreement of image and gyroscope, rotation about one axis only where the extrinsic
/// is wanted.
TimingEstimate estimate_timing(const Camera& camera, const std::vector<TrackWindow>& windows,
                               const std::vector<GyroSample>& samples, const TimingOptions& options);

}  // namespace gyro_deblur
