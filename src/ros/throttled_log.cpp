// Writes log lines, each kind at most once in a while.
#include "ros/throttled_log.hpp"

namespace gyro_deblur {
namespace {

constexpr TimeNs kLogPeriodNs = 5'000'000'000;

}  // namespace

void ThrottledLog::operator()(LogLevel level, const std::string& kind, const std::string& text) {
  std::string more;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const TimeNs now_ns = steady_clock_();
    const auto found = throttles_.find(kind);
    if (found != throttles_.end() && now_ns - found->second.last_ns < kLogPeriodNs) {
      ++found->second.suppressed;
      return;
    }
    Throttle& throttle = throttles_[kind];
    if (throttle.suppressed > 0) more = " (and " + std::to_string(throttle.suppressed) + " more of the kind)";
    throttle = {now_ns, 0};
  }
  log_(level, text + more);
}

void ThrottledLog::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  throttles_.clear();
}

}  // namespace gyro_deblur
