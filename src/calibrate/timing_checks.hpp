// Checks whether a recording determines the values that were estimated from it.
#pragma once

#include <string>
#include <vector>

#include "calibrate/self_calibration.hpp"
#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur {

/// Why a value should not be used.
struct TimingObjection {
  std::string key;                  ///< time_offset, readout_time, gyro_bias or R_cam_imu; empty: any of them
  std::string text;                 ///< values, what is allowed, remedy
  bool speaks_against_all = false;  ///< a wrong value of this key makes the others wrong
};

/// Objections to an estimate; empty: none. Reasons: images that do not move, or not as the gyroscope does (stabilised
/// ones); an offset at the limit of the search, hardly determined, or contradicted by the coarse one; a readout longer
/// than the frame period; a rotation that is hardly determined.
/// @param options  that the estimate was made with
/// @param period   of the images
/// @param coarse   the same values from the rates of images and gyroscope
std::vector<TimingObjection> timing_objections(const TimingEstimate& estimate, const TimingOptions& options,
                                               const FramePeriod& period, const LearnedCalibration& coarse);

/// The values from rates of images and gyroscope, as they are found while the camera is in use, and what is missing to
/// know them.
/// @param rates    in the order of time
/// @param samples  strictly increasing
/// Throws OptionError for a search that is not allowed.
LearnedCalibration coarse_calibration(const std::vector<ImageRate>& rates, const std::vector<GyroSample>& samples,
                                      TimeNs time_offset_ns, TimeNs search_ns);

}  // namespace gyro_deblur
