#include "ros/processor.hpp"

#include <algorithm>
#include <utility>

#include <boost/make_shared.hpp>

#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/overlay.hpp"
#include "ros/conversions.hpp"

namespace gyro_deblur {
namespace {

/// The samples have to span this part of the window.
constexpr double kMinBiasCoverage = 0.8;

/// Simulated time can stop, at the end of a bag for example: after this many timeouts of real time frames leave anyway.
constexpr TimeNs kSteadyTimeoutFactor = 10;

double elapsed_ms(std::chrono::steady_clock::time_point since) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - since).count();
}

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

/// What is wrong with saturated samples among `samples`; empty when there is none.
std::string saturation_text(const std::vector<GyroSample>& samples, const GyroOptions& options) {
  const auto saturated = [&options](const GyroSample& sample) { return is_saturated(sample, options); };
  const auto first = std::find_if(samples.begin(), samples.end(), saturated);
  if (first == samples.end()) return {};
  char range[40];
  std::snprintf(range, sizeof(range), "%g", options.range_rad_s);
  return std::to_string(std::count_if(first, samples.end(), saturated)) + " of the " + std::to_string(samples.size()) +
         " gyroscope samples that the frame needs reach gyro_range = " + range + " rad/s, the first is " +
         vector_text(first->rate_rad_s) + " rad/s at " + seconds_text(first->t_ns) + " s of the IMU clock";
}

LogLevel level_of(PassThroughReason reason) {
  // The rest comes and goes by itself; these need somebody to act.
  switch (reason) {
    case PassThroughReason::NO_GYRO:
    case PassThroughReason::GYRO_SATURATED:
    case PassThroughReason::OVERLOAD:
      return LogLevel::WARNING;
    default:
      return LogLevel::ERROR;
  }
}

}  // namespace

Processor::Processor(Environment environment)
    : environment_(std::move(environment)),
      log_(environment_.log),
      gyro_source_(environment_.gyro
                       ? environment_.gyro
                       : std::make_shared<GyroSource>(GyroSource::options_of(Config()), environment_.log)),
      jumps_(Config().time_jump_ns),
      gyro_(gyro_source_),
      queue_(static_cast<std::size_t>(Config().frame_queue_size)),
      tracker_(std::make_shared<FeatureTracker>(TrackerOptions{})) {}

void Processor::set_config(const Config& config) {
  config.validate();
  std::shared_ptr<Pipeline> pipeline;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const bool same_engine = config_ && config_->pipeline.engine == config.pipeline.engine &&
                             config_->pipeline.threads == config.pipeline.threads;
    if (same_engine) pipeline = pipeline_;
  }
  // Making an engine can take seconds (a device compiles its program), so no lock is held.
  if (!pipeline) {
    pipeline =
        std::make_shared<Pipeline>(config.pipeline, environment_.make_engine ? environment_.make_engine : make_engine);
  }
  // Options of a shared source are what those who share it agree on.
  if (!environment_.gyro) gyro_source_->set_options(GyroSource::options_of(config));

  const std::lock_guard<std::mutex> lock(mutex_);
  config_ = config;
  config_error_.clear();
  pipeline_ = std::move(pipeline);
  jumps_.set_threshold(config.time_jump_ns);
  queue_.set_capacity(static_cast<std::size_t>(config.frame_queue_size));
}

void Processor::set_config_error(const std::string& text) {
  const std::lock_guard<std::mutex> lock(mutex_);
  config_.reset();
  pipeline_.reset();
  config_error_ = text;
}

std::size_t Processor::store_size() const {
  // What belongs to the waiting frames, and a second or so of what comes before its image.
  constexpr std::size_t kMargin = 100;
  return kMargin + 2 * static_cast<std::size_t>(config_ ? config_->frame_queue_size : Config().frame_queue_size);
}

void Processor::forget(Stream stream, ShownBy shown_by) {
  const bool itself = shown_by == ShownBy::ITSELF;
  constexpr char kText[] = "time went backwards while the frame waited";
  switch (stream) {
    case Stream::IMU:
      if (!itself) gyro_.forget();  // else the source has
      translation_.forget_forces();
      break;
    case Stream::IMAGE:
      itself ? queue_.settle_all(PassThroughReason::TIME_JUMP, kText)
             : queue_.settle_old_epoch(PassThroughReason::TIME_JUMP, kText);
      break;
    case Stream::CAMERA_INFO:
      itself ? infos_.clear() : infos_.clear_old_epoch();
      break;
    case Stream::EXPOSURE:
      itself ? exposures_.clear() : exposures_.clear_old_epoch();
      break;
    case Stream::CLOCK:
      break;
  }
}

