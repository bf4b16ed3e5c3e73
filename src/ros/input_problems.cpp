// Logs problems of inputs and keeps them for the diagnostics.
#include "ros/input_problems.hpp"

namespace gyro_deblur {

void InputProblems::report(const std::string& kind, const std::string& text, LogLevel level) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    InputProblem& problem = problems_[kind];
    problem.level = level;
    problem.text = text;
    problem.active = true;
    ++problem.count;
  }
  log_(level, kind, text);
}

void InputProblems::resolve(const std::string& kind) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto found = problems_.find(kind);
  if (found != problems_.end()) found->second.active = false;
}

void InputProblems::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  problems_.clear();
}

std::map<std::string, InputProblem> InputProblems::all() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return problems_;
}

}  // namespace gyro_deblur
