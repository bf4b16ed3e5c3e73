// The threads behind parallel_for().
#include "base/parallel.hpp"

#include <pthread.h>
#include <sched.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>

#include "base/time_slice.hpp"

namespace gyro_deblur {
namespace {

using Clock = std::chrono::steady_clock;  // its time is read without a system call, see serial_until_worthwhile

// Least work for each helper. Under contention a helper that loses its core in the middle of a piece keeps the loop
// waiting, and every system call is a chance for the kernel to give this thread's core away
// (doc/reports/contention.md).
constexpr std::chrono::nanoseconds kMinWorkPerHelper{2'000'000};

#ifdef GYRO_DEBLUR_TSAN
std::atomic<int> eager_helpers{1};
#else
std::atomic<int> eager_helpers{0};
#endif

/// A loop that is being run. Lives on the stack of the thread that runs it, which returns last.
class Loop {
 public:
  Loop(int count, int chunk, const LoopPart& part) : count_(count), chunk_(chunk), part_(part) {}

  /// Does one chunk. @return false when none is left
  bool step(int thread) {
    const std::int64_t begin = next_.fetch_add(chunk_, std::memory_order_relaxed);
    if (begin >= count_) return false;
    try {
      part_(static_cast<int>(begin), static_cast<int>(std::min<std::int64_t>(begin + chunk_, count_)), thread);
    } catch (...) {
      next_ = count_;  // the rest is skipped
      const std::lock_guard<std::mutex> lock(failure_mutex_);
      if (!failure_) failure_ = std::current_exception();
    }
    return true;
  }

  /// Iterations that have begun.
  int begun() const { return static_cast<int>(std::min<std::int64_t>(next_.load(std::memory_order_relaxed), count_)); }
  int count() const { return count_; }

  void rethrow() {
    if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
  }

  // Counts of helpers, under their lock.
  int wanted = 0, joined = 0, at_work = 0;
  std::condition_variable all_left;

 private:
  const int count_, chunk_;
  const LoopPart& part_;
  std::atomic<std::int64_t> next_{0};  // 64 bit: goes on past count_
  std::mutex failure_mutex_;
  std::exception_ptr failure_;
};

/// The threads that help, for all loops of the process. They are never ended: the library stays loaded (see
/// src/CMakeLists.txt), and a process that exits need not wait for them.
class Helpers {
 public:
  static Helpers& instance() {
    static Helpers* const helpers = new Helpers;
    return *helpers;
  }

  /// From now on up to `count` threads join the loop.
  void call(Loop& loop, int count) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      loop.wanted = count;
      loops_.push_back(&loop);
      while (threads_ < count && start_thread()) ++threads_;
    }
    for (int i = 0; i < count; ++i) called_.notify_one();
  }

  /// Returns when nobody has to do with the loop any more, nor will have.
  void dismiss(Loop& loop) {
    std::unique_lock<std::mutex> lock(mutex_);
    close(loop);
    loop.all_left.wait(lock, [&loop] { return loop.at_work == 0; });
  }

 private:
  bool start_thread() {
    try {
      std::thread([this] { help(); }).detach();
      return true;
    } catch (const std::system_error&) {
      return false;  // those who are there do it all
    }
  }

  void help() {
    pthread_setname_np(pthread_self(), "gyro_deblur");
    ask_for_time_slice_of_a_frame();
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      Loop* loop = nullptr;
      called_.wait(lock, [this, &loop] { return (loop = open_loop()) != nullptr; });
      const int thread = ++loop->joined;  // 0 is the one that runs the loop
      ++loop->at_work;
      lock.unlock();
      while (loop->step(thread)) {
      }
      lock.lock();
      close(*loop);
      if (--loop->at_work == 0) loop->all_left.notify_one();
    }
  }

  Loop* open_loop() const {
    const auto found =
        std::find_if(loops_.begin(), loops_.end(), [](const Loop* loop) { return loop->joined < loop->wanted; });
    return found == loops_.end() ? nullptr : *found;
  }

  /// Nobody else joins.
  void close(Loop& loop) { loops_.erase(std::remove(loops_.begin(), loops_.end(), &loop), loops_.end()); }

  std::mutex mutex_;
  std::condition_variable called_;
  std::deque<Loop*> loops_;
  int threads_ = 0;
};

/// Works alone until it is known whether the rest is worth help. Makes no system call.
/// @return how many of `most` helpers it is worth; 0: it is done
int serial_until_worthwhile(Loop& loop, int most) {
  if (eager_helpers > 0) return most;
  auto before = Clock::now();
  std::chrono::nanoseconds elapsed{0}, longest{0};
  for (int steps = 1; loop.step(0); ++steps) {
    const auto now = Clock::now();
    elapsed += now - before;
    longest = std::max(longest, now - before);
    before = now;
    // The longest step may have been interrupted: it is no measure.
    constexpr int kStepsThatTell = 3;
    if (steps < kStepsThatTell) continue;
    const int begun = loop.begun();
    const double step_ns = static_cast<double>((elapsed - longest).count()) / (steps - 1);
    const double rest_ns = step_ns * steps * (loop.count() - begun) / begun;
    const double helpers = rest_ns / static_cast<double>(kMinWorkPerHelper.count());
    if (helpers >= 1) return static_cast<int>(std::min<double>(helpers, most));
  }
  return 0;
}

}  // namespace

int available_cores() {
  cpu_set_t cores;
  if (sched_getaffinity(0, sizeof(cores), &cores) == 0) return std::max(1, CPU_COUNT(&cores));
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));  // more cores than the set holds
}

void parallel_for_ranges(int count, int threads, int chunk, const LoopPart& part) {
  if (count <= 0) return;
  const int chunks = (count - 1) / chunk + 1, most = std::min(threads_or_all(threads), chunks);
  if (most == 1) return part(0, count, 0);
  Loop loop(count, chunk, part);
  const int helpers = serial_until_worthwhile(loop, most - 1);
  if (helpers > 0) {
    Helpers::instance().call(loop, helpers);
    while (loop.step(0)) {
    }
    Helpers::instance().dismiss(loop);
  }
  loop.rethrow();
}

EagerHelpers::EagerHelpers() { ++eager_helpers; }
EagerHelpers::~EagerHelpers() { --eager_helpers; }

}  // namespace gyro_deblur
