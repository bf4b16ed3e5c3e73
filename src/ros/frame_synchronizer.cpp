// Decides when a frame has all its inputs, and how long it waits for them.
#include "ros/frame_synchronizer.hpp"

#include <algorithm>
#include <utility>

#include "base/format.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "ros/calibration_conversion.hpp"
#include "sync/exposure_check.hpp"

namespace gyro_deblur {
namespace {

/// Which of the samples that a frame needs are missing. What came after them is not mentioned: that depends on how fast
/// messages arrive, and the same recording shall give the same text.
std::string coverage_text(const TimeRange& needed, const std::optional<TimeRange>& available,
                          const GyroOptions& options) {
  std::string text = "frame needs gyroscope samples from " + seconds_text(needed.begin_ns) + " to " +
                     seconds_text(needed.end_ns) + " s of the IMU clock, ";
  if (!available) return text + "there are none";
  const bool begins_late = available->begin_ns > needed.begin_ns, ends_early = available->end_ns < needed.end_ns;
  if (begins_late) text += "the oldest is of " + seconds_text(available->begin_ns) + " s";
  if (ends_early) text += (begins_late ? ", " : "") + ("the newest of " + seconds_text(available->end_ns) + " s");
  if (begins_late || ends_early) return text;
  return text + "some of which are farther apart than max_gyro_gap = " + seconds_text(options.max_gap_ns) + " s";
}

void take_times(const Exposure& message, ShutterTiming* timing) {
  timing->exposure_ns = message.exposure_time.toNSec();
  if (!message.readout_time.isZero()) timing->readout_ns = message.readout_time.toNSec();
}

/// The motion of the frame's picture, where another image that shows it has had it; null otherwise.
const PictureMotion* known_motion(const PendingFrame& frame) {
  if (!frame.picture || !frame.picture->motion) return nullptr;
  return frame.picture->motion->lens == frame.lens ? &*frame.picture->motion : nullptr;
}

/// The time that the frame itself needs samples for, IMU clock, where it was exposed so long.
TimeRange own_range(const Config& config, const PictureMotion& motion, TimeNs exposure_ns) {
  const RowExposure exposure = motion.exposure->with_exposure(exposure_ns);
  const TimeNs reference_ns = exposure.reference_time(config.pipeline.rectify_to);
  const TimeRange frame_cam = exposure.frame();
  const TimeNs offset_ns = motion.gyro.time_offset_ns;
  return {std::min(frame_cam.begin_ns, reference_ns) + offset_ns, std::max(frame_cam.end_ns, reference_ns) + offset_ns};
}

/// The same, for the longest exposure that is possible.
TimeRange longest_range(const Config& config, const PictureMotion& motion) {
  const TimeRange planned = own_range(config, motion, motion.plan.exposure_ns),
                  longest = own_range(config, motion, motion.plan.longest_ns);
  return {std::min(planned.begin_ns, longest.begin_ns), std::max(planned.end_ns, longest.end_ns)};
}

/// Marks the samples that GyroBuffer::window would give for `own` alone.
void mark_own(const TimeRange& own, PictureMotion* motion) {
  const std::vector<GyroSample>& samples = motion->samples;
  auto begin = std::partition_point(samples.begin(), samples.end(),
                                    [&own](const GyroSample& sample) { return sample.t_ns < own.begin_ns; });
  auto end = std::partition_point(begin, samples.end(),
                                  [&own](const GyroSample& sample) { return sample.t_ns <= own.end_ns; });
  if (begin != samples.begin()) --begin;
  if (end != samples.end()) ++end;
  motion->own_begin = static_cast<std::size_t>(begin - samples.begin());
  motion->own_end = static_cast<std::size_t>(end - samples.begin());
}

}  // namespace

FrameSynchronizer::FrameSynchronizer(InputBuffers inputs, Extrinsic extrinsic, const CalibrationInUse* calibration,
                                     const ExposureChoice* exposures, InputProblems* problems)
    : InputBuffers(std::move(inputs)),
      extrinsic_(std::move(extrinsic)),
      calibration_(*calibration),
      exposures_(*exposures),
      problems_(*problems) {}

void FrameSynchronizer::mark_ready() {
  if (!config_error().empty()) return;
  try {
    for (PendingFrame& frame : queue().frames()) {
      if (frame.pass_through_reason != PassThroughReason::NONE || frame.ready_steady_ns) continue;
      // Those behind it have to wait for it anyway.
      PictureMotion motion;
      if (decide(&frame, &motion) == Readiness::WAITS) return;
      frame.ready_steady_ns = steady_now();
    }
  } catch (const std::exception&) {
    // next() gets it again, and reports it.
  }
}

std::optional<SynchronizedFrame> FrameSynchronizer::next(const Followed& followed_cam, bool finishing) {
  const TimeNs now_ns = now(), steady_ns = steady_now();
  overload_.end(steady_ns);
  if (finishing) forget_picture();
  if (queue().empty()) return std::nullopt;
  PendingFrame& frame = queue().front();
  frame.timed_out = finishing || has_timed_out(frame, now_ns);
  SynchronizedFrame next;
  try {
    const Readiness readiness = decide(&frame, &next);
    if (readiness == Readiness::WAITS) return std::nullopt;
    record_lacking_samples(frame, next);
    if (readiness == Readiness::READY) {
      if (!known_motion(frame)) {
        if (next.lacks == PassThroughReason::NO_GYRO) collect(followed_cam, &next);
        if (frame.picture) frame.picture->motion = static_cast<const PictureMotion&>(next);
      }
      record_repetition(frame, next.gyro);
      next.pictures_repeat = statistics().repeated_pictures > 0;
      if (!finishing) check_overload(steady_ns, &frame, &next);
    }
  } catch (const std::exception& error) {
    // Without a reason the frame would be tried again for ever, and hold up all that come after it.
    frame.pass_through(PassThroughReason::INTERNAL_ERROR, error.what());
  }
  frame.info = best_info(frame);
  if (frame.pass_through_reason == PassThroughReason::NONE) overload_.begin(steady_ns, next.behind_camera_rate);
  next.frame = queue().pop();
  return next;
}

void FrameSynchronizer::put_back(PendingFrame frame) {
  overload_.pause(steady_now());
  frame.awaits = Awaited::STEREO_PARTNER;
  frame.missing_extrinsic.clear();
  if (!frame.ready_steady_ns) frame.ready_steady_ns = steady_now();
  queue().put_back(std::move(frame));
}

std::shared_ptr<FrameInWork> FrameSynchronizer::resume() {
  if (queue().empty() || !queue().front().in_work) return nullptr;
  overload_.resume(steady_now());
  return queue().pop().in_work;
}

Readiness FrameSynchronizer::decide(PendingFrame* frame, PictureMotion* motion) const {
  frame->awaits = Awaited::NOTHING;
  // Unusable images, time that was reset, a queue that is full.
  if (frame->pass_through_reason != PassThroughReason::NONE) return Readiness::PASS_THROUGH;
  if (!config_error().empty()) return pass_through(frame, PassThroughReason::BAD_CONFIGURATION, config_error());
  Readiness readiness = Readiness::READY;
  // A waiting frame that uses the calibration file takes its camera_info instead once that has come.
  if (!frame->described_by_topic) readiness = find_calibration(frame);
  if (const PictureMotion* known = known_motion(*frame); known && readiness == Readiness::READY) {
    *motion = *known;
    return Readiness::READY;
  }
  if (readiness == Readiness::READY) readiness = find_exposure(frame, motion);
  if (readiness == Readiness::READY) readiness = find_samples(frame, motion);
  // Without samples there is nothing to rotate, and the IMU's frame is not known.
  const bool has_samples = frame->lens != Lens::UNKNOWN && (!motion->without_gyro || !gyro().empty());
  if (readiness == Readiness::READY && has_samples) readiness = find_extrinsic(frame, motion);
  return readiness;
}

void FrameSynchronizer::record_lacking_samples(const PendingFrame& frame, const PictureMotion& motion) {
  if (!config_error().empty()) return;
  // A fast camera fills the queue before its images time out: those that are passed through for that are without IMU
  // too.
  if (!motion.exposure && frame.pass_through_reason != PassThroughReason::OVERLOAD) return;
  const TimeNs begin_ns =
      (motion.exposure ? motion.exposure->frame().begin_ns : frame.stamp_ns) + config().gyro.time_offset_ns;
  const TimeRange samples = gyro().available();
  if (samples.empty() || samples.end_ns < begin_ns) count_without_imu(begin_ns);
}

void FrameSynchronizer::check_overload(TimeNs steady_ns, PendingFrame* frame, SynchronizedFrame* synchronized) const {
  const TimeNs ready_ns = frame->ready_steady_ns.value_or(steady_ns);
  const std::size_t ready_behind = queue().ready_behind_front();
  const std::optional<TimeNs> period_ns = frame_period().get();
  const std::string overload = overload_.pass_through_text(steady_ns, ready_ns, ready_behind, period_ns);
  if (!overload.empty()) frame->pass_through(PassThroughReason::OVERLOAD, overload);
  synchronized->behind_camera_rate = OverloadRule::is_behind_camera_rate(steady_ns, ready_ns, ready_behind, period_ns);
}

Readiness FrameSynchronizer::find_timing(PendingFrame* frame, ShutterTiming* timing, ExposureOrigin* origin) const {
  const Config& config = this->config();
  const TimeNs stamp_ns = frame->picture_ns();  // an image that repeats a picture has its exposure
  *timing = config.shutter;
  timing->readout_ns = region_readout_ns(timing->readout_ns, *frame->info);
  const Exposures& exposures = this->exposures();
  const auto is_known = [](const Exposure* message) { return message && !message->exposure_time.isZero(); };
  const auto take = [&](const Exposure& message) {
    take_times(message, timing);
    *origin = ExposureOrigin::MESSAGE;
    return Readiness::READY;
  };
  const Exposure* own = exposures.find(stamp_ns);
  if (is_known(own)) return take(*own);
  if (own && !own->readout_time.isZero()) timing->readout_ns = own->readout_time.toNSec();
  const std::optional<TimeNs> setting_ns = exposure_setting_ns();
  if (setting_ns.value_or(0) != 0) {
    timing->exposure_ns = *setting_ns;
    *origin = ExposureOrigin::SETTING;
    return Readiness::READY;
  }
  const Exposure* neighbour = exposures.find_if_neighbours_agree(stamp_ns);
  if (is_known(neighbour)) return take(*neighbour);
  // Exposures of neighbours rarely agree, so a lost message costs as many frame periods.
  constexpr std::size_t kLaterEndWaiting = 2;
  bool waits = !frame->timed_out && exposures.later(stamp_ns) < kLaterEndWaiting;
  const bool expected = exposure_expected();
  if (own) {
    // If no message before had a time either, the driver does not know it yet, and later messages will not help.
    waits = waits && (timing->exposure_ns == 0 || is_known(exposures.find_before(stamp_ns, 0)));
  } else {
    waits = waits && expected && exposures.awaited() && !setting_ns;
  }
  if (waits) return wait_for(Awaited::EXPOSURE, frame);
  const TimeNs oldest_ns = stamp_ns - config.exposure_max_age_ns;
  const Exposure* before = exposures.find_before(stamp_ns, oldest_ns);
  if (is_known(before)) return take(*before);
  *origin = ExposureOrigin::PARAMETER;
  if (timing->exposure_ns > 0 && !own && expected && exposures.awaited() && !setting_ns) {
    problems_.log(LogLevel::WARNING, "exposure message missing",
                  "no exposure message with the image's stamp " + seconds_text(stamp_ns) +
                      " s: using parameter exposure_time = " + seconds_text(timing->exposure_ns) + " s");
  }
  return Readiness::READY;
}

Readiness FrameSynchronizer::find_exposure(PendingFrame* frame, PictureMotion* motion) const {
  ShutterTiming timing;
  ExposureOrigin origin = ExposureOrigin::PARAMETER;
  const Readiness readiness = find_timing(frame, &timing, &origin);
  if (readiness != Readiness::READY) return readiness;
  motion->readout_by_message = timing.readout_ns != region_readout_ns(config().shutter.readout_ns, *frame->info);
  if (plan_exposure(timing.exposure_ns, origin, frame, &motion->plan) == Readiness::PASS_THROUGH) {
    return Readiness::PASS_THROUGH;
  }
  timing.exposure_ns = motion->plan.exposure_ns;
  try {
    frame_period().require_plausible_readout("readout_time", timing.readout_ns);
  } catch (const OptionError& error) {
    problems_.report("readout_time", error.what());
    return pass_through(frame, PassThroughReason::BAD_CONFIGURATION, error.what());
  }
  problems_.resolve("readout_time");
  try {
    motion->exposure.emplace(frame->picture_ns(), static_cast<int>(frame->image->height), timing);
  } catch (const OptionError& error) {
    return pass_through(frame, PassThroughReason::NO_EXPOSURE_TIME, error.what());
  }
  return Readiness::READY;
}

Readiness FrameSynchronizer::plan_exposure(TimeNs given_ns, ExposureOrigin origin, PendingFrame* frame,
                                           ExposurePlan* plan) const {
  const FramePeriod& period = frame_period();
  std::optional<GivenExposure> given;
  if (given_ns != 0) {
    given = GivenExposure{origin, given_ns};
    if (const std::optional<std::string> fault = exposure_fault(origin, given_ns, period)) {
      // Reported when it came.
      if (origin != ExposureOrigin::PARAMETER) return pass_through(frame, PassThroughReason::NO_EXPOSURE_TIME, *fault);
      if (config().on_exposure_conflict == OnExposureConflict::CONFIGURED) {
        return pass_through(frame, PassThroughReason::BAD_CONFIGURATION, *fault);
      }
      given.reset();
    }
  }
  *plan = exposures_.plan(given, period.get());
  return Readiness::READY;
}

Readiness FrameSynchronizer::find_samples(PendingFrame* frame, PictureMotion* motion) const {
  motion->gyro = config().gyro;
  motion->lens = frame->lens;
  if (frame->lens == Lens::UNKNOWN) {  // what the gyroscope measures cannot be compared with pixels
    motion->without_gyro = true;
    motion->lacks = PassThroughReason::NO_CALIBRATION;
    motion->coverage_text = "the camera is not calibrated";
    return Readiness::READY;
  }
  const TimeRange own = longest_range(config(), *motion);
  const TimeRange available = gyro().available();
  const bool empty = available.empty();
  const bool by_flow = goes_without_imu(config());
  const bool silent = imu_is_silent(own.begin_ns);
  if (!frame->timed_out && !(by_flow && silent)) {
    if (empty || available.end_ns < own.end_ns) return wait_for(Awaited::IMU, frame);
    // After a jump late samples of the old epoch do not belong to frames of the new one.
    if (imu_is_stale() && own.end_ns < available.begin_ns) return wait_for(Awaited::IMU, frame);
  }
  motion->without_gyro = empty || silent;
  if (!empty || by_flow) return Readiness::READY;
  return pass_through(frame, PassThroughReason::NO_GYRO, coverage_text(own, std::nullopt, motion->gyro));
}

Readiness FrameSynchronizer::find_extrinsic(PendingFrame* frame, PictureMotion* motion) const {
  const Config& config = this->config();
  const std::string& camera_frame = frame->image->header.frame_id;
  const std::string imu_frame = this->imu_frame();
  const bool ask_tf = !config.R_cam_imu || config.on_calibration_conflict == OnCalibrationConflict::ERROR;
  std::optional<Eigen::Matrix3d> from_tf;
  if (ask_tf && extrinsic_) from_tf = extrinsic_(camera_frame, imu_frame);
  if (config.R_cam_imu) {
    motion->R_cam_imu = *config.R_cam_imu;
    try {
      if (from_tf) {
        const bool from_file = config.calibration && config.calibration->R_cam_imu;
        require_agreement(*config.R_cam_imu, from_file ? config.calibration->origin : "parameter R_cam_imu", *from_tf,
                          "tf");
      }
    } catch (const OptionError& error) {
      return pass_through(frame, PassThroughReason::NO_EXTRINSIC, error.what());
    }
    return Readiness::READY;
  }
  if (from_tf || calibration_.R_cam_imu()) {
    frame->missing_extrinsic.clear();
    problems_.resolve(kNoExtrinsic);
    motion->R_cam_imu = from_tf ? *from_tf : *calibration_.R_cam_imu();
    motion->R_by_tf = from_tf.has_value();
    return Readiness::READY;
  }
  const bool by_flow = goes_without_imu(config);
  if (motion->without_gyro && by_flow) return Readiness::READY;  // nothing to rotate
  const std::string missing =
      "no transform from IMU frame \"" + imu_frame + "\" to camera frame \"" + camera_frame +
      "\", and no parameter R_cam_imu: set it, or publish a static transform; not estimated from images yet: " +
      calibration_.missing_rotation();
  const std::string report =
      (by_flow ? "images are deblurred by optical flow alone, which is less accurate: " : "") + missing;
  // Those of an unknown lens have not waited either.
  const bool has_waited = frame->timed_out || problems_.is_active(kNoExtrinsic) || frame->lens == Lens::FOCAL_LENGTH;
  if (by_flow && has_waited) {
    problems_.update(kNoExtrinsic, report);
    motion->without_gyro = true;
    motion->lacks = PassThroughReason::NO_EXTRINSIC;
    motion->coverage_text = missing;
    return Readiness::READY;
  }
  if (frame->timed_out) {
    problems_.report(kNoExtrinsic, missing);
    return pass_through(frame, PassThroughReason::NO_EXTRINSIC, missing);
  }
  frame->missing_extrinsic = report;
  return wait_for(Awaited::TRANSFORM, frame);
}

void FrameSynchronizer::collect(const Followed& followed_cam, PictureMotion* motion) const {
  const Config& config = this->config();
  const GyroReader& reader = gyro();
  const TimeRange own = own_range(config, *motion, motion->plan.exposure_ns), available = reader.available();
  motion->coverage_text = coverage_text(own, available.empty() ? std::nullopt : std::optional(available), motion->gyro);
  const TimeRange frame_cam = motion->exposure->frame();
  TimeRange all = longest_range(config, *motion);
  const auto reach = [&all, motion](TimeNs camera_ns) {
    const TimeNs imu_ns = camera_ns + motion->gyro.time_offset_ns;
    all = {std::min(all.begin_ns, imu_ns), std::max(all.end_ns, imu_ns)};
  };
  for (const std::optional<TimeRange>& each : followed_cam) {
    if (!each) continue;
    const TimeNs since_ns = frame_cam.begin_ns - each->begin_ns;
    if (since_ns > 0 && since_ns <= kLongestTrackBreakNs) reach(each->begin_ns);
  }
  motion->samples = reader.window(all);
  mark_own(own, motion);
}

}  // namespace gyro_deblur
