#include "busy_processes.hpp"

#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstddef>
#include <system_error>

namespace gyro_deblur::test {

std::vector<int> cores_to_run_on() {
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof(set), &set) != 0) throw std::system_error(errno, std::generic_category(), "affinity");
  std::vector<int> cores;
  for (int core = 0; core < CPU_SETSIZE && cores.size() < kMaxCores; ++core) {
    if (CPU_ISSET(core, &set)) cores.push_back(core);
  }
  return cores;
}

void WorkUnit::run() {
  constexpr int kPasses = 8;
  for (int pass = 0; pass < kPasses; ++pass) {
    for (std::size_t i = 1; i < image_.size(); ++i) image_[i] = 0.5f * (image_[i] + image_[i - 1]);
  }
  sink_ = image_.back();
}

SharedCounts* make_shared_counts() {
  void* memory = mmap(nullptr, sizeof(SharedCounts), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) throw std::system_error(errno, std::generic_category(), "shared memory");
  auto* counts = new (memory) SharedCounts;
  for (sem_t& frames : counts->frames) sem_init(&frames, 1, 0);
  return counts;
}

template <typename Work>
void NeighbourProcesses::start(const Work& work) {
  const pid_t parent = getpid(), process = fork();
  if (process < 0) throw std::system_error(errno, std::generic_category(), "fork");
  if (process > 0) {
    processes_.push_back(process);
    return;
  }
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() == parent) work();  // else it has ended already
  _exit(0);
}

void NeighbourProcesses::start_busy(SharedCounts* counts) {
  const std::vector<int> cores = cores_to_run_on();
  WorkUnit unit;  // before fork: a child of a parent with threads must not allocate
  for (std::size_t i = 0; i < cores.size(); ++i) {
    counts->units[i] = 0;
    start([&] {
      cpu_set_t set;
      CPU_ZERO(&set);
      CPU_SET(cores[i], &set);
      sched_setaffinity(0, sizeof(set), &set);
      while (true) {
        unit.run();
        ++counts->units[i];
      }
    });
  }
}

void NeighbourProcesses::start_consumers(SharedCounts* counts, int units) {
  const std::size_t consumers = cores_to_run_on().size();
  WorkUnit unit;
  for (std::size_t i = 0; i < consumers; ++i) {
    counts->consumed[i] = 0;
    while (sem_trywait(&counts->frames[i]) == 0) {
    }
    start([&] {
      while (true) {
        while (sem_wait(&counts->frames[i]) != 0) {
        }
        const auto begin = std::chrono::steady_clock::now();
        for (int k = 0; k < units; ++k) unit.run();
        const std::chrono::duration<float, std::milli> took = std::chrono::steady_clock::now() - begin;
        const int frame = counts->consumed[i];
        if (frame < kMaxFrames) counts->consumer_ms[i][frame] = took.count();
        ++counts->consumed[i];
      }
    });
  }
}

std::vector<double> NeighbourProcesses::end() {
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  std::vector<double> times_s;
  for (const pid_t process : processes_) kill(process, SIGKILL);
  for (const pid_t process : processes_) {
    rusage usage{};
    while (wait4(process, nullptr, 0, &usage) < 0 && errno == EINTR) {
    }
    times_s.push_back(seconds(usage.ru_utime) + seconds(usage.ru_stime));
  }
  processes_.clear();
  return times_s;
}

}  // namespace gyro_deblur::test
