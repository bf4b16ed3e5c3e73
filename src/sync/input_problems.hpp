// The log, and problems of inputs that a user has to act on.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <utility>

#include "base/stopwatch.hpp"

namespace gyro_deblur {

enum class LogLevel { INFO, WARNING, ERROR };

using Log = std::function<void(LogLevel, const std::string&)>;

/// One problem: what happened, the value, what is allowed, what to do.
struct InputProblem {
  LogLevel level = LogLevel::WARNING;
  std::string text;       ///< of the newest report
  std::size_t count = 0;  ///< reports since the start
  bool active = false;    ///< not resolved since its newest report
};

/// The log, the diagnostics and the tools' closing lines all take their text from here, so that they agree.
/// Thread-safe.
class InputProblems {
 public:
  /// @param steady_clock  absent: steady_now_ns
  explicit InputProblems(Log log, std::function<TimeNs()> steady_clock = nullptr)
      : log_(std::move(log)), steady_clock_(steady_clock ? std::move(steady_clock) : steady_now_ns) {}

  /// A line of its own.
  void log(LogLevel level, const std::string& text) const { log_(level, text); }
  /// A line that may recur: the next of its kind within 5 s of the one before is only counted.
  void log(LogLevel level, const std::string& kind, const std::string& text);

  /// Keeps a problem, and logs it as a line that may recur.
  /// @param kind  equal for reports of the same problem, e.g. "camera_info stamp"
  void report(const std::string& kind, const std::string& text, LogLevel level = LogLevel::WARNING);
  /// The same for a problem that lasts: it is logged when it begins.
  /// @param text  kept, the newest; empty: it is gone
  void update(const std::string& kind, const std::string& text);
  /// The problem is gone: the diagnostics leave it out from now on.
  void resolve(const std::string& kind);
  bool is_active(const std::string& kind) const;
  /// Forgets all problems. The next line of every kind is logged.
  void clear();

  /// All problems since the start, by kind.
  std::map<std::string, InputProblem> all() const;

 private:
  struct Throttle {
    TimeNs last_ns = 0;
    std::size_t suppressed = 0;
  };
  /// Needs mutex_.
  void keep(const std::string& kind, const std::string& text, LogLevel level);

  const Log log_;
  const std::function<TimeNs()> steady_clock_;
  mutable std::mutex mutex_;  // the next members
  std::map<std::string, Throttle> throttles_;
  std::map<std::string, InputProblem> problems_;
};

}  // namespace gyro_deblur
