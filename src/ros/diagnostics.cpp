// Composes the diagnostic statuses.
#include "ros/diagnostics.hpp"

#include <algorithm>
#include <cmath>

#include "base/format.hpp"
#include "base/median.hpp"
#include "blur/frame_quality.hpp"
#include "features/residual_rotation.hpp"
#include "sync/exposure_check.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {
namespace {

using diagnostic_msgs::DiagnosticStatus;
using diagnostic_updater::DiagnosticStatusWrapper;

template <typename Key>
std::size_t count_of(const std::map<Key, std::size_t>& counts, const Key& key) {
  const auto found = counts.find(key);
  return found == counts.end() ? 0 : found->second;
}

/// Counters that are zero are left out.
void add_count(const std::string& key, std::size_t count, DiagnosticStatusWrapper* status) {
  if (count > 0) status->add(key, count);
}

/// "NAME COUNT, NAME COUNT" in one value, however many names there are.
template <typename Counts, typename NameOf>
void add_counts(const std::string& key, const Counts& counts, const NameOf& name_of, DiagnosticStatusWrapper* status) {
  std::string text;
  for (const auto& [named, count] : counts) {
    if (count > 0) text += (text.empty() ? "" : ", ") + std::string(name_of(named)) + ' ' + std::to_string(count);
  }
  if (!text.empty()) status->add(key, text);
}

/// The status that a problem of an input belongs to.
DiagnosticStatusWrapper& status_of(const std::string& kind, DiagnosticStatuses* statuses) {
  const auto has = [&kind](const char* part) { return kind.find(part) != std::string::npos; };
  if (kind.rfind("imu", 0) == 0 || kind == "no imu") return statuses->imu;
  if (kind == "clocks") return statuses->timing;
  for (const char* part : {"exposure", "camera_info", "readout_time", "extrinsic", "calibration", "by images"}) {
    if (has(part)) return statuses->calibration;
  }
  return statuses->image;
}

/// What the images have shown to be wrong, and what to do.
std::string error_text(const GyroError& error, const Eigen::Vector3d& bias_rad_s) {
  switch (error.kind) {
    case GyroError::Kind::BIAS:
      return "the images rotate by " + vector_text(-error.vector) +
             format(" rad/s relative to the gyroscope for %.0f s: a bias; leave gyro_bias empty and ", error.seconds) +
             "let the camera rest for a while, or set gyro_bias to " + vector_text(bias_rad_s + error.vector);
    case GyroError::Kind::EXTRINSIC:
      return format(
          "the images rotate about another axis than the gyroscope for %.0f s: R_cam_imu is off by about "
          "%.1f deg; calibrate it",
          error.seconds, error.vector.norm() * 180 / M_PI);
    case GyroError::Kind::TIME_OFFSET:
      return format("the images rotate %s the gyroscope for %.0f s: add %.4f s to time_offset",
                    error.time_offset_s > 0 ? "before" : "after", error.seconds, error.time_offset_s);
  }
  return "";
}

}  // namespace

void DiagnosticReport::Latency::add(double ms) {
  sum_ms += ms;
  max_ms = std::max(max_ms, ms);
  ++count;
}

void DiagnosticReport::start(const ProcessorStatistics& statistics, Time time) {
  const std::lock_guard<std::mutex> lock(mutex_);
  period_ = {};
  last_ = statistics;
  last_time_ = time;
}

void DiagnosticReport::add(const FrameOutput& output) {
  const std::lock_guard<std::mutex> lock(mutex_);
  period_.latencies["waiting"].add(output.waiting_ms);
  period_.latencies["processing"].add(output.total_ms);
  if (output.quality) {
    ++period_.grades[output.quality->grade];
    if (output.quality->score >= 0) period_.score_sum += output.quality->score, ++period_.scores;
  }
  if (output.exposure) exposure_ = output.exposure;
  if (output.exposure_terms) period_.exposures.push_back(*output.exposure_terms);
  if (!output.field) return;
  period_.latencies["optical flow"].add(output.times.flow_ms);
  period_.latencies["blur field"].add(output.times.blur_field_ms);
  period_.latencies["exposure estimate"].add(output.times.exposure_ms);
  period_.latencies["validation"].add(output.times.validation_ms);
  period_.latencies["noise"].add(output.times.noise_ms);
  period_.latencies["deconvolution"].add(output.times.deconvolution_ms);
  period_.latencies["keypoints"].add(output.times.keypoints_ms);
  period_.latencies["messages"].add(output.messages_ms);
  if (output.tracks || output.global_shutter_tracks) period_.latencies["tracks"].add(output.tracks_ms);
  if (output.global_shutter) period_.latencies["global shutter"].add(output.times.global_shutter_ms);
  for (const BlockBlur& block : output.field->blocks) {
    if (!block.residual) continue;
    period_.flow_px.push_back(block.residual->velocity_px_s.norm() * to_seconds(output.field->exposure_ns));
  }
  if (output.residual_rotation) {
    period_.rotation_sum_rad_s += output.residual_rotation->rate_rad_s;
    ++period_.rotations;
  }
}

