// Stores gyroscope samples in order and estimates their bias at rest.
#include "gyro_deblur/gyro_buffer.hpp"

#include <algorithm>
#include <iterator>
#include <stdexcept>

#include "base/format.hpp"

namespace gyro_deblur {

GyroBuffer::GyroBuffer(TimeNs capacity_ns) : capacity_ns_(capacity_ns) {
  if (capacity_ns <= 0) {
    throw std::invalid_argument("GyroBuffer: capacity_ns = " + std::to_string(capacity_ns) + " must be positive");
  }
}

bool GyroBuffer::add(const GyroSample& sample) {
  if (!sample.rate_rad_s.allFinite() || (!empty() && sample.t_ns <= samples_.back().t_ns)) return false;
  samples_.push_back(sample);
  while (sample.t_ns - samples_.front().t_ns > capacity_ns_) samples_.pop_front();
  return true;
}

GyroSample GyroBuffer::drop_newest() {
  const GyroSample newest = samples_.back();
  samples_.pop_back();
  return newest;
}

TimeRange GyroBuffer::available() const {
  if (samples_.empty()) return {};
  return {samples_.front().t_ns, samples_.back().t_ns};
}

std::vector<GyroSample> GyroBuffer::window(const TimeRange& requested) const {
  if (requested.empty()) return {};
  auto first = std::lower_bound(samples_.begin(), samples_.end(), requested.begin_ns,
                                [](const GyroSample& sample, TimeNs t_ns) { return sample.t_ns < t_ns; });
  auto last = std::upper_bound(first, samples_.end(), requested.end_ns,
                               [](TimeNs t_ns, const GyroSample& sample) { return t_ns < sample.t_ns; });
  if (first != samples_.begin()) --first;
  if (last != samples_.end()) ++last;
  return {first, last};
}

std::optional<BiasEstimate> estimate_stationary_bias(const std::vector<GyroSample>& samples, double max_stddev_rad_s,
                                                     std::size_t min_samples, std::string* error) {
  const std::size_t needed = std::max<std::size_t>(min_samples, 2);
  if (samples.size() < needed) {
    *error = format("gyro bias: %zu samples, at least %zu are needed", samples.size(), needed);
    return std::nullopt;
  }
  BiasEstimate estimate;
  estimate.samples = samples.size();
  const double n = static_cast<double>(samples.size());
  for (const GyroSample& sample : samples) estimate.bias_rad_s += sample.rate_rad_s / n;
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();
  for (const GyroSample& sample : samples) {
    variance += (sample.rate_rad_s - estimate.bias_rad_s).cwiseAbs2() / (n - 1);
  }
  estimate.stddev_rad_s = variance.cwiseSqrt();
  for (int axis = 0; axis < 3; ++axis) {
    if (estimate.stddev_rad_s[axis] < max_stddev_rad_s) continue;  // not so for NaN
    *error =
        format("gyro bias: the sensor moves: standard deviation %g rad/s about axis %c, less than %g rad/s is needed",
               estimate.stddev_rad_s[axis], "xyz"[axis], max_stddev_rad_s);
    return std::nullopt;
  }
  return estimate;
}

}  // namespace gyro_deblur
