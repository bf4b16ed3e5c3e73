// Bursts sharp - blurred - sharp of a planar scene, and the homography between the blurred frames of two of them
// (paper section V-B).
#pragma once

#include <array>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "evaluation.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur::experiments {

/// Frames of a burst, in order of time.
enum BurstIndex { FIRST = 0, MIDDLE = 1, LAST = 2 };

struct BurstFrame {
  cv::Mat image;           ///< CV_8UC1, of the calibration's size
  TimeNs stamp_ns = 0;     ///< camera clock, by the convention in Burst::config
  TimeNs exposure_ns = 0;  ///< (0, 1 s]
};

/// Three frames with what is needed to deblur them.
struct Burst {
  std::array<BurstFrame, 3> frames;  ///< by BurstIndex: short, long and short exposure
  CameraCalibration calibration;
  Config config;                 ///< readout, stamp convention, clock offset, extrinsic (required) and bias
  std::vector<GyroSample> gyro;  ///< IMU clock

  RowExposure exposure(BurstIndex frame) const;
};

/// Reads FOLDER/burst.yaml and the images it names:
///   images: [first, middle, last]            file names in the folder
///   stamps: [t, t, t]                        [ns] camera clock
///   exposure_times: [e, e, e]                [s]
///   size: [w, h], intrinsics: [fx, fy, cx, cy], distortion_model, distortion_coefficients   as in camera_info
///   config: {readout_time: ..., R_cam_imu: ..., ...}   as in config/default.yaml
///   gyro: [[t, wx, wy, wz], ...]             [ns, rad/s] IMU clock and axes
/// Throws OptionError that names the file and the key.
Burst load_burst(const std::string& folder);

/// Writes what load_burst reads, into a folder that exists. Throws std::runtime_error with the path.
void save_burst(const std::string& folder, const Burst& burst);

/// Where a point that moves in a straight line at even speed from `first_px` (seen in the first frame) to `last_px`
/// (seen in the last) is seen in the middle frame. All three are seen at the middle of their own row's exposure, so
/// that frames need not be evenly spaced and rows may be exposed one after the other.
Eigen::Vector2d interpolate_to_middle(const Eigen::Vector2d& first_px, const Eigen::Vector2d& last_px,
                                      const Burst& burst);

/// Points of the middle frame, found in the sharp ones.
struct BurstPoints {
  std::vector<cv::Point2f> middle_px;
  cv::Mat descriptors;  ///< of the first frame; row i belongs to point i
};

struct ProtocolOptions {
  int max_keypoints = 3000;    ///< [10, 100000] of each sharp image
  double max_ratio = 0.8;      ///< (0, 1] nearest over second nearest descriptor distance (Lowe 2004)
  double burst_ransac_px = 5;  ///< (0, 100] within a burst: a rolling shutter leaves no exact homography
  double pair_ransac_px = 3;   ///< (0, 100] between the middle frames

  void validate() const;  ///< throws OptionError
};

/// Matches the sharp frames of a burst, removes outliers with RANSAC and interpolates.
BurstPoints interpolated_points(const Burst& burst, const ProtocolOptions& options);

/// Homography from the middle frame of one burst to that of another.
struct PairHomography {
  Homography H_2_1;
  int matches = 0;  ///< of interpolated points
  int inliers = 0;
  double residual_px = 0;  ///< RMS of the inliers in image 2
};

/// Throws std::runtime_error with the counts when the points do not give one.
PairHomography estimate_pair_homography(const BurstPoints& points1, const BurstPoints& points2,
                                        const ProtocolOptions& options);

}  // namespace gyro_deblur::experiments
