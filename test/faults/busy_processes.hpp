// Processes other than the measured one: some that are always busy, and a consumer of frames like SLAM.
#pragma once

#include <semaphore.h>
#include <sys/types.h>

#include <atomic>
#include <cstdint>
#include <vector>

namespace gyro_deblur::test {

constexpr int kMaxCores = 256;
constexpr int kMaxFrames = 20'000;

/// Cores that this process may run on, at most kMaxCores.
std::vector<int> cores_to_run_on();

/// Work that is always the same, about 0.1 ms of one core: passes over an image of 64 kB in the caches.
class WorkUnit {
 public:
  void run();

 private:
  std::vector<float> image_ = std::vector<float>(16'384, 1);
  volatile float sink_ = 0;
};

/// What the processes exchange, in memory that all of them share.
struct SharedCounts {
  std::atomic<std::uint64_t> units[kMaxCores];  ///< done by each busy process
  sem_t frames[kMaxCores];                      ///< posted for each consumer when a frame has come
  std::atomic<int> consumed[kMaxCores];         ///< frames by each consumer
  float consumer_ms[kMaxCores][kMaxFrames];     ///< how long its work on a frame took
};

/// Memory that processes forked from now on share. Throws std::system_error.
SharedCounts* make_shared_counts();

/// Child processes that end with this object, or with their parent. A child does nothing but what it is made for, so
/// that the parent may have threads.
class NeighbourProcesses {
 public:
  NeighbourProcesses() = default;
  ~NeighbourProcesses() { end(); }
  NeighbourProcesses(const NeighbourProcesses&) = delete;
  NeighbourProcesses& operator=(const NeighbourProcesses&) = delete;

  /// One process on every core, bound to it, that is always busy and counts in `counts`.
  void start_busy(SharedCounts* counts);

  /// One process for every core, bound to none, that does `units` of work on every frame.
  void start_consumers(SharedCounts* counts, int units);

  /// @return processor time [s] of each
  std::vector<double> end();

 private:
  template <typename Work>
  void start(const Work& work);
  std::vector<pid_t> processes_;
};

}  // namespace gyro_deblur::test
