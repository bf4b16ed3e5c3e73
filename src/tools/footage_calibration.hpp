// The calibration of a camera and its IMU from a recording.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calibrate/recorded_exposure.hpp"
#include "calibrate/self_calibration.hpp"
#include "calibrate/timing_calibration.hpp"
#include "calibrate/timing_checks.hpp"
#include "gyro_deblur/config.hpp"
#include "tools/timing_footage.hpp"

namespace gyro_deblur {

struct FootageCalibrationOptions {
  TimeNs search_ns = 500'000'000;
  bool fixed_readout = false, fixed_bias = false;
  bool estimate_rotation = false;  ///< although it is given
};

/// Where the exposure times in use are from.
enum class ExposureSourceOfFootage { MESSAGES, PARAMETER, IMAGES, UNKNOWN };

/// The estimates from one recording.
struct FootageCalibration {
  std::optional<TimingEstimate> timing;  ///< nothing: `timing_error` says why
  std::string timing_error;
  LearnedCalibration coarse;
  Estimate sensor_readout_s;  ///< of the whole sensor; the estimate's is that of the image's region of interest
  std::string rotation_from;  ///< "estimated", "as configured" or "tf"
  std::vector<TimingObjection> objections;
  RecordedExposure exposure;
  ExposureSourceOfFootage exposure_from = ExposureSourceOfFootage::UNKNOWN;
  ShutterTiming shutter;              ///< what stamps mean, and the exposure that holds for all images; 0: none does
  bool offset_has_exposure = false;   ///< time_offset contains half of an exposure that is not known
  std::vector<std::string> warnings;  ///< of what was found on the way

  /// Why the timing is not to be used; empty: nothing speaks against all of it.
  std::string refusal() const;
};

/// Whether a readout is too short to be distinguished from 0, or to matter.
bool is_global_shutter(const Estimate& readout_s);

/// Estimates timing, then the exposure with it, then timing again with an exposure that the images determined. If
/// timing cannot be estimated, the exposure is estimated with the motion that the configuration gives, else with
/// optical flow. Throws OptionError for bad options, and what for_each_picture() throws.
FootageCalibration calibrate_footage(const InputBag& input, const FootageTopics& topics,
                                     const FootageOptions& footage_options, const Footage& footage,
                                     const Config& config, const FootageCalibrationOptions& options);

}  // namespace gyro_deblur
