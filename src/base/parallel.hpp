// Loops on several threads that sleep between two frames.
//
// Not OpenMP: its threads spin between frames, a loop ends only when each of them had a core, and a library cannot
// change that for its process (doc/reports/contention.md).
#pragma once

#include <functional>
#include <type_traits>

// ThreadSanitizer is there to see threads: loops call for help at once then, however short they are.
#if defined(__SANITIZE_THREAD__)
#define GYRO_DEBLUR_TSAN
#elif defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define GYRO_DEBLUR_TSAN
#endif
#endif

namespace gyro_deblur {

/// Cores that the calling thread may run on, >= 1: those of its affinity (taskset, cpusets of containers).
int available_cores();

/// A number of threads as parameters give it: 0 means available_cores().
inline int threads_or_all(int threads) { return threads > 0 ? threads : available_cores(); }

/// What a loop does with the iterations begin <= i < end. `thread` is less than the loop's number of threads, and no
/// two that work at the same time have the same.
using LoopPart = std::function<void(int begin, int end, int thread)>;

/// Calls part() for all of [0, count), `chunk` iterations at a time, in any order, on at most `threads` threads (>= 0;
/// 0: available_cores()). The calling thread is one of them. Helpers that are awake (see AwakeHelpers) join at once.
/// Others are called when there is more left than waking them costs, and one that comes late finds nothing left to do
/// and holds nobody up. The first exception is thrown again when all threads have left; what had not begun then is
/// skipped. May be called from several threads at once, and from within a loop.
void parallel_for_ranges(int count, int threads, int chunk, const LoopPart& part);

/// The same, with body(i) or body(i, thread) for every iteration.
template <typename Body>
void parallel_for(int count, int threads, int chunk, Body&& body) {
  parallel_for_ranges(count, threads, chunk, [&body](int begin, int end, int thread) {
    for (int i = begin; i < end; ++i) {
      if constexpr (std::is_invocable_v<Body&, int, int>) {
        body(i, thread);
      } else {
        (void)thread;
        body(i);
      }
    }
  });
}

/// For the time in which a thread processes a frame: up to three helpers of the process stay on their cores and join
/// loops within a microsecond, for waking a helper for each loop would take longer than a short loop. At most as many
/// are awake as there are cores besides those of the threads that process frames. A helper sleeps when no loop has come
/// for two milliseconds.
class AwakeHelpers {
 public:
  /// @param threads  of the loops, as parallel_for() takes it: one thread less is woken
  explicit AwakeHelpers(int threads);
  ~AwakeHelpers();
  AwakeHelpers(const AwakeHelpers&) = delete;
  AwakeHelpers& operator=(const AwakeHelpers&) = delete;

 private:
  bool wakes_ = false;
};

/// While one lives, loops call for help at once, however short they are: for tests of what threads do to each other.
class EagerHelpers {
 public:
  EagerHelpers();
  ~EagerHelpers();
  EagerHelpers(const EagerHelpers&) = delete;
  EagerHelpers& operator=(const EagerHelpers&) = delete;
};

}  // namespace gyro_deblur
