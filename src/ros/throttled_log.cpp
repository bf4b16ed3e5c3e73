#include "ros/throttled_log.hpp"

namespace gyro_deblur {
namespace {

constexpr std::chrono::seconds kLogPeriod{5};

}  // namespace

void ThrottledLog::operator()(LogLevel level, const std::string& kind, const std::string& text) {
  std::string more;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto now = std::chrono::steady_clock::now();
    const auto found = throttles_.find(kind);
    if (found != throttles_.end() && now - found->second.last < kLogPeriod) {
      ++found->second.suppressed;
      return;
    }
    Throttle& throttle = throttles_[kind];
    if (throttle.suppressed > 0) more = " (and " + std::to_string(throttle.suppressed) + " more of the kind)";
    throttle = {now, 0};
  }
  log_(level, text + more);
}

void ThrottledLog::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  throttles_.clear();
}

}  // namespace gyro_deblur
