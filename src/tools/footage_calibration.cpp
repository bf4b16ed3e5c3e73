// Calibrates a camera and its IMU from a recording.
#include "tools/footage_calibration.hpp"

#include <algorithm>
#include <cmath>

#include "base/format.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

/// The readout of an image's region of interest, of that of the sensor.
TimeNs image_readout_ns(const Config& config, const Footage& footage) {
  return to_ns(to_seconds(config.shutter.readout_ns) * footage.readout_part);
}

TimingOptions timing_options(const FootageCalibrationOptions& options, const Config& config, const Footage& footage) {
  TimingOptions timing;
  timing.shutter = config.shutter;
  timing.shutter.readout_ns = image_readout_ns(config, footage);
  timing.gyro = config.gyro;
  timing.search_ns = options.search_ns;
  timing.estimate_readout = !options.fixed_readout;
  timing.estimate_bias = !options.fixed_bias;
  if (!options.estimate_rotation) timing.R_cam_imu = config.R_cam_imu ? config.R_cam_imu : footage.R_cam_imu;
  return timing;
}

/// Where the stamps do not overlap at an offset that the search reaches, it goes around the offset by which messages
/// were recorded at the same time, or, where stamps do not overlap at that either (a bag that was written by its
/// stamps), widely around the difference of their beginnings.
void search_distant_clocks(const Footage& footage, TimingOptions* timing, FootageCalibration* found) {
  if (footage.samples.empty()) return;
  const TimeRange imu{footage.samples.front().t_ns, footage.samples.back().t_ns}, images = footage.images;
  const auto apart_ns = [&](TimeNs offset_ns) {
    return std::max({TimeNs{0}, imu.begin_ns - (images.end_ns + offset_ns), images.begin_ns + offset_ns - imu.end_ns});
  };
  const TimeNs configured_ns = timing->gyro.time_offset_ns;
  if (apart_ns(configured_ns) <= timing->search_ns) return;
  timing->gyro.time_offset_ns = footage.image_delay_ns - footage.imu_delay_ns;
  if (apart_ns(timing->gyro.time_offset_ns) > 0) {
    constexpr TimeNs kWide = 5'000'000'000;  // the most that TimingOptions allow
    timing->gyro.time_offset_ns = imu.begin_ns - images.begin_ns;
    timing->search_ns = kWide;
  }
  found->warnings.push_back("the stamps of images and IMU do not overlap: images from " +
                            seconds_text(images.begin_ns) + " to " + seconds_text(images.end_ns) + " s, IMU from " +
                            seconds_text(imu.begin_ns) + " to " + seconds_text(imu.end_ns) +
                            " s, which with time_offset = " + seconds_text(configured_ns) + " s are " +
                            seconds_text(apart_ns(configured_ns)) + " s apart: searching around " +
                            std::to_string(to_seconds(timing->gyro.time_offset_ns)) + " s");
}

/// As estimated; as configured where nothing was, and enough is given; else nothing.
std::optional<RotationTrack> motion_of(const FootageCalibration& found, const TimingOptions& options,
                                       const Config& config, const Footage& footage) {
  GyroOptions gyro = config.gyro;
  if (found.timing && found.refusal().empty()) {
    gyro.time_offset_ns = to_ns(found.timing->time_offset_s.value);
    for (int axis = 0; axis < 3; ++axis) gyro.bias_rad_s[axis] = found.timing->bias_rad_s[axis].value;
    return RotationTrack(footage.samples, gyro, found.timing->R_cam_imu);
  }
  if (!config.given.time_offset || !options.R_cam_imu) return std::nullopt;
  return RotationTrack(footage.samples, gyro, *options.R_cam_imu);
}

