// Checks the samples of an IMU.
#include "sync/gyro_check.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "base/format.hpp"
#include "base/median.hpp"

namespace gyro_deblur {
namespace {

constexpr char kSlow[] = "imu rate", kUnit[] = "imu unit", kWithoutRates[] = "imu without gyroscope";

/// The widest range of consumer gyroscopes, 2000 degrees/s (InvenSense MPU-6000 to ICM-42688, Bosch BMI055 to BMI270,
/// ST LSM6DS), and 1 % for scale errors [rad/s].
constexpr double kFullScaleRadS = 1.01 * 2000 * M_PI / 180;

}  // namespace

void GyroCheck::add(const GyroSample& sample, const GyroOptions& options) {
  // So many without end the report: some drivers mix the messages of two sensors on one topic.
  constexpr std::size_t kRatesAgain = 20;
  if (++with_rates_ == kRatesAgain) problems_.resolve(kWithoutRates);
  last_ns_ = sample.t_ns;
  if (!sample.rate_rad_s.isZero(0)) {
    zero_since_ns_.reset();
  } else if (!zero_since_ns_ || *zero_since_ns_ > last_ns_) {
    zero_since_ns_ = last_ns_;
  }
  check_rate(sample.t_ns, options);
  check_unit(sample, options);
}

void GyroCheck::add_without_rates() {
  with_rates_ = 0;
  problems_.report(
      kWithoutRates,
      "imu message dropped: angular_velocity_covariance[0] = -1 says that it has no angular rates. Connect "
      "imu to the gyroscope's topic (realsense2_camera publishes accelerometer and gyroscope apart unless "
      "unite_imu_method is set)",
      LogLevel::ERROR);
}

TimeNs GyroCheck::longest_step_ns(const GyroOptions& options) const {
  return is_slow_ ? std::max(options.max_gap_ns, 2 * typical_step_ns_) : options.max_gap_ns;
}

void GyroCheck::check_rate(TimeNs stamp_ns, const GyroOptions& options) {
  constexpr std::size_t kKept = 16, kFewestSteps = 5, kMostBack = 1;
  stamps_.push_back(stamp_ns);
  if (stamps_.size() > kKept) stamps_.pop_front();
  std::vector<TimeNs> steps_ns;
  std::size_t back = 0;
  for (std::size_t i = 1; i < stamps_.size(); ++i) {
    if (stamps_[i] > stamps_[i - 1]) steps_ns.push_back(stamps_[i] - stamps_[i - 1]);
    back += stamps_[i] < stamps_[i - 1];
  }
  // One is a restart. More are wrong stamps, each of which makes a step forward too long as well.
  if (back > kMostBack || steps_ns.size() < kFewestSteps) return;
  typical_step_ns_ = median(std::move(steps_ns));
  const bool was_slow = std::exchange(is_slow_, typical_step_ns_ > options.max_gap_ns);
  if (is_slow_ && !was_slow) {
    problems_.report(
        kSlow,
        format("IMU samples come every %.3g s, and max_gyro_gap is %.3g s: nothing is integrated. Raise the IMU's "
               "rate, to 100 Hz or more; max_gyro_gap may be as long as rates hardly change",
               to_seconds(typical_step_ns_), to_seconds(options.max_gap_ns)));
  } else if (was_slow && !is_slow_) {
    problems_.resolve(kSlow);
  }
}

void GyroCheck::check_unit(const GyroSample& sample, const GyroOptions& options) {
  // Some wrong samples are no wrong unit.
  constexpr std::size_t kFewest = 10;
  constexpr TimeNs kWatchedNs = 5'000'000'000;
  const double limit_rad_s = std::max(kFullScaleRadS, 1.01 * options.range_rad_s);
  const double rate_rad_s = sample.rate_rad_s.cwiseAbs().maxCoeff();
  if (rate_rad_s > limit_rad_s) beyond_.push_back({sample.t_ns, rate_rad_s});
  while (!beyond_.empty() && std::abs(sample.t_ns - beyond_.front().t_ns) > kWatchedNs) beyond_.pop_front();
  if (!is_beyond_ && beyond_.size() >= kFewest) {
    is_beyond_ = true;
    const auto most = std::max_element(beyond_.begin(), beyond_.end(),
                                       [](const Beyond& a, const Beyond& b) { return a.rate_rad_s < b.rate_rad_s; });
    problems_.report(
        kUnit, format("the IMU reports rates of up to %.3g \"rad/s\", beyond %s = %.3g rad/s: are they in degrees/s? "
                      "sensor_msgs/Imu has rad/s",
                      most->rate_rad_s,
                      limit_rad_s > kFullScaleRadS ? "gyro_range" : "2000 degrees/s, the range of consumer gyroscopes,",
                      limit_rad_s / 1.01));
  } else if (is_beyond_ && beyond_.empty()) {
    is_beyond_ = false;
    problems_.resolve(kUnit);
  }
}

}  // namespace gyro_deblur
