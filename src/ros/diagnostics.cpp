#include "ros/diagnostics.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "base/median.hpp"
#include "gyro_deblur/frame_quality.hpp"
#include "ros/exposure_check.hpp"
#include "ros/pass_through.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

using diagnostic_msgs::DiagnosticStatus;
using diagnostic_updater::DiagnosticStatusWrapper;

/// What to do about frames that pass through unchanged.
const char* remedy(PassThroughReason reason) {
  switch (reason) {
    case PassThroughReason::NONE:
      return "";
    case PassThroughReason::NO_GYRO:
      return "check that the IMU publishes, its rate, and time_offset; compare the stamps of image and IMU";
    case PassThroughReason::NO_EXPOSURE_TIME:
      return "images are deblurred once the exposure time is estimated from their blur, which takes motion; set "
             "exposure_time, "
             "or "
             "publish an Exposure message with each image's stamp, to have them deblurred at once";
    case PassThroughReason::NO_CALIBRATION:
      return "publish camera_info with each image's stamp, calibrated for the image's size; where it contradicts "
             "calibration_file, correct one of them or set on_calibration_conflict: configured";
    case PassThroughReason::NO_EXTRINSIC:
      return "turn the camera about all axes, before a scene that stands still, until R_cam_imu is estimated; or "
             "set it, or publish a static transform between the frames of images and IMU; where these contradict each "
             "other, correct one of them or set on_calibration_conflict: configured";
    case PassThroughReason::UNSUPPORTED_ENCODING:
      return "have the driver publish mono8, bgr8, rgb8 or a Bayer encoding";
    case PassThroughReason::BAD_IMAGE:
      return "the image's data does not fit its header: mend the driver or the decoder";
    case PassThroughReason::BAD_CONFIGURATION:
      return "mend the parameter that the message names";
    case PassThroughReason::OVERLOAD:
      return "too slow: fewer max_keypoints, a faster detector (ORB), smaller images, or fewer subscribers";
    case PassThroughReason::TIME_JUMP:
      return "expected when a bag loops; otherwise synchronise the clocks";
    case PassThroughReason::INTERNAL_ERROR:
      return "the log has the error";
    case PassThroughReason::GYRO_SATURATED:
      return "the camera turns faster than the gyroscope measures: set a larger range in its driver and in gyro_range";
    case PassThroughReason::STEREO_PARTNER:
      return "see why the other image of the pair passes through, or set stereo_sync_timeout: 0 for cameras that are "
             "no "
             "pair";
    case PassThroughReason::NO_STAMP:
      return "have the driver stamp every image with the time of its exposure";
  }
  return "";
}

template <typename Key>
std::size_t count_of(const std::map<Key, std::size_t>& counts, const Key& key) {
  const auto found = counts.find(key);
  return found == counts.end() ? 0 : found->second;
}

void add_imu(const DiagnosticReport::Moment& now, DiagnosticStatusWrapper* status) {
  status->add("cameras on this gyroscope", now.cameras);
  status->add("imu dropped, not finite", now.statistics.imu_not_finite);
  status->add("imu dropped, duplicate", now.statistics.imu_duplicate);
  status->add("imu dropped, out of order", now.statistics.imu_out_of_order);
  status->add("imu dropped, stray stamp", now.statistics.imu_stray);
  status->add("imu dropped, without gyroscope", now.statistics.imu_without_gyroscope);
  status->add("imu saturated", now.statistics.imu_saturated);
}

/// What the images have shown to be wrong, and what to do.
std::string error_text(const GyroError& error, const Eigen::Vector3d& bias_rad_s) {
  char text[160];
  switch (error.kind) {
    case GyroError::Kind::BIAS:
      std::snprintf(text, sizeof(text), " rad/s beside the gyroscope for %.0f s: a bias; call ", error.seconds);
      return "the images turn by " + vector_text(-error.vector) + text +
             "estimate_gyro_bias at rest, or set gyro_bias to " + vector_text(bias_rad_s + error.vector);
    case GyroError::Kind::EXTRINSIC:
      std::snprintf(text, sizeof(text), "for %.0f s: R_cam_imu is off by about %.1f deg; calibrate it", error.seconds,
                    error.vector.norm() * 180 / M_PI);
      return std::string("the images turn about another axis than the gyroscope ") + text;
    case GyroError::Kind::TIME_OFFSET:
      std::snprintf(text, sizeof(text), "%s the gyroscope for %.0f s: add %.4f s to time_offset",
                    error.time_offset_s > 0 ? "before" : "after", error.seconds, error.time_offset_s);
      return std::string("the images turn ") + text;
  }
  return "";
}