void Processor::handle(TimeJumpDetector::Verdict verdict, Stream stream, TimeNs from_ns, TimeNs to_ns) {
  switch (verdict) {
    case TimeJumpDetector::Verdict::FORWARD:
      return;
    case TimeJumpDetector::Verdict::FOLLOWS:
      forget(stream, ShownBy::ITSELF);
      return;
    case TimeJumpDetector::Verdict::JUMP:
      break;
  }
  ++statistics_.time_jumps;
  translation_.clear();
  for (const Stream every : {Stream::IMU, Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE}) {
    forget(every, every == stream ? ShownBy::ITSELF : ShownBy::OTHER);
  }
  environment_.log(LogLevel::WARNING, std::string("time went backwards (") + to_string(stream) + " from " +
                                          seconds_text(from_ns) + " to " + seconds_text(to_ns) +
                                          " s): starting anew, frames that waited pass through unchanged");
}

void Processor::note_time(Stream stream, TimeNs stamp_ns) {
  const TimeNs from_ns = jumps_.newest_ns(stream).value_or(stamp_ns);
  handle(jumps_.update(stream, stamp_ns), stream, from_ns, stamp_ns);
}

TimeNs Processor::now() {
  const TimeNs now_ns = environment_.clock();
  note_time(Stream::CLOCK, now_ns);
  note_imu();
  for (PendingFrame& frame : queue_.frames()) {
    // Simulated time is 0 until its first message, and it can be set back: waiting starts anew then.
    if (frame.arrival_ns == 0 || frame.arrival_ns > now_ns) frame.arrival_ns = now_ns;
  }
  return now_ns;
}

void Processor::note_imu() {
  const GyroReader::News news = gyro_.update();
  // Whoever has seen no sample from before cannot miss one.
  if (news.restarted && jumps_.newest_ns(Stream::IMU)) {
    handle(jumps_.went_back(Stream::IMU, news.to_ns), Stream::IMU, news.from_ns, news.to_ns);
  }
  if (news.samples > 0 && news.newest_ns) jumps_.update(Stream::IMU, *news.newest_ns, news.samples);
}

void Processor::add_imu(const sensor_msgs::Imu& imu) {
  if (gyro_source_->add(imu)) {
    notice_imu(imu);
  } else {
    const std::lock_guard<std::mutex> lock(mutex_);
    now();
  }
}

void Processor::notice_imu(const sensor_msgs::Imu& imu) {
  const std::lock_guard<std::mutex> lock(mutex_);
  now();
  translation_.add(imu);
}

void Processor::add_exposure(const Exposure& exposure) {
  const std::lock_guard<std::mutex> lock(mutex_);
  now();
  const TimeNs stamp_ns = to_time_ns(exposure.header.stamp);
  note_time(Stream::EXPOSURE, stamp_ns);
  exposure_seen_ = true;
  exposures_.add(stamp_ns, exposure, store_size());
}

void Processor::add_exposure_setting(TimeNs exposure_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  exposure_setting_ns_ = exposure_ns;
}

void Processor::add_camera_info(const sensor_msgs::CameraInfoConstPtr& info) {
  const std::lock_guard<std::mutex> lock(mutex_);
  now();
  const TimeNs stamp_ns = to_time_ns(info->header.stamp);
  note_time(Stream::CAMERA_INFO, stamp_ns);
  info_seen_ = true;
  infos_.add(stamp_ns, info, store_size());
}

void Processor::add_odometry(const nav_msgs::Odometry& odometry) {
  const std::lock_guard<std::mutex> lock(mutex_);
  now();
  if (const auto refused = translation_.add(odometry, config_.value_or(Config()))) {
    ++statistics_.odometry_refused;
    log_(LogLevel::WARNING, "odometry refused",
         "odometry at " + seconds_text(refused->stamp_ns) + " s ignored: " + refused->why);
  }
}

void Processor::add_scene_depth(const sensor_msgs::Range& depth) {
  const std::lock_guard<std::mutex> lock(mutex_);
  now();
  if (const auto refused = translation_.add(depth, config_.value_or(Config()))) {
    log_(LogLevel::WARNING, "scene depth refused",
         "scene_depth at " + seconds_text(refused->stamp_ns) + " s ignored: " + refused->why);
  }
}

