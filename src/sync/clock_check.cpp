// Compares the stamps of images and IMU samples.
#include "sync/clock_check.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "base/format.hpp"

namespace gyro_deblur {
namespace {

constexpr char kClocks[] = "clocks";

}  // namespace

ClockCheck::Side ClockCheck::side(const Config& config, bool is_live) const {
  // Live, frames end their waiting for samples that come later than the timeout, and those older than the buffer are
  // gone; a second of latency is usual. What a recorder writes, it writes within a few seconds.
  constexpr TimeNs kUsualLatencyNs = 1'000'000'000, kLatestRecordingNs = 10'000'000'000;
  const TimeNs ahead_ns = *newest_image_ns_ + config.gyro.time_offset_ns - *newest_imu_ns_;
  if (ahead_ns > (is_live ? std::max(config.input_timeout_ns, kUsualLatencyNs) : kLatestRecordingNs)) {
    return Side::IMAGES_AHEAD;
  }
  if (-ahead_ns > (is_live ? std::max(config.gyro.buffer_ns, kUsualLatencyNs) : kLatestRecordingNs)) {
    return Side::IMAGES_BEHIND;
  }
  return Side::TOGETHER;
}

void ClockCheck::check(const Config& config, TimeNs now_ns, bool is_live) {
  if (!newest_image_ns_ || !newest_imu_ns_) return;
  // For so long, with messages of both: one of the streams may have paused, or have been reset just before the other.
  constexpr TimeNs kConfirmedNs = 500'000'000;
  constexpr std::size_t kFewestSamples = 2;
  const Side now = side(config, is_live);
  if (now != side_ || now_ns < since_ns_) {
    side_ = now;
    since_ns_ = now_ns;
    images_before_ = images_;
    samples_before_ = samples_;
  }
  if (side_ == Side::TOGETHER) {
    if (reported_) problems_.resolve(kClocks);
    reported_ = false;
    return;
  }
  if (reported_ || now_ns - since_ns_ < kConfirmedNs) return;
  if (images_ == images_before_ || samples_ < samples_before_ + kFewestSamples) return;
  report(config);
  reported_ = true;
}

void ClockCheck::report(const Config& config) const {
  const TimeNs offset_ns = *newest_imu_ns_ - *newest_image_ns_;
  const double ahead_s = to_seconds(config.gyro.time_offset_ns - offset_ns);
  const std::string cause = ahead_s > 0 ? "IMU comes late, raise input_timeout"
                                        : format("images come late, reduce their delay to less than %.3g s",
                                                 to_seconds(config.gyro.buffer_ns));
  const std::string text = format(
      "the stamps of images and IMU do not overlap: the newest image is of %.3f s, the newest IMU sample of "
      "%.3f s, so that images are %.3f s %s with time_offset = %.6g s. Where their clocks differ, begin with "
      "time_offset: %.3f and let calibrate refine it; where the %s",
      to_seconds(*newest_image_ns_), to_seconds(*newest_imu_ns_), std::abs(ahead_s), ahead_s > 0 ? "ahead" : "behind",
      to_seconds(config.gyro.time_offset_ns), to_seconds(offset_ns), cause.c_str());
  problems_.report(kClocks, text);
}

void ClockCheck::clear() {
  newest_image_ns_.reset();
  newest_imu_ns_.reset();
  side_ = Side::TOGETHER;
}

}  // namespace gyro_deblur
