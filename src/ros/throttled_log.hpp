// Log lines, each kind at most once in a while.
#pragma once

#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <utility>

#include "ros/steady_clock.hpp"

namespace gyro_deblur {

enum class LogLevel { INFO, WARNING, ERROR };

using Log = std::function<void(LogLevel, const std::string&)>;

/// Passes lines on to a log; the next line of a kind within 5 s of the one before is only counted. Thread-safe.
class ThrottledLog {
 public:
  /// @param steady_clock  absent: steady_now_ns
  explicit ThrottledLog(Log log, std::function<TimeNs()> steady_clock = nullptr)
      : log_(std::move(log)), steady_clock_(steady_clock ? std::move(steady_clock) : steady_now_ns) {}

  void operator()(LogLevel level, const std::string& kind, const std::string& text);

  /// The next line of every kind passes.
  void clear();

 private:
  struct Throttle {
    TimeNs last_ns = 0;
    std::size_t suppressed = 0;
  };
  const Log log_;
  const std::function<TimeNs()> steady_clock_;
  std::mutex mutex_;
  std::map<std::string, Throttle> throttles_;
};

}  // namespace gyro_deblur