void Processor::add_image(const sensor_msgs::ImageConstPtr& image) {
  PendingFrame frame;
  frame.image = image;
  frame.stamp_ns = to_time_ns(image->header.stamp);
  try {
    check_image(*image);
  } catch (const FrameError& error) {
    frame.settle(error.reason(), error.what());
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  frame.arrival_ns = now();
  frame.arrival_steady_ns = steady_now();
  note_time(Stream::IMAGE, frame.stamp_ns);
  frame_period_.add(frame.stamp_ns);
  ++statistics_.frames_in;
  queue_.push(std::move(frame));
}

bool Processor::find_calibration(PendingFrame& frame, bool timed_out) {
  const int width_px = static_cast<int>(frame.image->width), height_px = static_cast<int>(frame.image->height);
  const std::optional<CameraCalibration> file =
      config_->calibration ? config_->calibration->camera : std::optional<CameraCalibration>();
  // Only camera_info can tell which part of the sensor an image of another size shows.
  const bool file_fits = file && file->width_px == width_px && file->height_px == height_px;
  if (const sensor_msgs::CameraInfoConstPtr* info = infos_.find(frame.stamp_ns)) {
    frame.info = *info;
    frame.described_by_topic = true;
  } else if (frame.calibration) {
    return true;  // the file's, from before anybody sent camera_info
  } else if (file && !config_->rectified_input && ((!info_seen_ && file_fits) || timed_out)) {
    auto described = boost::make_shared<sensor_msgs::CameraInfo>(camera_info_message(*file));
    described->header = frame.image->header;
    frame.info = described;
  } else if (timed_out) {
    frame.settle(PassThroughReason::NO_CALIBRATION,
                 "no camera_info with the image's stamp " + seconds_text(frame.stamp_ns) + " s");
    return true;
  } else {
    return false;
  }
  try {
    if (!file || !frame.described_by_topic) {
      frame.calibration = to_calibration(*frame.info, width_px, height_px, config_->rectified_input);
      return true;
    }
    // The file describes the whole sensor; camera_info says which part of it the image shows.
    sensor_msgs::CameraInfo described = camera_info_message(*file);
    described.roi = frame.info->roi;
    described.binning_x = frame.info->binning_x;
    described.binning_y = frame.info->binning_y;
    if (config_->on_calibration_conflict == OnCalibrationConflict::CONFIGURED && !config_->rectified_input) {
      frame.calibration = to_calibration(described, width_px, height_px, false);
      return true;
    }
    frame.calibration = to_calibration(*frame.info, width_px, height_px, config_->rectified_input);
    // P and R of a rectified image have no counterpart in the file.
    if (!config_->rectified_input) {
      require_agreement(*frame.calibration, "camera_info", to_calibration(described, width_px, height_px, false),
                        config_->calibration->origin);
    }
  } catch (const OptionError& error) {
    frame.calibration.reset();
    frame.settle(PassThroughReason::NO_CALIBRATION, error.what());
  }
  return true;
}

bool Processor::find_extrinsic(PendingFrame& frame, bool timed_out, Eigen::Matrix3d* R_cam_imu) {
  const std::string& camera_frame = frame.image->header.frame_id;
  const std::string imu_frame = gyro_source_->frame_id();
  const bool ask_tf = !config_->R_cam_imu || config_->on_calibration_conflict == OnCalibrationConflict::ERROR;
  std::optional<Eigen::Matrix3d> from_tf;
  if (ask_tf && environment_.extrinsic) from_tf = environment_.extrinsic(camera_frame, imu_frame);
  if (config_->R_cam_imu) {
    *R_cam_imu = *config_->R_cam_imu;
    try {
      if (from_tf) {
        const bool from_file = config_->calibration && config_->calibration->R_cam_imu;
        require_agreement(*config_->R_cam_imu, from_file ? config_->calibration->origin : "parameter R_cam_imu",
                          *from_tf, "tf");
      }
    } catch (const OptionError& error) {
      frame.settle(PassThroughReason::NO_EXTRINSIC, error.what());
    }
    return true;
  }
  if (from_tf) {
    *R_cam_imu = *from_tf;
    return true;
  }
  if (!timed_out) return false;
  frame.settle(PassThroughReason::NO_EXTRINSIC, "no transform from IMU frame \"" + imu_frame + "\" to camera frame \"" +
                                                    camera_frame + "\", and no parameter R_cam_imu");
  return true;
}

bool Processor::prepare(PendingFrame& frame, bool timed_out, Job* job) {
  if (frame.verdict != PassThroughReason::NONE) return true;
  if (!config_) {
    frame.settle(PassThroughReason::BAD_CONFIGURATION, config_error_);
    return true;
  }

  // A frame that goes by the file, and still waits, goes by its camera_info as soon as that has come.
  if (!frame.described_by_topic && !find_calibration(frame, timed_out)) return false;
  if (frame.verdict != PassThroughReason::NONE) return true;

  ShutterTiming timing = config_->shutter;
  timing.readout_ns = region_readout_ns(timing.readout_ns, *frame.info);
  if (const Exposure* message = exposures_.find(frame.stamp_ns)) {
    timing.exposure_ns = message->exposure_time.toNSec();
    if (!message->readout_time.isZero()) timing.readout_ns = message->readout_time.toNSec();
  } else if (exposure_setting_ns_) {
    timing.exposure_ns = *exposure_setting_ns_;
  } else {
    const bool expected = exposure_seen_ || (environment_.exposure_expected && environment_.exposure_expected());
    if ((expected || timing.exposure_ns == 0) && !timed_out) return false;
    const TimeNs oldest_ns = frame.stamp_ns - config_->exposure_max_age_ns;
    if (const Exposure* before = exposures_.find_before(frame.stamp_ns, oldest_ns)) {
      timing.exposure_ns = before->exposure_time.toNSec();
      if (!before->readout_time.isZero()) timing.readout_ns = before->readout_time.toNSec();
    } else if (timing.exposure_ns == 0) {
      frame.settle(PassThroughReason::NO_EXPOSURE_TIME,
                   "no exposure message with the image's stamp " + seconds_text(frame.stamp_ns) +
                       " s, none within exposure_max_age = " + seconds_text(config_->exposure_max_age_ns) +
                       " s before it, and parameter exposure_time = 0 is outside (0, 1] s");
      return true;
    } else if (expected) {
      log_(LogLevel::WARNING, "exposure message missing",
           "no exposure message with the image's stamp " + seconds_text(frame.stamp_ns) +
               " s: using parameter exposure_time = " + seconds_text(timing.exposure_ns) + " s");
    }
  }
  if (const std::optional<TimeNs> period_ns = frame_period_.get()) {
    try {
      require_plausible_readout("readout_time", timing.readout_ns, *period_ns);
    } catch (const OptionError& error) {
      frame.settle(PassThroughReason::BAD_CONFIGURATION, error.what());
      return true;
    }
  }
  try {
    job->exposure.emplace(frame.stamp_ns, static_cast<int>(frame.image->height), timing);
  } catch (const OptionError& error) {
    frame.settle(PassThroughReason::NO_EXPOSURE_TIME, error.what());
    return true;
  }

  job->gyro = config_->gyro;
  if (estimated_bias_rad_s_) job->gyro.bias_rad_s = *estimated_bias_rad_s_;
  const TimeNs reference_ns = job->exposure->reference_time(config_->pipeline.rectify_to);
  const TimeRange frame_cam = job->exposure->frame();
  const TimeRange needed_imu{std::min(frame_cam.begin_ns, reference_ns) + job->gyro.time_offset_ns,
                             std::max(frame_cam.end_ns, reference_ns) + job->gyro.time_offset_ns};
  const TimeRange available = gyro_.available();
  if (!timed_out) {
    if (gyro_.empty() || available.end_ns < needed_imu.end_ns) return false;
    // After a jump late samples of the old epoch say nothing about frames of the new one.
    if (jumps_.is_stale(Stream::IMU) && needed_imu.end_ns < available.begin_ns) return false;
  }
  job->coverage_text = coverage_text(needed_imu, gyro_.empty() ? std::nullopt : std::optional(available), job->gyro);
  if (gyro_.empty()) {  // nor is the IMU's frame known then
    frame.settle(PassThroughReason::NO_GYRO, job->coverage_text);
    return true;
  }

  if (!find_extrinsic(frame, timed_out, &job->R_cam_imu)) return false;
  if (frame.verdict != PassThroughReason::NONE) return true;
  job->samples = gyro_.window(needed_imu);
  job->tracker = tracker_;
  job->tracker_options = config_->tracker;
  if (const std::optional<TimeRange> seen_cam = tracker_->newest_frame()) {
    job->tracker_samples =
        gyro_.window({std::min(needed_imu.begin_ns, seen_cam->begin_ns + job->gyro.time_offset_ns),  //
                      needed_imu.end_ns});
  }
  if (translation_.expected()) {
    job->translation = translation_.around(frame_cam, *config_, frame.image->header.frame_id, gyro_source_->frame_id(),
                                           job->R_cam_imu, environment_.transform, &job->translation_text);
  }
  if (job->translation && !job->translation->velocities.empty()) {
    const std::vector<VelocitySample>& velocities = job->translation->velocities;
    job->translation->samples =
        gyro_.window({std::min(needed_imu.begin_ns, velocities.front().t_ns + job->gyro.time_offset_ns),
                      std::max(needed_imu.end_ns, velocities.back().t_ns + job->gyro.time_offset_ns)});
  }
  return true;
}

std::optional<Processor::Job> Processor::next_job(bool finishing) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const TimeNs now_ns = now();
  if (queue_.empty()) return std::nullopt;
  PendingFrame& frame = queue_.front();
  bool timed_out = finishing;
  if (config_) {
    const TimeNs timeout_ns = config_->gyro_timeout_ns;
    timed_out =
        timed_out || now_ns - frame.arrival_ns >= timeout_ns ||
        (environment_.steady_clock && steady_now() - frame.arrival_steady_ns >= kSteadyTimeoutFactor * timeout_ns);
  }
  Job job;
  try {
    if (!prepare(frame, timed_out, &job)) return std::nullopt;
  } catch (const std::exception& error) {
    // Without a verdict the frame would be tried again for ever, and hold up all that come after it.
    frame.settle(PassThroughReason::INTERNAL_ERROR, error.what());
  }
  if (!frame.info) {
    if (const sensor_msgs::CameraInfoConstPtr* info = infos_.find(frame.stamp_ns)) frame.info = *info;
  }
  job.pipeline = pipeline_;
  if (config_) {
    job.options = config_->pipeline;
    job.rectified_input = config_->rectified_input;
  }
  job.frame = queue_.pop();
  ++in_progress_;
  return job;
}

