// Log lines, each kind at most once in a while.
#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <utility>

namespace gyro_deblur {

enum class LogLevel { INFO, WARNING, ERROR };

using Log = std::function<void(LogLevel, const std::string&)>;

/// Passes lines on to a log; the next line of a kind within 5 s of the one before is only counted. Thread-safe.
class ThrottledLog {
 public:
  explicit ThrottledLog(Log log) : log_(std::move(log)) {}

  void operator()(LogLevel level, const std::string& kind, const std::string& text);

  /// The next line of every kind passes.
  void clear();

 private:
  struct Throttle {
    std::chrono::steady_clock::time_point last;
    std::size_t suppressed = 0;
  };
  const Log log_;
  std::mutex mutex_;
  std::map<std::string, Throttle> throttles_;
};

}  // namespace gyro_deblur
