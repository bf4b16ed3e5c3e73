// Stores gyroscope samples in order and estimates their bias at rest.
#include "gyro_deblur/gyro_buffer.hpp"

#include <algorithm>
#include <iterator>
#include <sstream>
#include <stdexcept>

namespace gyro_deblur {

GyroBuffer::GyroBuffer(TimeNs capacity_ns) : capacity_ns_(capacity_ns) {
  if (capacity_ns <= 0) {
    throw std::invalid_argument("GyroBuffer: capacity_ns = " + std::to_string(capacity_ns) + " must be positive");
  }
}

GyroBuffer::AddResult GyroBuffer::add(const GyroSample& sample) {
  if (!sample.rate_rad_s.allFinite()) return AddResult::NOT_FINITE;
  if (!samples_.empty()) {
    if (sample.t_ns == samples_.back().t_ns) return AddResult::DUPLICATE;
    if (sample.t_ns < samples_.back().t_ns) return AddResult::OUT_OF_ORDER;
  }
  samples_.push_back(sample);
  while (sample.t_ns - samples_.front().t_ns > capacity_ns_) samples_.pop_front();
  return AddResult::ACCEPTED;
}

GyroSample GyroBuffer::drop_newest() {
  const GyroSample newest = samples_.back();
  samples_.pop_back();
  return newest;
}

void GyroBuffer::clear() { samples_.clear(); }

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

const char* to_string(GyroBuffer::AddResult result) {
  switch (result) {
    case GyroBuffer::AddResult::ACCEPTED:
      return "ACCEPTED";
    case GyroBuffer::AddResult::NOT_FINITE:
      return "NOT_FINITE";
    case GyroBuffer::AddResult::DUPLICATE:
      return "DUPLICATE";
    case GyroBuffer::AddResult::OUT_OF_ORDER:
      return "OUT_OF_ORDER";
  }
  return "UNKNOWN";
}

std::optional<BiasEstimate> estimate_stationary_bias(const std::vector<GyroSample>& samples, double max_stddev_rad_s,
                                                     std::size_t min_samples, std::string* error) {
  std::ostringstream message;
  if (samples.size() < std::max<std::size_t>(min_samples, 2)) {
    message << "gyro bias: " << samples.size() << " samples, at least " << std::max<std::size_t>(min_samples, 2)
            << " are needed";
    *error = message.str();
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
    message << "gyro bias: the sensor moves: standard deviation " << estimate.stddev_rad_s[axis] << " rad/s about axis "
            << "xyz"[axis] << ", less than " << max_stddev_rad_s << " rad/s is needed";
    *error = message.str();
    return std::nullopt;
  }
  return estimate;
}

}  // namespace gyro_deblur