void Processor::run_pipeline(const Job& job, FrameOutput* output) const {
  auto start = std::chrono::steady_clock::now();
  const ImageView view = view_image(*job.frame.image);
  output->messages_ms += elapsed_ms(start);

  job.pipeline->set_options(job.options);
  job.pipeline->set_calibration(*job.frame.calibration);
  const RotationTrack motion(job.samples, job.gyro, job.R_cam_imu);
  std::optional<RotationTrack> longer;  // covers the odometry as well
  std::optional<TranslatedMotion> translated;
  output->translation_text = job.translation_text;
  if (job.translation) {
    longer.emplace(job.translation->samples, job.gyro, job.R_cam_imu);
    const std::optional<BodyVelocity> velocity =
        fit_velocity(job.translation->velocities, job.translation->forces, *longer, job.translation->R_cam_body,
                     job.exposure->frame(), job.translation->options, &output->translation_text);
    if (velocity) {
      translated.emplace(*longer, *velocity, job.translation->p_cam_body_m, job.translation->depth_m);
      output->translated = true;
    }
  }
  const CameraMotion& camera_motion = translated ? static_cast<const CameraMotion&>(*translated) : motion;
  PipelineResult result =
      job.pipeline->process(view.image, view.layout, camera_motion, *job.exposure,
                            PipelineRequest{job.request.image, job.request.keypoints, job.request.tracks});
  output->stages = result.times;
  if (const std::string warning = job.pipeline->take_warning(); !warning.empty()) {
    environment_.log(LogLevel::WARNING, warning);
  }

  const std_msgs::Header& header = job.frame.image->header;
  if (job.request.tracks) {
    start = std::chrono::steady_clock::now();
    const RotationTrack since_last(job.tracker_samples, job.gyro, job.R_cam_imu);
    job.tracker->set_options(job.tracker_options);
    output->tracks = to_message(
        job.tracker->track(result.luminance, Camera(*job.frame.calibration), since_last, *job.exposure), header);
    output->tracks_ms = elapsed_ms(start);
  }

  start = std::chrono::steady_clock::now();
  if (!result.image.empty()) output->image = to_image(result.image, *job.frame.image);
  if (job.request.keypoints) {
    output->keypoints = to_message(result, job.pipeline->options().keypoints, header);
  }
  if (job.request.overlay) {
    output->overlay = to_bgr_image(draw_overlay(luminance8(view.image, view.layout), result.field), header);
  }
  if (job.request.markers) output->markers = to_markers(result.field, Camera(*job.frame.calibration), header);
  output->blur_field = to_message(result.field, header);
  const std::size_t uncovered = result.field.count(BlockStatus::NO_GYRO);
  const bool gyro_covers = motion.covers(job.exposure->frame());
  const std::string saturation = gyro_covers ? "" : saturation_text(job.samples, job.gyro);
  if (uncovered > 0) {
    output->reason_text = gyro_covers          ? "blocks lie beyond the range of the lens model"
                          : saturation.empty() ? job.coverage_text
                                               : saturation;
  }
  if (uncovered == result.field.blocks.size()) {
    output->reason = gyro_covers          ? PassThroughReason::NO_CALIBRATION
                     : saturation.empty() ? PassThroughReason::NO_GYRO
                                          : PassThroughReason::GYRO_SATURATED;
    output->blur_field = pass_through_message(output->reason, output->reason_text, *job.frame.image);
  }
  if (output->reason_text.empty() && !output->translation_text.empty()) {
    output->reason_text = "rotation only: " + output->translation_text;
  }
  output->blur_field->reason_text = output->reason_text;
  output->field = std::move(result.field);
  output->messages_ms += elapsed_ms(start);
}