RecordedExposure estimate_exposures(const InputBag& input, const FootageTopics& topics,
                                    const FootageOptions& footage_options, const Footage& footage, const Config& config,
                                    const FootageCalibration& found, const TimingOptions& options) {
  ShutterTiming shutter = config.shutter;
  shutter.readout_ns = found.timing && found.refusal().empty() ? to_ns(found.timing->readout_s.value)
                                                               : image_readout_ns(config, footage);
  RecordedExposureEstimator estimator(footage.camera, shutter, config.pipeline,
                                      motion_of(found, options, config, footage));
  for_each_picture(input, topics, footage_options, "images examined for blur", [&](const FootagePicture& picture) {
    const auto message = footage.message_exposures_ns.find(picture.stamp_ns);
    std::optional<TimeNs> given_ns;
    if (message != footage.message_exposures_ns.end()) given_ns = message->second;
    const TimeNs middle_ns = picture.stamp_ns + middle_after_stamp_ns(config.shutter.stamp_phase,
                                                                      given_ns.value_or(config.shutter.exposure_ns));
    estimator.add(picture.stamp_ns, middle_ns, picture.pixels.image, picture.pixels.layout, given_ns);
  });
  return estimator.result();
}

/// The coarse offset contains half of what readout and exposure were wrong by: takes that out.
/// @param exposure_ns  what the exposure was wrong by
LearnedCalibration corrected_offset(LearnedCalibration coarse, const TimingEstimate& timing,
                                    const TimingOptions& options, TimeNs exposure_ns) {
  const double readout_s = timing.readout_s.value - to_seconds(options.shutter.readout_ns);
  coarse.time_offset_s.value -= readout_to_middle(options.shutter.stamp_row) * readout_s;
  coarse.time_offset_s.value -= to_seconds(middle_after_stamp_ns(options.shutter.stamp_phase, exposure_ns));
  return coarse;
}

/// Whether the images contradict a constant exposure.
bool is_contradicted(TimeNs given_ns, const RecordedExposure& exposure) {
  if (!exposure.is_known || exposure.varies) return exposure.is_known;
  return contradicts({static_cast<double>(exposure.exposure_ns) / static_cast<double>(given_ns), exposure.log_stddev});
}

/// Whether messages give the exposure. Some may have been lost; images without one take that of their neighbours while
/// the camera is in use.
bool has_messages(const Footage& footage) {
  constexpr double kShare = 0.9;
  return static_cast<double>(footage.message_exposures_ns.size()) >= kShare * static_cast<double>(footage.frames);
}

/// Decides between messages, exposure_time and the estimate.
void choose_exposure(const Footage& footage, const Config& config, FootageCalibration* found) {
  RecordedExposure& exposure = found->exposure;
  if (exposure.is_known) {
    try {
      footage.period.require_plausible_exposure("exposure_time",
                                                exposure.varies ? exposure.high_ns : exposure.exposure_ns);
    } catch (const OptionError& error) {
      found->warnings.push_back(std::string("the exposure by the images is not used: ") + error.what());
      exposure.is_known = false;
    }
  }
  found->shutter = config.shutter;
  const bool replaces = config.on_exposure_conflict == OnExposureConflict::IMAGES;
  if (has_messages(footage)) {
    found->exposure_from = ExposureSourceOfFootage::MESSAGES;
  } else if (config.shutter.exposure_ns > 0 && !(replaces && is_contradicted(config.shutter.exposure_ns, exposure))) {
    found->exposure_from = ExposureSourceOfFootage::PARAMETER;
  } else if (exposure.is_known) {
    found->exposure_from = ExposureSourceOfFootage::IMAGES;
    found->shutter.exposure_ns = exposure.varies ? 0 : exposure.exposure_ns;
  }
}

/// The windows with the exposures that were estimated.
std::vector<TrackWindow> with_exposures(const Footage& footage, const RecordedExposure& exposure) {
  std::vector<TrackWindow> windows = footage.windows;
  for (TrackWindow& window : windows) {
    for (FrameTime& frame : window.frames) {
      if (footage.message_exposures_ns.count(frame.stamp_ns) == 0) {
        frame.exposure_ns = exposure.exposure_of(frame.stamp_ns);
      }
    }
  }
  return windows;
}