void add_gyro_buffer(const DiagnosticReport::Moment& now, DiagnosticStatusWrapper* status) {
  const ProcessorStatistics& statistics = now.statistics;
  if (!statistics.newest_imu_ns) {
    status->add("gyroscope buffer [s]", "empty");
    return;
  }
  const TimeRange& available = statistics.gyro_available;
  status->addf("gyroscope buffer [s]", "%.3f", to_seconds(available.end_ns - available.begin_ns));
  status->addf("gyroscope age [s]", "%.3f", to_seconds(now.node_ns - *statistics.newest_imu_ns));
}

}  // namespace

void DiagnosticReport::Latency::add(double ms) {
  sum_ms += ms;
  max_ms = std::max(max_ms, ms);
  ++count;
}

void DiagnosticReport::start(const ProcessorStatistics& statistics, Time time) {
  const std::lock_guard<std::mutex> lock(mutex_);
  latencies_.clear();
  from_images_ = {};
  quality_ = {};
  last_ = statistics;
  last_time_ = time;
}

void DiagnosticReport::add(const FrameOutput& output) {
  const std::lock_guard<std::mutex> lock(mutex_);
  latencies_["waiting"].add(output.waiting_ms);
  latencies_["processing"].add(output.total_ms);
  if (output.quality) {
    ++quality_.grades[output.quality->grade];
    if (output.quality->score >= 0) quality_.score_sum += output.quality->score, ++quality_.scores;
  }
  if (output.exposure) exposure_ = output.exposure;
  if (output.exposure_terms) quality_.exposures.push_back(*output.exposure_terms);
  if (!output.field) return;
  latencies_["motion from images"].add(output.stages.flow_ms);
  latencies_["blur field"].add(output.stages.blur_field_ms);
  latencies_["exposure estimate"].add(output.stages.exposure_ms);
  latencies_["validation"].add(output.stages.validation_ms);
  latencies_["noise"].add(output.stages.noise_ms);
  latencies_["deconvolution"].add(output.stages.deconvolution_ms);
  latencies_["keypoints"].add(output.stages.keypoints_ms);
  latencies_["messages"].add(output.messages_ms);
  if (output.tracks) latencies_["tracks"].add(output.tracks_ms);
  if (output.global_shutter) latencies_["global shutter"].add(output.stages.global_shutter_ms);
  for (const BlockBlur& block : output.field->blocks) {
    if (!block.residual) continue;
    from_images_.blocks_px.push_back(block.residual->velocity_px_s.norm() * to_seconds(output.field->exposure_ns));
  }
  if (output.residual_rotation) {
    from_images_.rotation_sum_rad_s += output.residual_rotation->rate_rad_s;
    ++from_images_.rotations;
  }
}

void DiagnosticReport::fill(const Moment& now, DiagnosticStatusWrapper* status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!now.statistics.configuration_error.empty()) {
    status->summary(DiagnosticStatus::ERROR, now.statistics.configuration_error);
  } else {
    status->summary(DiagnosticStatus::OK, "running");
  }
  if (!now.statistics.keypoints_text.empty()) {
    status->mergeSummary(DiagnosticStatus::ERROR, "no keypoints: " + now.statistics.keypoints_text);
  }
  for (const auto& [kind, problem] : now.statistics.input_problems) {
    if (problem.active && problem.level != LogLevel::INFO) status->mergeSummary(DiagnosticStatus::WARN, problem.text);
  }
  add_frames(now, status);
  add_unsent(now, status);
  add_blocks(now, status);
  add_quality(now, status);
  add_exposure(status);
  add_exposure_advice(now, status);
  add_optical_flow(now, status);
  add_imu(now, status);
  for (const CalibrationRow& row : now.statistics.calibration) status->add("calibration, " + row.key, row.text);
  status->add("time jumps", now.statistics.time_jumps);
  add_gyro_buffer(now, status);
  add_latencies(status);
  status->add("engine", now.statistics.engine.empty() ? "none" : now.statistics.engine);
  latencies_.clear();
  from_images_ = {};
  quality_ = {};
  last_ = now.statistics;
  last_unsent_ = now.unsent;
  last_time_ = now.time;
}

