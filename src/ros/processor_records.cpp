// What the processor reports of its input and of the frames that it publishes, and its counts.
#include <string>
#include <utility>

#include "base/format.hpp"
#include "ros/processor.hpp"
#include "ros/value_conversion.hpp"
#include "sync/exposure_check.hpp"

namespace gyro_deblur {

void Processor::record_calibration_file() {
  std::string text;
  if (config_ && config_->calibration) {
    for (const std::string& note : config_->calibration->notes) text += (text.empty() ? "" : "; ") + note;
  }
  record_unreadable("calibration file", text);
}

void Processor::record_unreadable(const std::string& kind, const std::string& text) {
  text.empty() ? problems_.resolve(kind) : problems_.report(kind, text);
}

void Processor::keep_global_shutter_in_order(FrameOutput* output) {
  const TimeNs input_ns = to_time_ns(output->input->header.stamp);
  if (is_unset(input_ns)) return;
  const auto goes_back = [&](const ros::Time& stamp, std::optional<MovedStamp>* last) {
    const MovedStamp moved{input_ns, to_time_ns(stamp)};
    if (*last && input_ns > (*last)->input_ns && moved.output_ns <= (*last)->output_ns) return true;
    *last = moved;
    return false;
  };
  if (output->global_shutter_tracks && goes_back(output->global_shutter_tracks->header.stamp, &last_moved_tracks_)) {
    output->global_shutter_tracks.reset();
    problems_.log(LogLevel::WARNING, "global_shutter_tracks",
                  "frame " + seconds_text(input_ns) +
                      " has no global-shutter tracks: they would be of an instant before those of the last frame, " +
                      seconds_text(last_moved_tracks_->output_ns));
  }
  if (!output->global_shutter || !goes_back(output->global_shutter->header.stamp, &last_moved_)) return;
  output->global_shutter.reset();
  output->global_shutter_info.reset();
  problems_.log(LogLevel::WARNING, "global_shutter",
                "frame " + seconds_text(input_ns) +
                    " has no global-shutter image: it passes through unmoved, and the one before was moved to " +
                    seconds_text(last_moved_->output_ns) + "; rectify_to: middle_row moves stamps least");
}

void Processor::record_exposure(const FrameOutput& output) {
  constexpr char kKind[] = "exposure contradicted";
  if (!output.exposure) return;
  const ChosenExposure& chosen = *output.exposure;
  if (chosen.origin == ExposureOrigin::IMAGES && !synchronizer_.has_exposure_from_images()) {
    synchronizer_.set_exposure_from_images();
    problems_.log(
        LogLevel::INFO, "exposure found",
        "the exposure time is " + seconds_text(chosen.exposure_ns) + " s, estimated from the blur of the images");
  }
  if (const std::optional<ExposureConflict>& conflict = exposures_.conflict()) {
    problems_.report(kKind, conflict_text(*conflict));
  } else {
    problems_.resolve(kKind);
  }
}

void Processor::record_static_content(const FrameOutput& output) {
  constexpr char kKind[] = "static content";
  if (!output.field) return;
  if (output.static_share == 0) {
    problems_.resolve(kKind);
    return;
  }
  problems_.report(
      kKind, format("about %.2g %%", 100 * output.static_share) +
                 " of the image does not move with the camera (a lens's rim, a part of the vehicle?): blocks at "
                 "its edge are not deblurred, corners on it are no landmarks. Set mask, or publish the topic "
                 "mask: mono8 of " +
                 size_text(output.input->width, output.input->height) + ", 0 where a pixel does not show the scene");
}

void Processor::record(const FrameOutput& output) {
  statistics_.count(output);
  const TimeNs stamp_ns = to_time_ns(output.input->header.stamp);
  const std::string name = "frame " + seconds_text(stamp_ns);
  record_static_content(output);
  record_exposure(output);
  if (output.residual_rotation) gyro_errors_.add(stamp_ns, *output.residual_rotation);
  check_gyro_unit(output);
  if (!output.keypoints_text.empty()) {
    problems_.log(LogLevel::ERROR, "keypoints", name + " has no keypoints: " + output.keypoints_text);
  }
  if (output.dropped) problems_.log(LogLevel::INFO, "drop_poor", name + " is not published: " + output.reason_text);
  // A time jump has been reported, once for all its frames.
  if (output.reason != PassThroughReason::NONE && output.reason != PassThroughReason::TIME_JUMP) {
    problems_.log(level_of(output.reason), to_string(output.reason),
                  name + " passes through unchanged: " + to_string(output.reason) + ": " + output.reason_text);
  }
}

void Processor::check_gyro_unit(const FrameOutput& output) {
  constexpr char kKind[] = "imu unit by images";
  if (!output.seen_rotation) return;
  gyro_unit_.add(to_time_ns(output.input->header.stamp), *output.seen_rotation);
  const std::optional<GyroUnitFault> fault = gyro_unit_.find(gyro_source_->rates_are_zero());
  const bool was_wrong = std::exchange(gyro_unit_is_wrong_, fault.has_value());
  if (!fault && was_wrong) problems_.resolve(kKind);
  if (!fault || was_wrong) return;
  problems_.report(
      kKind,
      fault->kind == GyroUnitFault::Kind::DEGREES
          ? format("the IMU reports rates of up to %.3g \"rad/s\" while the images rotate by %.3g rad/s: are they in "
                   "degrees/s? sensor_msgs/Imu has rad/s",
                   fault->gyro_rad_s, fault->seen_rad_s)
          : format("all rates of the IMU are 0 while the images rotate by up to %.3g rad/s: is imu connected to an "
                   "accelerometer's topic? realsense2_camera publishes accelerometer and gyroscope apart unless "
                   "unite_imu_method is set",
                   fault->seen_rad_s));
}

void OutputStatistics::count(const FrameOutput& output) {
  ++(output.dropped ? dropped_poor : frames_out);
  if (output.reason != PassThroughReason::NONE) ++passed_through[output.reason];
  if (output.field) {
    for (const BlockBlur& block : output.field->blocks) {
      ++blocks[block.status];
      if (block.residual) ++blocks_from_images;
    }
  }
  if (output.field && output.field->images_alone && output.reason == PassThroughReason::NONE) ++frames_by_images_alone;
  for (const auto& [reason, number] : output.fallback_counts) fallback_counts[reason] += number;
  keypoints_text = output.keypoints_text;
}

ProcessorStatistics Processor::statistics() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  ProcessorStatistics statistics;
  static_cast<ImuStatistics&>(statistics) = gyro_source_->statistics();
  static_cast<InputStatistics&>(statistics) = synchronizer_.statistics();
  static_cast<OutputStatistics&>(statistics) = statistics_;
  statistics.waiting = frames_waiting();
  statistics.frame_period_ns = synchronizer_.frame_period().get();
  statistics.gyro_available = synchronizer_.gyro().available();
  if (pipeline_) statistics.engine = pipeline_->engine();
  statistics.configuration_error = synchronizer_.config_error();
  statistics.bias_rad_s = calibration_.config().gyro.bias_rad_s;
  if (config_) statistics.calibration = calibration_.table();
  statistics.gyro_error = gyro_errors_.find();
  statistics.input_problems = problems_.all();
  for (const auto& [kind, problem] : gyro_source_->problems()) statistics.input_problems.emplace(kind, problem);
  return statistics;
}

}  // namespace gyro_deblur