void warn_of_messages(const Footage& footage, FootageCalibration* found) {
  const std::size_t with_message = footage.message_exposures_ns.size();
  if (with_message > 0 && with_message < footage.frames) {
    found->warnings.push_back(std::to_string(footage.frames - with_message) + " of " + std::to_string(footage.frames) +
                              " images have no exposure message");
  }
  if (found->timing && footage.message_readout_ns) {
    found->warnings.push_back("the exposure messages bring a readout time of " +
                              std::to_string(to_seconds(*footage.message_readout_ns)) +
                              " s of their own, which holds before readout_time");
  }
}

}  // namespace

bool is_global_shutter(const Estimate& readout_s) {
  constexpr double kSignificance = 3, kShortS = 0.5e-3;
  return std::abs(readout_s.value) < std::max(kSignificance * readout_s.stddev, kShortS);
}

std::string FootageCalibration::refusal() const {
  if (!timing) return timing_error;
  std::string text;
  for (const TimingObjection& objection : objections) {
    if (objection.speaks_against_all) text += (text.empty() ? "" : "; ") + objection.text;
  }
  return text;
}

FootageCalibration calibrate_footage(const InputBag& input, const FootageTopics& topics,
                                     const FootageOptions& footage_options, const Footage& footage,
                                     const Config& config, const FootageCalibrationOptions& options) {
  FootageCalibration found;
  TimingOptions timing = timing_options(options, config, footage);
  search_distant_clocks(footage, &timing, &found);
  const Camera camera(footage.camera);
  found.rotation_from = !timing.R_cam_imu ? "estimated" : config.R_cam_imu ? "as configured" : "tf";
  // Shorter footage determines nothing, and the reason is always that it is too short.
  constexpr TimeNs kShortestNs = 2'000'000'000;
  if (footage.images.end_ns - footage.images.begin_ns >= kShortestNs) {
    found.coarse = coarse_calibration(footage.rates, footage.samples, timing.gyro.time_offset_ns, timing.search_ns);
  }
  const auto estimate = [&](const std::vector<TrackWindow>& windows, TimeNs exposure_error_ns) {
    try {
      found.timing = estimate_timing(camera, windows, footage.samples, timing);
      found.objections = timing_objections(*found.timing, timing, footage.period,
                                           corrected_offset(found.coarse, *found.timing, timing, exposure_error_ns));
    } catch (const TimingError& error) {
      found.timing.reset();
      found.timing_error = error.what();
    }
  };
  estimate(footage.windows, 0);
  found.exposure = estimate_exposures(input, topics, footage_options, footage, config, found, timing);
  choose_exposure(footage, config, &found);
  if (found.exposure_from == ExposureSourceOfFootage::IMAGES && found.timing) {
    estimate(with_exposures(footage, found.exposure), found.exposure.exposure_ns - config.shutter.exposure_ns);
    // Half of the exposure's error is in the offset.
    const TimeNs half_ns = middle_after_stamp_ns(config.shutter.stamp_phase, found.exposure.exposure_ns);
    if (found.timing) {
      double& stddev_s = found.timing->time_offset_s.stddev;
      stddev_s = std::hypot(stddev_s, to_seconds(half_ns) * found.exposure.log_stddev);
    }
  }
  if (found.timing) {
    found.sensor_readout_s = {found.timing->readout_s.value / footage.readout_part,
                              found.timing->readout_s.stddev / footage.readout_part};
  }
  found.offset_has_exposure = found.exposure_from == ExposureSourceOfFootage::UNKNOWN &&
                              config.shutter.stamp_phase != StampPhase::MIDDLE && footage.message_exposures_ns.empty();
  if (found.offset_has_exposure) found.shutter.stamp_phase = StampPhase::MIDDLE;
  warn_of_messages(footage, &found);
  return found;
}

}  // namespace gyro_deblur
