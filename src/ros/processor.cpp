// Takes frames from input to output, with stereo partners, calibration and overload.
#include "ros/processor.hpp"

#include <algorithm>
#include <thread>
#include <utility>
#include <vector>

#include "base/format.hpp"
#include "engine/engine.hpp"
#include "ros/calibration_conversion.hpp"
#include "ros/compressed_image.hpp"
#include "ros/image_conversion.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {

Processor::Processor(Environment environment)
    : environment_(std::move(environment)),
      problems_(environment_.log, environment_.steady_clock),
      gyro_source_(environment_.gyro
                       ? environment_.gyro
                       : std::make_shared<GyroSource>(GyroSource::options_of(Config()), environment_.log)),
      tracker_(TrackerOptions{}),
      self_calibrator_(environment_.self_calibration, &problems_),
      calibration_(&problems_),
      mask_(&problems_),
      synchronizer_(InputBuffers({environment_.clock, environment_.steady_clock}, gyro_source_,
                                 environment_.exposure_expected, &problems_),
                    environment_.extrinsic, &calibration_, &exposures_, &problems_) {
  if (environment_.stereo) environment_.stereo->set_wake([signal = signal_] { signal->notify(); });
}

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
  config_ = std::make_shared<const Config>(config);
  calibration_.set_config(config);
  record_calibration_file();
  self_calibrator_.set_expected_offset(config.given.time_offset ? config.gyro.time_offset_ns : 0);
  pipeline_ = std::move(pipeline);
  mask_.set_file(config.mask_file);
  synchronizer_.set_config(config);
  exposures_.set_policy(config.on_exposure_conflict);
  gyro_errors_.clear();
  if (environment_.stereo) environment_.stereo->set_timeout(config.stereo_sync_timeout_ns);
}

void Processor::set_config_error(const std::string& text) {
  const std::lock_guard<std::mutex> lock(mutex_);
  config_.reset();
  pipeline_.reset();
  synchronizer_.set_config_error(text);
  record_calibration_file();
  if (environment_.stereo)
    environment_.stereo->set_timeout(Config().stereo_sync_timeout_ns);  // its stereo partners pass through, too
}

void Processor::add_imu(const sensor_msgs::Imu& imu) {
  gyro_source_->add(to_gyro_sample(imu), imu.header.frame_id);
  on_imu_sample();
}

template <typename Add>
void Processor::take_in(Add add) {
  const std::lock_guard<std::mutex> lock(mutex_);
  add();
  synchronizer_.mark_ready();
  notify_worker();
}

void Processor::on_imu_sample() {
  take_in([this] { synchronizer_.add_imu(); });
}

void Processor::add_exposure(const Exposure& exposure) {
  take_in([&] { synchronizer_.add_exposure(exposure); });
}

void Processor::add_exposure_setting(TimeNs exposure_ns) {
  take_in([&] { synchronizer_.add_exposure_setting(exposure_ns); });
}

void Processor::add_camera_info(const sensor_msgs::CameraInfoConstPtr& info) {
  take_in([&] { synchronizer_.add_camera_info(info); });
}

