// Exceptions and OpenMP: one that leaves a parallel region ends the process, so it is carried out by hand.
#pragma once

#include <exception>
#include <mutex>
#include <utility>

#include <omp.h>

namespace gyro_deblur {

/// Keeps the first exception of a parallel region until the region has ended:
///
///     FirstException failure;
///     #pragma omp parallel for
///     for (int i = 0; i < count; ++i) failure.guard([&] { work(i); });
///     failure.rethrow();
///
/// After a failure the remaining iterations are skipped. Any thread may call guard(); it must not enclose a
/// work-sharing construct, which every thread of the team has to reach.
class FirstException {
 public:
  template <typename Function>
  void guard(Function&& function) noexcept {
    if (failed()) return;
    try {
      std::forward<Function>(function)();
    } catch (...) {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (!first_) first_ = std::current_exception();
#pragma omp atomic write
      failed_ = 1;
    }
  }

  /// After the region: throws what was kept, if anything.
  void rethrow() {
    if (first_) std::rethrow_exception(std::exchange(first_, nullptr));
  }

 private:
  bool failed() const {
    int failed = 0;
#pragma omp atomic read
    failed = failed_;
    return failed != 0;
  }

  std::mutex mutex_;
  std::exception_ptr first_;
  int failed_ = 0;  // apart from first_, so that looking needs no lock
};

/// Calls body(i) for 0 <= i < count on `threads` OpenMP threads (0: OpenMP's default), `chunk` iterations at a time, in
/// any order. The first exception of `body` is thrown again when all threads have ended.
template <typename Body>
void run_parallel(int count, int threads, int chunk, Body&& body) {
  FirstException failure;
#pragma omp parallel for num_threads(threads > 0 ? threads : omp_get_max_threads()) schedule(dynamic, chunk)
  for (int i = 0; i < count; ++i) failure.guard([&] { body(i); });
  failure.rethrow();
}

}  // namespace gyro_deblur