void DiagnosticReport::add_frames(const Moment& now, DiagnosticStatusWrapper* status) const {
  const ProcessorStatistics& statistics = now.statistics;
  const double period_s = std::chrono::duration<double>(now.time - last_time_).count();
  const auto rate = [period_s](std::size_t newer, std::size_t older) {
    return static_cast<double>(newer - older) / period_s;
  };
  status->addf("input rate [Hz]", "%.1f", rate(statistics.frames_in, last_.frames_in));
  status->addf("output rate [Hz]", "%.1f", rate(statistics.frames_out, last_.frames_out));
  status->addf("gyroscope rate [Hz]", "%.1f", rate(statistics.imu_accepted, last_.imu_accepted));
  status->add("frames in", statistics.frames_in);
  status->add("frames out", statistics.frames_out);
  status->add("frames waiting", statistics.waiting);
  status->add("compressed images left out, not decodable", statistics.undecodable_images);
  const std::size_t undecodable = statistics.undecodable_images - last_.undecodable_images;
  if (undecodable > 0) {
    status->mergeSummaryf(DiagnosticStatus::WARN,
                          "%zu compressed images could not be decoded and are left out: check the camera's cable, its "
                          "bandwidth and its driver",
                          undecodable);
  }
  for (const auto& [reason, count] : statistics.passed_through) {
    status->add(std::string("passed through, ") + to_string(reason), count);
    const std::size_t fresh = count - count_of(last_.passed_through, reason);
    if (fresh > 0) {
      status->mergeSummaryf(DiagnosticStatus::WARN, "%zu frames passed through: %s; %s", fresh, to_string(reason),
                            remedy(reason));
    }
  }
}

void DiagnosticReport::add_unsent(const Moment& now, DiagnosticStatusWrapper* status) const {
  status->add("messages published, not sent", now.unsent);
  const std::size_t fresh = now.unsent - last_unsent_;
  if (fresh > 0) {
    status->mergeSummaryf(DiagnosticStatus::WARN,
                          "%zu messages published, but not sent: a subscriber reads too slowly, or over a slow network",
                          fresh);
  }
}

void DiagnosticReport::add_blocks(const Moment& now, DiagnosticStatusWrapper* status) const {
  for (const auto& [block_status, count] : now.statistics.blocks) {
    status->add(std::string("blocks, ") + to_string(block_status), count);
  }
  for (const auto& [reason, count] : now.statistics.fallback_counts) {
    status->add("blocks on the float engine, " + reason, count);
  }
  const auto fresh = [&](BlockStatus block_status) {
    return count_of(now.statistics.blocks, block_status) - count_of(last_.blocks, block_status);
  };
  const std::size_t rejected = fresh(BlockStatus::REJECTED), judged = rejected + fresh(BlockStatus::DEBLURRED);
  if (2 * rejected > judged) {
    status->mergeSummaryf(
        DiagnosticStatus::WARN,
        "%zu of %zu blurred blocks rejected: the images contradict the predicted blur; check R_cam_imu, "
        "time_offset and exposure_time with blur_overlay",
        rejected, judged);
  }
}