bool Processor::add_compressed_image(const sensor_msgs::CompressedImage& compressed) {
  const DecodedImage decoded = decode_image(compressed);
  if (decoded.image) {
    add_image(decoded.image, decoded.problem);
    return true;
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  synchronizer_.count_undecodable("compressed image " + seconds_text(to_time_ns(compressed.header.stamp)) +
                                  " is left out: " + decoded.problem);
  return false;
}

void Processor::add_image(const sensor_msgs::ImageConstPtr& image, const std::string& problem) {
  PendingFrame frame;
  frame.image = image;
  frame.stamp_ns = to_time_ns(image->header.stamp);
  try {
    check_image(*image);
    if (!problem.empty()) throw FrameError(PassThroughReason::BAD_IMAGE, problem);
    if (is_unset(frame.stamp_ns)) throw FrameError(PassThroughReason::NO_STAMP, "the image's stamp is 0");
  } catch (const FrameError& error) {
    frame.pass_through(error.reason(), error.what());
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  if (frame.pass_through_reason == PassThroughReason::NONE) remember_calibration(*image);
  // One without a stamp is no image of the instant 0.
  if (environment_.stereo && !is_unset(frame.stamp_ns)) environment_.stereo->announce(frame.stamp_ns);
  synchronizer_.add_image(std::move(frame));
  synchronizer_.mark_ready();
  notify_worker();
  notify_stereo();
}

void Processor::add_mask(const sensor_msgs::Image& mask) {
  const std::lock_guard<std::mutex> lock(mutex_);
  mask_.set_message(mask);
}

void Processor::notify_stereo() {
  if (!environment_.stereo) return;
  for (PendingFrame& each : synchronizer_.queue().frames()) {
    if (each.pass_through_reason == PassThroughReason::NONE || each.partners_notified) continue;
    environment_.stereo->pass_through(each.stamp_ns, each.pass_through_reason);
    each.partners_notified = true;
  }
}

void Processor::learn_from(const SynchronizedFrame& synchronized, const std::optional<FrameExposure>& found) {
  const PendingFrame& frame = synchronized.frame;
  std::vector<GyroSample> samples;
  std::optional<SelfCalibrator::Image> image;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!config_ || !frame.calibration) return;
    const bool lens_known = frame.lens == Lens::CALIBRATED;
    calibration_.set_lens_known(lens_known);
    if (config_->self_calibration == SelfCalibrationMode::NEVER) return;
    if (frame.repeats || frame.pass_through_reason == PassThroughReason::TIME_JUMP) return;
    const bool asked_tf = frame.pass_through_reason == PassThroughReason::NONE ||
                          frame.pass_through_reason == PassThroughReason::NO_EXTRINSIC;
    if (asked_tf && frame.lens != Lens::UNKNOWN) {
      calibration_.set_tf(synchronized.R_by_tf ? std::optional(synchronized.R_cam_imu) : std::nullopt);
    }
    constexpr TimeNs kSecond = 1'000'000'000;
    readout_share_ = to_seconds(region_readout_ns(kSecond, *frame.info));
    ShutterTiming timing = config_->shutter;
    const TimeNs assumed_ns = synchronized.exposure ? synchronized.exposure->timing().exposure_ns : 0;
    timing.exposure_ns = std::max<TimeNs>(found ? found->exposure_ns : assumed_ns, 1);
    if (synchronized.exposure) readout_by_messages_ = synchronized.readout_by_message;
    if (synchronized.exposure && (config_->given.readout_time || synchronized.readout_by_message)) {
      timing.readout_ns = synchronized.exposure->timing().readout_ns;
    } else {
      timing.readout_ns = region_readout_ns(timing.readout_ns, *frame.info);
    }
    image.emplace(SelfCalibrator::Image{frame.image, *frame.calibration,
                                        RowExposure(frame.picture_ns(), static_cast<int>(frame.image->height), timing),
                                        synchronized.mask, lens_known});
    const TimeRange available = synchronizer_.gyro().available();
    if (!available.empty()) {
      if (newest_learned_ns_ > available.end_ns) newest_learned_ns_.reset();
      const TimeNs from_ns = newest_learned_ns_ ? *newest_learned_ns_ + 1 : available.begin_ns;
      for (const GyroSample& sample : synchronizer_.gyro().window({from_ns, available.end_ns})) {
        if (sample.t_ns >= from_ns) samples.push_back(sample);
      }
      newest_learned_ns_ = available.end_ns;
    }
  }
  self_calibrator_.add(std::move(samples), std::move(*image));
}

std::shared_ptr<FrameInWork> Processor::next_frame(bool finishing) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (signal_->stopped() && !finishing) return nullptr;
  std::shared_ptr<FrameInWork> work = synchronizer_.resume();
  if (!work) {
    std::optional<SynchronizedFrame> next = synchronize(finishing);
    if (!next) return nullptr;
    work = std::make_shared<FrameInWork>(std::move(*next));
    work->idle_since_ns = work->synchronized.frame.arrival_steady_ns;
  }
  ++in_progress_;
  return work;
}

std::optional<SynchronizedFrame> Processor::synchronize(bool finishing) {
  const std::size_t updates = self_calibrator_.updates();
  if (std::exchange(calibration_updates_, updates) != updates &&
      calibration_.learn(self_calibrator_.learned(), readout_share_, readout_by_messages_)) {
    gyro_errors_.clear();
  }
  if (std::exchange(time_jumps_, synchronizer_.statistics().time_jumps) != synchronizer_.statistics().time_jumps)
    exposures_.reset();
  std::optional<SynchronizedFrame> next =
      synchronizer_.next({tracker_.newest_frame(), pipeline_ ? pipeline_->newest_frame() : std::nullopt}, finishing);
  if (!next) return std::nullopt;
  next->pipeline = pipeline_;
  next->config = config_;
  const PendingFrame& frame = next->frame;
  if (config_ && config_->drop_poor) {
    // By rates of a wrong unit every image looks POOR.
    const bool unit_is_uncertain = config_->pipeline.optical_flow && gyro_unit_.is_uncertain(frame.stamp_ns);
    next->drop_poor = !unit_is_uncertain && !gyro_unit_is_wrong_ && !gyro_source_->unit_is_wrong();
  }
  if (frame.pass_through_reason != PassThroughReason::BAD_IMAGE &&
      frame.pass_through_reason != PassThroughReason::UNSUPPORTED_ENCODING) {
    next->mask = mask_.for_image({static_cast<int>(frame.image->width), static_cast<int>(frame.image->height)});
  }
  return next;
}