DiagnosticStatuses DiagnosticReport::fill(const Moment& now) {
  const std::lock_guard<std::mutex> lock(mutex_);
  DiagnosticStatuses statuses;
  for (DiagnosticStatusWrapper* status : {&statuses.image, &statuses.imu, &statuses.calibration, &statuses.timing}) {
    status->summary(DiagnosticStatus::OK, "running");
  }
  if (!now.statistics.configuration_error.empty()) {
    statuses.image.summary(DiagnosticStatus::ERROR, now.statistics.configuration_error);
  }
  if (!now.statistics.keypoints_text.empty()) {
    statuses.image.mergeSummary(DiagnosticStatus::ERROR, "no keypoints: " + now.statistics.keypoints_text);
  }
  for (const auto& [kind, problem] : now.statistics.input_problems) {
    if (!problem.active || problem.level == LogLevel::INFO) continue;
    status_of(kind, &statuses).mergeSummary(DiagnosticStatus::WARN, problem.text);
  }
  add_losses(now, &statuses.image);
  add_frames(now, &statuses.image);
  add_blocks(now, &statuses.image);
  add_quality(&statuses.image);
  add_optical_flow(now, &statuses.image);
  statuses.image.add("engine", now.statistics.engine.empty() ? "none" : now.statistics.engine);
  add_imu(now, &statuses.imu);
  add_exposure(&statuses.calibration);
  for (const CalibrationRow& row : now.statistics.calibration) statuses.calibration.add(row.key, row.text);
  add_exposure_advice(now, &statuses.calibration);
  add_count("time jumps", now.statistics.time_jumps, &statuses.timing);
  add_latencies(&statuses.timing);
  period_ = {};
  last_ = now.statistics;
  last_time_ = now.time;
  return statuses;
}

double DiagnosticReport::rate(const Moment& now, std::size_t newer, std::size_t older) const {
  return static_cast<double>(newer - older) / std::chrono::duration<double>(now.time - last_time_).count();
}

void DiagnosticReport::add_losses(const Moment& now, DiagnosticStatusWrapper* status) const {
  const ProcessorStatistics& statistics = now.statistics;
  const auto add = [status](const std::string& key, std::size_t count, std::size_t before, const std::string& text) {
    add_count(key, count, status);
    if (count > before) status->mergeSummary(DiagnosticStatus::WARN, std::to_string(count - before) + text);
  };
  for (const auto& [reason, count] : statistics.passed_through) {
    const std::string name = to_string(reason);
    add("passed through, " + name, count, count_of(last_.passed_through, reason),
        " frames passed through: " + name + "; " + remedy(reason));
  }
  add("images dropped, POOR", statistics.dropped_poor, last_.dropped_poor,
      " images dropped by drop_poor: they or the other images of their pairs are POOR; see image_quality");
  add("compressed images left out, not decodable", statistics.undecodable_images, last_.undecodable_images,
      " compressed images could not be decoded and have no output: check the camera's cable, its bandwidth and its "
      "driver");
}

void DiagnosticReport::add_frames(const Moment& now, DiagnosticStatusWrapper* status) const {
  const ProcessorStatistics& statistics = now.statistics;
  status->addf("output rate [Hz]", "%.1f", rate(now, statistics.frames_out, last_.frames_out));
  status->addf("input rate [Hz]", "%.1f", rate(now, statistics.frames_in, last_.frames_in));
  add_count("frames out", statistics.frames_out, status);
  add_count("frames in", statistics.frames_in, status);
  add_count("frames waiting", statistics.waiting, status);
}

void DiagnosticReport::add_blocks(const Moment& now, DiagnosticStatusWrapper* status) const {
  add_counts(
      "blocks", now.statistics.blocks, [](BlockStatus block) { return to_string(block); }, status);
  add_counts(
      "blocks on the float engine", now.statistics.fallback_counts, [](const std::string& reason) { return reason; },
      status);
  const auto fresh = [&](BlockStatus block_status) {
    return count_of(now.statistics.blocks, block_status) - count_of(last_.blocks, block_status);
  };
  const std::size_t rejected = fresh(BlockStatus::REJECTED), validated = rejected + fresh(BlockStatus::DEBLURRED);
  if (2 * rejected > validated) {
    status->mergeSummaryf(
        DiagnosticStatus::WARN,
        "%zu of %zu blurred blocks rejected: the images contradict the predicted blur; check R_cam_imu, "
        "time_offset and exposure_time with blur_overlay",
        rejected, validated);
  }
}

