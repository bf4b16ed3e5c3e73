// Time offset and rotation at which the rates of gyroscope and images agree.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "calibrate/gyro_integral.hpp"
#include "calibrate/image_rate.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Time offset at which the rates of images and gyroscope correlate best, for any rotation between their axes and any
/// bias.
struct OffsetPeak {
  TimeNs offset_ns = 0;
  double correlation = 0;     ///< [0, 1] there
  TimeNs second_ns = 0;       ///< another offset, between which and the first they correlate less
  bool at_edge = false;       ///< of the search: they may correlate better beyond
  bool is_ambiguous = false;  ///< the second explains the images about as well
};

/// @param rates   of the images, covered by gyroscope samples at every offset of the search; at least one
/// @param center  of the search, which goes `search_ns` (> 0) to either side
/// The correlation of vectors, with the rotation that makes it largest (Wahba's problem): signs and directions count,
/// so that a motion whose speed alone repeats itself is not taken for one that repeats.
OffsetPeak search_rate_offset(const std::vector<ImageRate>& rates, const GyroIntegral& gyro, TimeNs center_ns,
                              TimeNs search_ns);

/// Parameters that fit gyroscope and images best: image rate = scale * R_cam_imu (gyroscope's rate - bias).
/// Of an unknown lens diag(scale, scale, 1) stands for the scale, and the changes of rates fit, which say nothing of
/// the bias.
struct RateAlignment {
  TimeNs offset_ns = 0;  ///< t_imu = t_cam + offset
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();  ///< IMU axes
  double readout_s = 0;                                  ///< from the first row to the last
  double scale = 1;  ///< translation and a wrong focal length are in it; of an unknown lens the true focal length
  /// Standard deviations (jackknife over parts of the time); those of rotation and bias are about the least certain
  /// axis.
  double offset_stddev_s = 0, rotation_stddev_rad = 0, bias_stddev_rad_s = 0, readout_stddev_s = 0, scale_stddev = 0;
  double correlation = 0;                                ///< [0, 1], without what disagrees
  double agreeing = 0;                                   ///< [0, 1] of the rates
  double spread_rad_s = 0;                               ///< of the differences, one axis
  Eigen::Vector3d main_axis = Eigen::Vector3d::UnitX();  ///< unit vector in camera axes: about which it rotated most
  double second_rad_s = 0;                               ///< root mean square of the rates about another axis
};

/// Robust least squares (Gauss-Newton with Cauchy's weights) from the offset on.
/// @param begin_ns  where the correlation is largest
/// Nothing if the gyroscope covers too few rates, or does not rotate.
std::optional<RateAlignment> align_rates(const std::vector<ImageRate>& rates, const GyroIntegral& gyro,
                                         TimeNs begin_ns);

}  // namespace gyro_deblur