void Processor::advance(const Sink& sink, bool finishing) {
  while (const std::shared_ptr<FrameInWork> work = next_frame(finishing)) {
    FrameOutput& output = work->output;
    PendingFrame& frame = work->synchronized.frame;
    try {
      output.waiting_ms += static_cast<double>(synchronizer_.steady_now() - work->idle_since_ns) * 1e-6;
      if (!process(work.get())) {
        put_back(work);
        if (!finishing) return;
        // wait() would return at once: a nodelet calls stop() before finish().
        constexpr std::chrono::milliseconds kPollPeriod{1};
        std::this_thread::sleep_for(kPollPeriod);
        continue;
      }
      if (!output.engine_warning.empty()) environment_.log(LogLevel::WARNING, output.engine_warning);
      try {
        learn_from(work->synchronized, output.exposure);
      } catch (const std::exception& error) {  // costs no frame
        problems_.log(LogLevel::ERROR, "self-calibration", std::string("self-calibration failed: ") + error.what());
      }
    } catch (...) {
      // Even passing it through failed, for lack of memory for example: it stays the first to be published.
      const std::lock_guard<std::mutex> lock(mutex_);
      --in_progress_;
      frame.pass_through_reason = PassThroughReason::INTERNAL_ERROR;
      synchronizer_.queue().put_back(std::move(frame));
      throw;
    }
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      --in_progress_;
      keep_global_shutter_in_order(&output);
      record(output);
    }
    if (!sink(std::move(output))) return;
  }
}

void Processor::put_back(const std::shared_ptr<FrameInWork>& work) {
  const std::lock_guard<std::mutex> lock(mutex_);
  work->idle_since_ns = synchronizer_.steady_now();
  PendingFrame frame = work->synchronized.frame;
  frame.in_work = work;
  synchronizer_.put_back(std::move(frame));
  --in_progress_;
  if (const auto deadline = environment_.stereo->deadline()) signal_->notify_at(*deadline);
}

void Processor::finish(const Sink& sink) {
  advance(sink, true);
  const std::lock_guard<std::mutex> lock(mutex_);
  synchronizer_.finish();
}

std::size_t Processor::waiting() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return frames_waiting();
}

bool Processor::wait(std::chrono::nanoseconds poll) {
  return signal_->wait(waiting() > 0 ? std::optional(poll) : std::nullopt);
}

void Processor::notify_worker() {
  if (frames_waiting() > 0) signal_->notify();
}

void Processor::wake() {
  const std::lock_guard<std::mutex> lock(mutex_);
  notify_worker();
}

Awaited Processor::awaited() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return synchronizer_.queue().empty() ? Awaited::NOTHING : synchronizer_.queue().front().awaits;
}

void Processor::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  synchronizer_.reset();
  self_calibrator_.restart();
  gyro_errors_.clear();
  exposures_.reset();
  gyro_unit_.clear();
  gyro_unit_is_wrong_ = false;
  problems_.clear();
  record_calibration_file();
  notify_worker();
}

void Processor::reset_calibration() {
  self_calibrator_.clear();
  const std::lock_guard<std::mutex> lock(mutex_);
  calibration_.forget();
}

void Processor::remember_calibration(const sensor_msgs::Image& image) {
  if (image_size_ || !config_) return;
  image_size_.emplace(static_cast<int>(image.width), static_cast<int>(image.height));
  if (!environment_.stored_calibration || config_->self_calibration == SelfCalibrationMode::NEVER) return;
  const auto before = environment_.stored_calibration(image_size_->width, image_size_->height);
  if (before) calibration_.remember(*before);
}

std::optional<Processor::CalibrationByImages> Processor::calibration_by_images() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!image_size_) return std::nullopt;
  return CalibrationByImages{calibration_.by_images(), image_size_->width, image_size_->height};
}

}  // namespace gyro_deblur
