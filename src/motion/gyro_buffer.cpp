// Stores gyroscope samples in order.
#include "gyro_deblur/gyro_buffer.hpp"

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <string>

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

}  // namespace gyro_deblur