void DiagnosticReport::add_quality(const Moment& now, DiagnosticStatusWrapper* status) const {
  std::size_t frames = 0;
  for (const auto& [grade, count] : quality_.grades) frames += count;
  for (const auto& [grade, count] : quality_.grades) {
    status->addf(std::string("images, ") + to_string(static_cast<QualityGrade>(grade)) + " [%]", "%.0f",
                 100 * static_cast<double>(count) / static_cast<double>(frames));
  }
  if (quality_.scores > 0) {
    status->addf("score of images, mean", "%.2f", quality_.score_sum / static_cast<double>(quality_.scores));
  }
  status->add("images dropped, POOR", now.statistics.dropped_bad);
  const std::size_t fresh = now.statistics.dropped_bad - last_.dropped_bad;
  if (fresh > 0) {
    status->mergeSummaryf(DiagnosticStatus::WARN,
                          "%zu images dropped by drop_poor: they, or their partners, are POOR; see image_quality",
                          fresh);
  }
}

void DiagnosticReport::add_exposure(DiagnosticStatusWrapper* status) const {
  if (!exposure_) return;
  const ChosenExposure& chosen = exposure_->chosen;
  status->add("exposure time, from", to_string(chosen.origin));
  if (chosen.origin == ExposureOrigin::ASSUMED) {
    const std::string need = to_string(exposure_->need);
    status->add("exposure time, waits for", need.empty() ? "motion" : need);
    return;
  }
  status->addf("exposure time [ms]", "%.2f", to_seconds(chosen.exposure_ns) * 1e3);
  if (chosen.log_stddev > 0) status->addf("exposure time, standard deviation [%]", "%.1f", 100 * chosen.log_stddev);
}

void DiagnosticReport::add_exposure_advice(const Moment& now, DiagnosticStatusWrapper* status) const {
  if (quality_.exposures.empty()) return;
  // The advice has to hold while the camera moves fast: of ten frames one is faster.
  std::vector<ExposureTerms> exposures = quality_.exposures;
  const auto fast = exposures.begin() + static_cast<std::ptrdiff_t>(exposures.size() * 9 / 10);
  std::nth_element(exposures.begin(), fast, exposures.end(),
                   [](const ExposureTerms& a, const ExposureTerms& b) { return a.speed_px_s < b.speed_px_s; });
  status->addf("speed of the image, p90 [px/s]", "%.0f", fast->speed_px_s);
  // The longest that exposure_time may be.
  constexpr TimeNs kLongestNs = 1'000'000'000;
  const TimeNs period_ns = now.statistics.frame_period_ns.value_or(kLongestNs);
  const auto advice = advise_exposure(*fast, std::clamp(period_ns, TimeNs{1}, kLongestNs));
  if (!advice) {
    status->add("longest exposure that is undone well [ms]", "none: POOR at any, too dark for this motion");
    return;
  }
  status->addf("longest exposure that is undone well [ms]", "%.1f", to_seconds(advice->longest_ns) * 1e3);
  status->addf("exposure with most corners [ms]", "%.1f", to_seconds(advice->best_ns) * 1e3);
}

void DiagnosticReport::add_optical_flow(const Moment& now, DiagnosticStatusWrapper* status) const {
  status->add("blocks with motion from images", now.statistics.blocks_from_images);
  status->add("frames by images alone", now.statistics.frames_by_images_alone);
  if (!from_images_.blocks_px.empty()) {
    status->addf("motion from images, median [px]", "%.2f", median(from_images_.blocks_px));
  }
  if (from_images_.rotations > 0) {
    status->add("rotation beside the gyroscope, mean [rad/s]",
                vector_text(from_images_.rotation_sum_rad_s / static_cast<double>(from_images_.rotations)));
  }
  if (now.statistics.gyro_error) {
    status->mergeSummary(DiagnosticStatus::WARN, error_text(*now.statistics.gyro_error, now.statistics.bias_rad_s));
  }
}

void DiagnosticReport::add_latencies(DiagnosticStatusWrapper* status) const {
  for (const auto& [stage, latency] : latencies_) {
    status->addf(stage + " mean [ms]", "%.2f", latency.sum_ms / static_cast<double>(latency.count));
    status->addf(stage + " max [ms]", "%.2f", latency.max_ms);
  }
}

}  // namespace gyro_deblur
