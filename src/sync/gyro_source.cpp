// Takes in the samples of an IMU and rejects those whose stamps do not fit.
#include "sync/gyro_source.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "base/format.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

GyroSource::Options GyroSource::options_of(const Config& config) {
  return {config.gyro.buffer_ns, config.time_jump_ns, config.gyro};
}

GyroSource::GyroSource(const Options& options, Log log)
    : problems_(std::move(log)), options_(options), buffer_(options.capacity_ns) {}

void GyroSource::resize(TimeNs capacity_ns) {
  if (capacity_ns == options_.capacity_ns) return;
  GyroBuffer resized(capacity_ns);
  if (!buffer_.empty()) {
    for (const GyroSample& sample : buffer_.window(buffer_.available())) resized.add(sample);
  }
  buffer_ = std::move(resized);
  options_.capacity_ns = capacity_ns;
}

void GyroSource::set_options(const Options& options) {
  const std::lock_guard<std::mutex> lock(mutex_);
  resize(options.capacity_ns);
  options_ = options;
}

void GyroSource::require_capacity(TimeNs capacity_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  resize(std::max(options_.capacity_ns, capacity_ns));
}

bool GyroSource::add(const std::optional<GyroSample>& sample, const std::string& frame_id) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!sample) {
    ++statistics_.imu_without_gyroscope;
    check_.add_without_rates();
    return false;
  }
  frame_id_ = frame_id;
  if (!sample->rate_rad_s.allFinite()) {
    // The stamp of such a message means nothing.
    ++statistics_.imu_not_finite;
    problems_.log(LogLevel::WARNING, "imu not finite",
                  "imu sample at " + seconds_text(sample->t_ns) + " s dropped: its angular velocity " +
                      vector_text(sample->rate_rad_s) + " rad/s is not finite. Check the IMU's driver");
    return false;
  }
  check_.add(*sample, options_.gyro);
  return take(*sample);
}

bool GyroSource::take(const GyroSample& sample) {
  const auto result = stamps_.add(sample, imu_stamps(check_.longest_step_ns(options_.gyro), options_.time_jump_ns));
  if (result.newest_refused) {
    --statistics_.imu_accepted;
    if (is_saturated(buffer_.drop_newest(), options_.gyro)) --statistics_.imu_saturated;
  }
  if (result.reset) {
    ++epoch_;
    restarted_from_ns_ = result.reset->from_ns;
    restarted_at_ns_ = result.reset->to_ns;
    buffer_.clear();
  }
  for (const GyroSample& taken : result.taken) {
    buffer_.add(taken);
    ++statistics_.imu_accepted;
    if (is_saturated(taken, options_.gyro)) ++statistics_.imu_saturated;
  }
  if (result.late) ++statistics_.imu_out_of_order;
  for (const auto& refused : result.refused) refuse(refused);
  return !result.taken.empty();
}

void GyroSource::refuse(const TimestampFilterResult<GyroSample>::Refused& refused) {
  const std::string stamp_text = seconds_text(refused.message.t_ns);
  switch (refused.why) {
    case RejectReason::REPEATED:
      ++statistics_.imu_duplicate;
      problems_.log(LogLevel::WARNING, "imu duplicate",
                    "imu sample dropped: a second one with the stamp " + stamp_text +
                        " s. Check that one driver publishes to imu");
      break;
    case RejectReason::LATE:  // counted when it came
      problems_.log(LogLevel::WARNING, "imu out of order",
                    "imu sample dropped: its stamp " + stamp_text +
                        " s is before that of the previous one. Check the IMU's driver");
      break;
    case RejectReason::FAR:
    case RejectReason::AHEAD:
      ++statistics_.imu_stray;
      problems_.log(LogLevel::WARNING, "imu stray",
                    "imu sample dropped: its stamp " + stamp_text +
                        " s is far from those of the samples around it. Check the IMU's clock");
      break;
  }
}

ImuStatistics GyroSource::statistics() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return statistics_;
}

bool GyroSource::unit_is_wrong() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return check_.unit_is_wrong();
}

bool GyroSource::rates_are_zero() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return check_.rates_are_zero();
}

std::string GyroSource::frame_id() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return frame_id_;
}

GyroReader::GyroReader(std::shared_ptr<GyroSource> source) : source_(std::move(source)) {
  const std::lock_guard<std::mutex> lock(source_->mutex_);
  // A restart before this reader was made does not count for it.
  seen_.epoch = source_->epoch_;
  forgotten_.epoch = seen_.epoch;
}

GyroReader::News GyroReader::update() {
  const std::lock_guard<std::mutex> lock(source_->mutex_);
  News news;
  news.restarted = source_->epoch_ != seen_.epoch;
  news.from_ns = source_->restarted_from_ns_;
  news.to_ns = source_->restarted_at_ns_;
  news.samples = source_->statistics_.imu_accepted - seen_.accepted;
  if (!source_->buffer_.empty()) news.newest_ns = source_->buffer_.available().end_ns;
  seen_ = {source_->epoch_, source_->statistics_.imu_accepted, news.newest_ns};
  return news;
}

TimeNs GyroReader::horizon_ns() const {
  // Within an epoch samples are in order, so that those up to a time are those that had come then. (Had the newest of
  // them to be given back since, a few that came after it, up to its stamp, are not seen either.)
  if (forgotten_.epoch != source_->epoch_ || !forgotten_.newest_ns) return std::numeric_limits<TimeNs>::min();
  return *forgotten_.newest_ns + 1;
}

TimeRange GyroReader::available() const {
  const std::lock_guard<std::mutex> lock(source_->mutex_);
  const TimeRange all = source_->buffer_.available();
  const TimeNs horizon = horizon_ns();
  if (all.empty() || all.begin_ns >= horizon) return all;
  for (const GyroSample& sample : source_->buffer_.window({horizon, horizon})) {
    if (sample.t_ns >= horizon) return {sample.t_ns, all.end_ns};
  }
  return {};
}

std::vector<GyroSample> GyroReader::window(const TimeRange& requested) const {
  const std::lock_guard<std::mutex> lock(source_->mutex_);
  std::vector<GyroSample> samples = source_->buffer_.window(requested);
  const TimeNs horizon = horizon_ns();
  samples.erase(samples.begin(), std::find_if(samples.begin(), samples.end(),
                                              [=](const GyroSample& sample) { return sample.t_ns >= horizon; }));
  return samples;
}

}  // namespace gyro_deblur
