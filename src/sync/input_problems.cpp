// Logs lines, each kind at most once in a while, and keeps problems of inputs for the diagnostics.
#include "sync/input_problems.hpp"

namespace gyro_deblur {
namespace {

constexpr TimeNs kLogPeriodNs = 5'000'000'000;

}  // namespace

void InputProblems::log(LogLevel level, const std::string& kind, const std::string& text) {
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

void InputProblems::report(const std::string& kind, const std::string& text, LogLevel level) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    keep(kind, text, level);
  }
  log(level, kind, text);
}

void InputProblems::keep(const std::string& kind, const std::string& text, LogLevel level) {
  InputProblem& problem = problems_[kind];
  problem = {level, text, problem.count + 1, true};
}

void InputProblems::update(const std::string& kind, const std::string& text) {
  if (text.empty()) return resolve(kind);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = problems_.find(kind);
    if (found != problems_.end() && found->second.active) {
      found->second.text = text;
      return;
    }
    keep(kind, text, LogLevel::WARNING);
  }
  log(LogLevel::WARNING, kind, text);
}

void InputProblems::resolve(const std::string& kind) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto found = problems_.find(kind);
  if (found != problems_.end()) found->second.active = false;
}

bool InputProblems::is_active(const std::string& kind) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto found = problems_.find(kind);
  return found != problems_.end() && found->second.active;
}

void InputProblems::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  throttles_.clear();
  problems_.clear();
}

std::map<std::string, InputProblem> InputProblems::all() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return problems_;
}

}  // namespace gyro_deblur