void DiagnosticReport::add_quality(DiagnosticStatusWrapper* status) const {
  std::size_t frames = 0;
  for (const auto& [grade, count] : period_.grades) frames += count;
  std::map<std::uint8_t, std::size_t> percent;
  for (const auto& [grade, count] : period_.grades) {
    percent[grade] =
        static_cast<std::size_t>(std::lround(100 * static_cast<double>(count) / static_cast<double>(frames)));
  }
  add_counts(
      "images [%]", percent, [](std::uint8_t grade) { return to_string(static_cast<QualityGrade>(grade)); }, status);
  if (period_.scores > 0) {
    status->addf("score of images, mean", "%.2f", period_.score_sum / static_cast<double>(period_.scores));
  }
}

void DiagnosticReport::add_exposure(DiagnosticStatusWrapper* status) const {
  if (!exposure_) return;
  const FrameExposure& chosen = *exposure_;
  status->add("exposure time, from", to_string(chosen.origin));
  if (chosen.origin == ExposureOrigin::ASSUMED) {
    const std::string need = to_string(chosen.need);
    status->add("exposure time, waits for", need.empty() ? "motion" : need);
    return;
  }
  status->addf("exposure time [ms]", "%.2f", to_seconds(chosen.exposure_ns) * 1e3);
  if (chosen.log_stddev > 0) status->addf("exposure time, standard deviation [%]", "%.1f", 100 * chosen.log_stddev);
}

void DiagnosticReport::add_exposure_advice(const Moment& now, DiagnosticStatusWrapper* status) const {
  if (period_.exposures.empty()) return;
  // The advice has to hold while the camera moves fast: of ten frames one is faster.
  std::vector<ExposureTerms> exposures = period_.exposures;
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
  add_count("blocks with optical flow", now.statistics.blocks_from_images, status);
  add_count("frames by optical flow alone", now.statistics.frames_by_images_alone, status);
  if (!period_.flow_px.empty()) {
    status->addf("optical flow, median [px]", "%.2f", median(period_.flow_px));
  }
}

void DiagnosticReport::add_imu(const Moment& now, DiagnosticStatusWrapper* status) const {
  const ProcessorStatistics& statistics = now.statistics;
  add_count("imu dropped, not finite", statistics.imu_not_finite, status);
  add_count("imu dropped, duplicate", statistics.imu_duplicate, status);
  add_count("imu dropped, out of order", statistics.imu_out_of_order, status);
  add_count("imu dropped, stray stamp", statistics.imu_stray, status);
  add_count("imu dropped, without gyroscope", statistics.imu_without_gyroscope, status);
  add_count("imu saturated", statistics.imu_saturated, status);
  status->addf("gyroscope rate [Hz]", "%.1f", rate(now, statistics.imu_accepted, last_.imu_accepted));
  const TimeRange& available = statistics.gyro_available;
  if (!available.empty()) {
    status->addf("gyroscope age [s]", "%.3f", to_seconds(now.node_ns - available.end_ns));
    status->addf("gyroscope buffer [s]", "%.3f", to_seconds(available.end_ns - available.begin_ns));
  } else {
    status->add("gyroscope buffer [s]", "empty");
  }
  status->add("cameras on this gyroscope", now.cameras);
  if (period_.rotations > 0) {
    status->add("residual rotation, mean [rad/s]",
                vector_text(period_.rotation_sum_rad_s / static_cast<double>(period_.rotations)));
  }
  if (statistics.gyro_error) {
    status->mergeSummary(DiagnosticStatus::WARN, error_text(*statistics.gyro_error, statistics.bias_rad_s));
  }
}

void DiagnosticReport::add_latencies(DiagnosticStatusWrapper* status) const {
  // Behind the first two, the stages in the order in which a frame goes through them.
  for (const std::string stage :
       {"processing", "waiting", "optical flow", "blur field", "exposure estimate", "validation", "noise",
        "deconvolution", "keypoints", "tracks", "global shutter", "messages"}) {
    const auto found = period_.latencies.find(stage);
    if (found == period_.latencies.end()) continue;
    const Latency& latency = found->second;
    status->addf(stage + " mean [ms]", "%.2f", latency.sum_ms / static_cast<double>(latency.count));
    const bool is_whole = stage == "processing" || stage == "waiting";
    if (is_whole) status->addf(stage + " max [ms]", "%.2f", latency.max_ms);
  }
}

}  // namespace gyro_deblur
