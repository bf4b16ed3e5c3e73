// Takes in images and the messages that belong to them.
#include "ros/input_buffers.hpp"

#include <utility>

#include "base/format.hpp"
#include "ros/calibration_conversion.hpp"
#include "ros/value_conversion.hpp"
#include "sync/exposure_check.hpp"

namespace gyro_deblur {
namespace {

constexpr char kImuSilent[] = "imu silent";

}  // namespace

bool SameCameraInfo::operator()(const sensor_msgs::CameraInfoConstPtr& a,
                                const sensor_msgs::CameraInfoConstPtr& b) const {
  sensor_msgs::CameraInfo like_a = *b;
  like_a.header.stamp = a->header.stamp;
  like_a.header.seq = a->header.seq;
  return *a == like_a;
}

bool SameExposure::operator()(const Exposure& a, const Exposure& b) const {
  return a.exposure_time == b.exposure_time && a.readout_time == b.readout_time;
}

InputBuffers::InputBuffers(Clocks clocks, std::shared_ptr<GyroSource> gyro_source,
                           std::function<bool()> exposure_sender, InputProblems* problems)
    : clocks_(std::move(clocks)),
      gyro_source_(std::move(gyro_source)),
      exposure_sender_(std::move(exposure_sender)),
      problems_(*problems),
      jumps_(config_.time_jump_ns),
      gyro_(gyro_source_),
      repetitions_(problems),
      missing_(problems),
      clocks_apart_(problems),
      queue_(static_cast<std::size_t>(config_.frame_queue_size)) {}

void InputBuffers::set_config(const Config& config) {
  config_ = config;
  config_error_.clear();
  jumps_.set_threshold(config.time_jump_ns);
  queue_.set_capacity(static_cast<std::size_t>(config.frame_queue_size));
}

std::size_t InputBuffers::store_size() const {
  // What belongs to the waiting frames, and a second or so of what comes before its image.
  constexpr std::size_t kMargin = 100;
  return kMargin + 2 * static_cast<std::size_t>(config_.frame_queue_size);
}

void InputBuffers::forget(Stream stream, ShownBy shown_by) {
  if (stream == Stream::IMU && shown_by == ShownBy::OTHER) gyro_.forget();  // else the source has
  if (stream == Stream::IMAGE) {
    queue_.pass_through_old(shown_by, PassThroughReason::TIME_JUMP, "time went backwards while the frame waited");
  }
  if (stream == Stream::CAMERA_INFO) infos_.clear(shown_by);
  if (stream == Stream::EXPOSURE) exposures_.clear(shown_by);
}

void InputBuffers::handle(TimeJumpDetector::Result result, Stream stream, TimeNs from_ns, TimeNs to_ns) {
  if (result == TimeJumpDetector::Result::FORWARD) return;
  if (result == TimeJumpDetector::Result::FOLLOWS) return forget(stream, ShownBy::ITSELF);
  ++statistics_.time_jumps;
  clocks_apart_.clear();
  for (const Stream every : {Stream::IMU, Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE}) {
    forget(every, every == stream ? ShownBy::ITSELF : ShownBy::OTHER);
  }
  problems_.log(LogLevel::WARNING, std::string("time went backwards (") + to_string(stream) + " from " +
                                       seconds_text(from_ns) + " to " + seconds_text(to_ns) +
                                       " s): starting anew, frames that waited pass through unchanged");
}

void InputBuffers::record_time(Stream stream, TimeNs stamp_ns) {
  const TimeNs from_ns = jumps_.newest_ns(stream).value_or(stamp_ns);
  handle(jumps_.update(stream, stamp_ns), stream, from_ns, stamp_ns);
}

void InputBuffers::record_imu() {
  const GyroReader::News news = gyro_.update();
  // Without a sample from before none can be missing.
  if (news.restarted && jumps_.newest_ns(Stream::IMU)) {
    handle(jumps_.went_back(Stream::IMU, news.to_ns), Stream::IMU, news.from_ns, news.to_ns);
  }
  if (news.samples == 0 || !news.newest_ns) return;
  problems_.resolve(kImuSilent);
  without_imu_ = 0;
  jumps_.update(Stream::IMU, *news.newest_ns, news.samples);
  clocks_apart_.add_samples(*news.newest_ns, news.samples);
}

bool InputBuffers::exposure_expected() const { return exposures_.seen() || (exposure_sender_ && exposure_sender_()); }

bool InputBuffers::imu_is_silent(TimeNs begin_ns) const {
  constexpr TimeNs kSilenceNs = 1'000'000'000;  // less is a gap
  if (without_imu_ < StreamLiveness::kMissesEndWaiting) return false;
  const TimeRange available = gyro_.available();
  return available.empty() || begin_ns - available.end_ns > kSilenceNs;
}

void InputBuffers::count_without_imu(TimeNs begin_ns) {
  ++without_imu_;
  // One that has never come is reported among the missing inputs.
  if (gyro_.empty() || !imu_is_silent(begin_ns)) return;
  problems_.update(kImuSilent,
                   "the IMU has been silent since " + seconds_text(gyro_.available().end_ns) +
                       " s of its clock: images " +
                       (goes_without_imu(config_) ? "are deblurred by optical flow alone, which is less accurate,"
                                                  : "pass through unchanged") +
                       " until it comes again. Check its driver and its cable");
}

void InputBuffers::record_liveness(TimeNs now_ns) {
  const auto report = [this](const char* topic, std::optional<bool> awaited) {
    if (!awaited) return;
    const std::string kind = std::string(topic) + " liveness";
    problems_.log(*awaited ? LogLevel::INFO : LogLevel::WARNING, kind,
                  *awaited
                      ? std::string(topic) + " has resumed: images wait for it again"
                      : std::to_string(StreamLiveness::kMissesEndWaiting) + " consecutive images had no matching " +
                            topic + ": images no longer wait for it until it resumes");
  };
  report("camera_info", infos_.update(now_ns, config_.input_timeout_ns));
  // A setting serves all.
  if (!exposure_setting_ns_) report("exposure message", exposures_.update(now_ns, config_.input_timeout_ns));
}

TimeNs InputBuffers::now() {
  const TimeNs now_ns = clocks_.node();
  record_time(Stream::CLOCK, now_ns);
  record_imu();
  record_liveness(now_ns);
  if (clocks_.steady) missing_.check(config_, seen(), steady_now());
  clocks_apart_.check(config_, clocks_.steady ? steady_now() : now_ns, clocks_.steady != nullptr);
  for (PendingFrame& frame : queue_.frames()) {
    // Simulated time is 0 until its first message, and it can be set back: waiting starts anew then.
    if (frame.arrival_ns == 0 || frame.arrival_ns > now_ns) frame.arrival_ns = now_ns;
  }
  return now_ns;
}

bool InputBuffers::has_timed_out(const PendingFrame& frame, TimeNs now_ns) const {
  // Simulated time can stop, at the end of a bag for example: after so many timeouts of real time frames are passed
  // through anyway.
  constexpr TimeNs kSteadyTimeoutFactor = 10;
  const TimeNs timeout_ns = config_.input_timeout_ns;
  return now_ns - frame.arrival_ns >= timeout_ns ||
         (clocks_.steady && steady_now() - frame.arrival_steady_ns >= kSteadyTimeoutFactor * timeout_ns);
}

MissingInputs::Seen InputBuffers::seen() const {
  MissingInputs::Seen seen;
  seen.camera_info = infos_.seen();
  seen.imu = !gyro_.empty();
  seen.exposure = exposure_known_ || exposure_of_images_;
  if (!queue_.empty()) seen.extrinsic = queue_.front().missing_extrinsic;
  return seen;
}

void InputBuffers::check_exposure(ExposureOrigin origin, TimeNs exposure_ns) {
  if (exposure_ns == 0) {
    const std::string otherwise = config_.shutter.exposure_ns > 0
                                      ? "exposure_time = " + seconds_text(config_.shutter.exposure_ns) + " s"
                                      : "the estimate from their blur";
    problems_.report("exposure 0", std::string(name_of_given(origin)) +
                                       " is 0 s, taken as not known: images without an exposure time are deblurred " +
                                       "by that of adjacent images, otherwise by " + otherwise);
    return;
  }
  problems_.resolve("exposure 0");
  exposure_known_ = true;
  if (const std::optional<std::string> fault = exposure_fault(origin, exposure_ns, frame_period_)) {
    problems_.report("exposure", *fault);
  } else {
    problems_.resolve("exposure");
  }
}

void InputBuffers::check_parameters() {
  // Where exposure messages come, the parameter only replaces lost ones.
  if (exposure_known_ || config_.shutter.exposure_ns == 0) return;
  if (const auto fault = exposure_fault(ExposureOrigin::PARAMETER, config_.shutter.exposure_ns, frame_period_)) {
    const bool replaced = config_.on_exposure_conflict == OnExposureConflict::IMAGES;
    problems_.report("exposure_time",
                     *fault + (replaced ? ". It is not used: images pass through until their blur gives the exposure "
                                          "time. Correct exposure_time, or leave it empty"
                                        : ""));
  } else {
    problems_.resolve("exposure_time");
  }
}

void InputBuffers::add_exposure_setting(TimeNs exposure_ns) {
  exposure_setting_ns_ = exposure_ns;
  check_exposure(ExposureOrigin::SETTING, exposure_ns);
}

void InputBuffers::add_exposure(const Exposure& exposure) {
  now();
  const TimeNs stamp_ns = to_time_ns(exposure.header.stamp);
  problems_.update("exposure stamp", is_unset(stamp_ns)
                                         ? "exposure message has the stamp 0: it is used until the next one, like a "
                                           "driver's setting. Publish it with the stamp of its image"
                                         : "");
  if (is_unset(stamp_ns)) {
    // Where other messages have stamps it is not used: each image has its own message.
    if (exposures_.seen() || exposure.exposure_time <= ros::Duration()) return;
    add_exposure_setting(exposure.exposure_time.toNSec());
    setting_lacks_stamp_ = true;
    return;
  }
  if (setting_lacks_stamp_) exposure_setting_ns_.reset();
  setting_lacks_stamp_ = false;
  record_time(Stream::EXPOSURE, stamp_ns);
  check_exposure(ExposureOrigin::MESSAGE, exposure.exposure_time.toNSec());
  exposures_.add(stamp_ns, exposure, store_size());
}

void InputBuffers::add_camera_info(const sensor_msgs::CameraInfoConstPtr& info) {
  now();
  const TimeNs stamp_ns = to_time_ns(info->header.stamp);
  problems_.update("camera_info stamp", is_unset(stamp_ns) ? "camera_info has the stamp 0: each image uses the newest "
                                                             "one. Set the driver to give it the stamp of its image"
                                                           : "");
  problems_.update("camera_info size", lacks_size(*info) ? "camera_info has width and height 0: those of the image are "
                                                           "used. Set the driver to fill them in"
                                                         : "");
  if (!is_uncalibrated(*info, config_.rectified_input)) calibrated_ = true;
  if (is_unset(stamp_ns)) {
    infos_.add_unstamped(info);
    return;
  }
  record_time(Stream::CAMERA_INFO, stamp_ns);
  infos_.add(stamp_ns, info, store_size());
}

void InputBuffers::count_undecodable(const std::string& text) {
  constexpr char kKind[] = "compressed image";
  ++statistics_.undecodable_images;
  problems_.report(kKind, text);
  problems_.resolve(kKind);  // of this image alone; the diagnostics go by the count
}

void InputBuffers::add_image(PendingFrame frame) {
  frame.arrival_ns = now();
  frame.arrival_steady_ns = steady_now();
  ++statistics_.frames_in;
  if (is_unset(frame.stamp_ns)) {
    queue_.push(std::move(frame));
    return;
  }
  record_time(Stream::IMAGE, frame.stamp_ns);
  find_picture(&frame);
  if (frame.pass_through_reason == PassThroughReason::NONE) {
    // With a calibration file nobody has to send any.
    const bool info_expected = infos_.seen() || !config_.calibration || !config_.calibration->camera;
    if (info_expected) infos_.expect(frame.stamp_ns, frame.arrival_ns);
    if (exposure_expected() && !exposure_setting_ns_ && !frame.repeats)
      exposures_.expect(frame.stamp_ns, frame.arrival_ns);
  }
  check_parameters();
  if (frame.pass_through_reason == PassThroughReason::NONE) clocks_apart_.add_image(frame.stamp_ns);
  missing_.add_image(frame.arrival_steady_ns);
  queue_.push(std::move(frame));
}

void InputBuffers::find_picture(PendingFrame* frame) {
  if (frame->pass_through_reason == PassThroughReason::NONE) {
    const PictureTracker::Shown shown = pictures_.add(frame->image, frame->stamp_ns);
    frame->picture = shown.picture;
    frame->repeats = !shown.is_new;
  }
  if (frame->repeats) {
    ++statistics_.repeated_pictures;
  } else {
    frame_period_.add(frame->stamp_ns);
  }
}

void InputBuffers::reset() {
  queue_.pass_through_old(ShownBy::ITSELF, PassThroughReason::TIME_JUMP, "reset was asked for while the frame waited");
  gyro_.update();
  gyro_.forget();
  infos_.reset();
  calibrated_ = false;
  exposures_.reset();
  pictures_.forget();
  repetitions_.clear();
  frame_period_.clear();
  exposure_of_images_ = false;
  without_imu_ = 0;
  missing_.clear();
  clocks_apart_.clear();
  jumps_.clear();
}

}  // namespace gyro_deblur
