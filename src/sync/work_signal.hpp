// Wakes a thread that waits for work.
#pragma once

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <utility>

namespace gyro_deblur {

/// Any thread calls notify() and stop(), also with locks held: the signal takes no other one. One thread waits.
class WorkSignal {
 public:
  /// Ends wait(), or the next one if none is in progress.
  void notify() {
    const std::lock_guard<std::mutex> lock(mutex_);
    has_news_ = true;
    changed_.notify_one();
  }
  /// Ends the next wait() at this time at the latest.
  void notify_at(std::chrono::steady_clock::time_point due) {
    const std::lock_guard<std::mutex> lock(mutex_);
    due_ = due;
  }
  /// Ends wait() for good.
  void stop() {
    const std::lock_guard<std::mutex> lock(mutex_);
    stopped_ = true;
    changed_.notify_one();
  }
  bool stopped() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return stopped_;
  }
  /// @param at_most  absent: as long as it takes
  /// @return false after stop()
  bool wait(std::optional<std::chrono::nanoseconds> at_most) {
    std::unique_lock<std::mutex> lock(mutex_);
    const auto ends = [this] { return has_news_ || stopped_; };
    auto until = std::exchange(due_, std::nullopt);
    if (at_most) {
      const auto latest = std::chrono::steady_clock::now() + *at_most;
      until = until ? std::min(*until, latest) : latest;
    }
    until ? void(changed_.wait_until(lock, *until, ends)) : changed_.wait(lock, ends);
    has_news_ = false;
    return !stopped_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool has_news_ = false;  // since wait() returned
  bool stopped_ = false;
  std::optional<std::chrono::steady_clock::time_point> due_;
};

}  // namespace gyro_deblur
