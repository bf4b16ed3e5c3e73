// Problems of inputs that a user has to act on.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <string>

#include "ros/throttled_log.hpp"

namespace gyro_deblur {

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
  /// @param log  gets the first report of each kind at once, later ones throttled
  explicit InputProblems(ThrottledLog* log) : log_(*log) {}

  /// @param kind  equal for reports of the same problem, e.g. "camera_info stamp"
  void report(const std::string& kind, const std::string& text, LogLevel level = LogLevel::WARNING);
  /// The problem is gone: the diagnostics leave it out from now on.
  void resolve(const std::string& kind);
  void clear();

  /// All problems since the start, by kind.
  std::map<std::string, InputProblem> all() const;

 private:
  ThrottledLog& log_;
  mutable std::mutex mutex_;
  std::map<std::string, InputProblem> problems_;
};

}  // namespace gyro_deblur