KeypointArrayPtr Processor::raw_keypoints(const Job& job, PassThroughReason reason) const {
  auto none = boost::make_shared<KeypointArray>();
  none->header = job.frame.image->header;
  none->reference_time = none->header.stamp;
  // When too much waits, what is left of the work has to be quick.
  if (!job.pipeline || reason == PassThroughReason::OVERLOAD) return none;
  try {
    const ImageView view = view_image(*job.frame.image);
    std::optional<CameraCalibration> calibration = job.frame.calibration;
    if (!calibration && job.frame.info) {
      try {
        calibration = to_calibration(*job.frame.info, view.image.cols, view.image.rows, job.rectified_input);
      } catch (const OptionError&) {
        // Normalised coordinates are not known then.
      }
    }
    job.pipeline->set_options(job.options);
    return to_message(job.pipeline->detect(view.image, view.layout, job.frame.stamp_ns, calibration),
                      job.options.keypoints, none->header);
  } catch (const std::exception&) {
    return none;  // the frame has its reason already
  }
}

FrameOutput Processor::process(const Job& job) const {
  const auto start = std::chrono::steady_clock::now();
  const sensor_msgs::ImageConstPtr& image = job.frame.image;
  FrameOutput output;
  output.input = image;
  output.image = image;
  output.waiting_ms = static_cast<double>(steady_now() - job.frame.arrival_steady_ns) * 1e-6;
  output.reason = job.frame.verdict;
  output.reason_text = job.frame.verdict_text;
  if (output.reason == PassThroughReason::NONE) {
    std::optional<std::string> failure;
    try {
      run_pipeline(job, &output);
    } catch (const std::exception& error) {
      failure = error.what();
    } catch (...) {
      failure = "an exception of unknown type";
    }
    if (failure) {
      output.reason = PassThroughReason::INTERNAL_ERROR;
      output.reason_text = *failure;
      output.image = image;
      output.field.reset();
      output.blur_field.reset();
      output.keypoints.reset();
      output.overlay.reset();
      output.markers.reset();
      output.tracks.reset();
    }
  }
  output.camera_info =
      job.frame.info ? job.frame.info : sensor_msgs::CameraInfoConstPtr(uncalibrated_camera_info(*image));
  if (!output.blur_field) output.blur_field = pass_through_message(output.reason, output.reason_text, *image);
  if (job.request.keypoints && !output.keypoints) output.keypoints = raw_keypoints(job, output.reason);
  if (job.request.markers && !output.markers) output.markers = no_markers(image->header);
  output.total_ms = elapsed_ms(start);
  return output;
}

