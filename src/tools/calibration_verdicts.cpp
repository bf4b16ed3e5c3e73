// Says how well each value of a calibration is known.
#include "tools/calibration_verdicts.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "base/format.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur {
namespace {

/// Why a value of the timing is not determined; empty: it is.
std::string reason_against(const FootageCalibration& found, const std::string& key, const std::string& missing) {
  if (!found.timing) return found.timing_error + (missing.empty() ? "" : ". Seen so far: " + missing);
  for (const TimingObjection& objection : found.objections) {
    if (objection.key.empty() || objection.key == key) return objection.text;
  }
  for (const TimingObjection& objection : found.objections) {
    if (objection.speaks_against_all) return objection.key + " is wrong, and this with it";
  }
  return {};
}

// These need found.timing, and hold where there is no reason against the value.

Verdict of_time_offset(const char* key, const FootageCalibration& found) {
  const Estimate& offset = found.timing->time_offset_s;
  std::string text = format("known to %.2f ms, by %zu points in %zu pairs of frames", 1e3 * offset.stddev,
                            found.timing->points, found.timing->pairs);
  if (found.offset_has_exposure) {
    text += ". Half of the exposure time, which is not known, is in it: it holds with stamp_phase: middle";
  }
  return {key, format("%+.6f +- %.6f s", offset.value, offset.stddev), VerdictState::KNOWN, text};
}

Verdict of_readout(const char* key, const FootageCalibration& found) {
  const Estimate& readout_s = found.sensor_readout_s;
  const std::string value = format("%+.6f +- %.6f s", readout_s.value, readout_s.stddev);
  if (readout_s.stddev == 0) return {key, value, VerdictState::GIVEN, "as given"};
  const char* shutter = is_global_shutter(readout_s) ? "a global shutter"
                        : readout_s.value > 0        ? "a rolling shutter"
                                                     : "a rolling shutter, last row first";
  return {key, value, VerdictState::KNOWN, format("known to %.2f ms: %s", 1e3 * readout_s.stddev, shutter)};
}

Verdict of_bias(const char* key, const FootageCalibration& found) {
  const Estimate* bias = found.timing->bias_rad_s;
  const std::string value = format("[%+.5f, %+.5f, %+.5f] +- [%.5f, %.5f, %.5f] rad/s", bias[0].value, bias[1].value,
                                   bias[2].value, bias[0].stddev, bias[1].stddev, bias[2].stddev);
  const double stddev_rad_s = std::max({bias[0].stddev, bias[1].stddev, bias[2].stddev});
  if (stddev_rad_s == 0) return {key, value, VerdictState::GIVEN, "as given"};
  return {key, value, VerdictState::KNOWN,
          format("known to %.5f rad/s. It changes with the temperature", stddev_rad_s)};
}

std::string rotation_text(const Eigen::Matrix3d& R) {
  std::string text;
  for (int i = 0; i < 9; ++i) text += format("%s%.4f", i == 0 ? "[" : ", ", R(i / 3, i % 3));
  return text + "]";
}

Verdict of_rotation(const char* key, const FootageCalibration& found) {
  const std::string value = rotation_text(found.timing->R_cam_imu);
  if (found.rotation_from != "estimated") {
    return {key, value, VerdictState::GIVEN, found.rotation_from + ", and the images agree"};
  }
  const Eigen::Vector3d stddev_deg = found.timing->rotation_stddev_rad * kDegPerRad;
  return {key, value, VerdictState::KNOWN,
          format("known to %.3f, %.3f and %.3f degrees about the camera's axes x, y and z", stddev_deg.x(),
                 stddev_deg.y(), stddev_deg.z())};
}

/// Why the images do not determine the exposure, and what to do.
std::pair<std::string, std::string> exposure_gap(const RecordedExposure& exposure, std::size_t frames) {
  const std::string few = format("%zu of %zu images determine it, 3 are needed: ", exposure.estimates, frames);
  switch (exposure.missing) {
    case ExposureNeed::TEXTURE:
      return {few + "the scene has too little texture", "Record another one, or set exposure_time"};
    case ExposureNeed::LIGHT:
      return {few + "noise hides the blur", "Record with more light, or set exposure_time"};
    case ExposureNeed::MOTION:
    case ExposureNeed::NOTHING:
      break;
  }
  constexpr double kClearlyLonger = 1.1;  // stamps scatter
  if (static_cast<double>(exposure.frame_interval_ns) >
      kClearlyLonger * static_cast<double>(exposure.longest_tried_ns)) {
    return {few + format("exposures up to %.3g s were tried, and at one frame in %.3g s it may be longer",
                         to_seconds(exposure.longest_tried_ns), to_seconds(exposure.frame_interval_ns)),
            "Set exposure_time"};
  }
  return {few + "their blur is too short, 6 px are needed", "Rotate the camera faster, or set exposure_time"};
}

/// How an exposure that is given agrees with the images.
std::string agreement_text(const std::optional<ExposureEstimate>& over_given, const std::string& source,
                           const std::string& remedy, const std::string& why_not) {
  if (!over_given) return source + "; not checked: " + why_not;
  const std::string says = format("blur is %.2f times (+- %.0f %%) what %s says", over_given->ratio,
                                  100 * over_given->log_stddev, source.c_str());
  if (!contradicts(*over_given)) return source + ", and the images agree: " + says;
  return says + ": " + remedy;
}

Verdict of_exposure(const FootageCalibration& found, std::size_t frames) {
  const RecordedExposure& exposure = found.exposure;
  const auto [why_not, remedy] = exposure_gap(exposure, frames);
  Verdict verdict{"exposure_time", {}, VerdictState::OPEN, {}};
  switch (found.exposure_from) {
    case ExposureSourceOfFootage::MESSAGES:
      verdict.state = VerdictState::GIVEN;
      verdict.value = "of each image";
      verdict.text =
          agreement_text(exposure.over_given, "the exposure message", "check exposure_source and its unit", why_not);
      return verdict;
    case ExposureSourceOfFootage::PARAMETER: {
      verdict.state = VerdictState::GIVEN;
      verdict.value = format("%.6f s", to_seconds(found.shutter.exposure_ns));
      std::optional<ExposureEstimate> over_given;
      if (exposure.is_known) {
        over_given = {to_seconds(exposure.exposure_ns) / to_seconds(found.shutter.exposure_ns), exposure.log_stddev};
      }
      verdict.text =
          agreement_text(over_given, "exposure_time", "it is kept (on_exposure_conflict: configured)", why_not);
      return verdict;
    }
    case ExposureSourceOfFootage::IMAGES:
      break;
    case ExposureSourceOfFootage::UNKNOWN:
      verdict.text = why_not + ". " + remedy;
      return verdict;
  }
  verdict.state = VerdictState::KNOWN;
  const std::string by = format("by the blur of %zu of %zu images", exposure.estimates, frames);
  if (exposure.varies) {
    verdict.value = format("%.6f to %.6f s", to_seconds(exposure.low_ns), to_seconds(exposure.high_ns));
    verdict.text =
        by + ". It changes from image to image: leave exposure_time empty, and it is estimated while running";
  } else {
    verdict.value = format("%.6f +- %.6f s", to_seconds(exposure.exposure_ns),
                           exposure.log_stddev * to_seconds(exposure.exposure_ns));
    verdict.text = format("known to %.1f %%, ", 100 * exposure.log_stddev) + by;
  }
  return verdict;
}

}  // namespace

const char* to_string(VerdictState state) {
  return state == VerdictState::KNOWN ? "known" : state == VerdictState::GIVEN ? "given" : "not determined";
}

std::vector<Verdict> verdicts_of(const FootageCalibration& found, std::size_t frames) {
  const LearnedCalibration& coarse = found.coarse;
  const auto of_timing = [&found](const char* key, const std::string& missing, const auto& of) {
    Verdict verdict = found.timing ? of(key, found) : Verdict{key, {}, VerdictState::OPEN, {}};
    const std::string reason = reason_against(found, key, missing);
    return reason.empty() ? verdict : Verdict{key, verdict.value, VerdictState::OPEN, reason};
  };
  return {of_timing("time_offset", coarse.time_offset_s.missing, of_time_offset),
          of_timing("readout_time", coarse.readout_s.missing, of_readout), of_exposure(found, frames),
          of_timing("gyro_bias", coarse.bias_rad_s.missing, of_bias),
          of_timing("R_cam_imu", coarse.R_cam_imu.missing, of_rotation)};
}

}  // namespace gyro_deblur