void Processor::advance(const Sink& sink, bool finishing) {
  const std::lock_guard<std::mutex> one_at_a_time(advance_mutex_);
  while (std::optional<Job> job = next_job(finishing)) {
    FrameOutput output;
    try {
      if (environment_.request) job->request = environment_.request();
      output = process(*job);
    } catch (...) {
      // Even passing it through failed, for lack of memory for example: it stays the first to leave.
      const std::lock_guard<std::mutex> lock(mutex_);
      --in_progress_;
      job->frame.verdict = PassThroughReason::INTERNAL_ERROR;
      queue_.put_back(std::move(job->frame));
      throw;
    }
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      --in_progress_;
      ++statistics_.frames_out;
      if (output.reason != PassThroughReason::NONE) ++statistics_.passed_through[output.reason];
      if (output.field) {
        for (const BlockBlur& block : output.field->blocks) ++statistics_.blocks[block.status];
      }
      if (output.translated) ++statistics_.frames_translated;
      if (!output.translation_text.empty()) {
        ++statistics_.frames_not_translated;
        statistics_.translation_text = output.translation_text;
        log_(LogLevel::WARNING, "translation",
             "frame " + seconds_text(job->frame.stamp_ns) +
                 " is deblurred with the rotation alone: " + output.translation_text);
      }
      // A jump has told its one message already.
      if (output.reason != PassThroughReason::NONE && output.reason != PassThroughReason::TIME_JUMP) {
        log_(level_of(output.reason), to_string(output.reason),
             "frame " + seconds_text(job->frame.stamp_ns) + " passes through unchanged: " + to_string(output.reason) +
                 ": " + output.reason_text);
      }
    }
    if (!sink(std::move(output))) return;
  }
}

void Processor::advance(const Sink& sink) { advance(sink, false); }

void Processor::finish(const Sink& sink) { advance(sink, true); }

std::size_t Processor::waiting() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return queue_.size() + in_progress_;
}

void Processor::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  queue_.settle_all(PassThroughReason::TIME_JUMP, "reset was asked for while the frame waited");
  gyro_.update();
  gyro_.forget();
  infos_.clear();
  exposures_.clear();
  exposure_seen_ = false;
  translation_.clear();
  info_seen_ = false;
  frame_period_.clear();
  estimated_bias_rad_s_.reset();
  jumps_.clear();
  log_.clear();
}

bool Processor::estimate_bias(std::string* text) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!config_) {
    *text = "the configuration cannot be used: " + config_error_;
    return false;
  }
  const TimeRange available = gyro_.available();
  const TimeRange wanted{available.end_ns - config_->bias_window_ns, available.end_ns};
  std::vector<GyroSample> samples;
  if (!gyro_.empty()) samples = gyro_.window(wanted);
  const double span_s = samples.empty() ? 0 : to_seconds(samples.back().t_ns - samples.front().t_ns);
  if (span_s < kMinBiasCoverage * to_seconds(config_->bias_window_ns)) {
    *text = "gyroscope samples span " + std::to_string(span_s) +
            " s, bias_window = " + std::to_string(to_seconds(config_->bias_window_ns)) + " s is needed";
    return false;
  }
  const std::optional<BiasEstimate> estimate =
      estimate_stationary_bias(samples, config_->bias_max_stddev_rad_s, kMinBiasSamples, text);
  if (!estimate) return false;
  GyroOptions corrected = config_->gyro;
  corrected.bias_rad_s = estimate->bias_rad_s;
  try {
    corrected.validate();  // a constant rotation looks like rest, but no bias is that large
  } catch (const OptionError& error) {
    *text = error.what();
    return false;
  }
  estimated_bias_rad_s_ = estimate->bias_rad_s;
  *text = "gyro_bias = " + vector_text(estimate->bias_rad_s) + " rad/s in use, from " +
          std::to_string(estimate->samples) + " samples with a standard deviation of " +
          vector_text(estimate->stddev_rad_s) + " rad/s";
  return true;
}

Eigen::Vector3d Processor::bias_rad_s() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (estimated_bias_rad_s_) return *estimated_bias_rad_s_;
  return config_ ? config_->gyro.bias_rad_s : Config().gyro.bias_rad_s;
}

ProcessorStatistics Processor::statistics() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  ProcessorStatistics statistics = statistics_;
  static_cast<ImuStatistics&>(statistics) = gyro_source_->statistics();
  statistics.waiting = queue_.size() + in_progress_;
  statistics.gyro_available = gyro_.available();
  if (!gyro_.empty()) statistics.newest_imu_ns = gyro_.available().end_ns;
  if (pipeline_) statistics.engine = pipeline_->engine();
  statistics.configuration_error = config_error_;
  return statistics;
}

}  // namespace gyro_deblur
