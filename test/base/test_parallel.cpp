#include "base/parallel.hpp"

#include <pthread.h>
#include <sched.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <new>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::parallel_test {
namespace {

constexpr int kThreads = 4;

double seconds_of(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Keeps one core at work for so much of its time.
void work_for(double seconds) {
  const double end_s = seconds_of(CLOCK_THREAD_CPUTIME_ID) + seconds;
  while (seconds_of(CLOCK_THREAD_CPUTIME_ID) < end_s) {
  }
}

std::ptrdiff_t threads_of_process() {
  namespace fs = std::filesystem;
  return std::distance(fs::begin(fs::directory_iterator("/proc/self/task")), fs::directory_iterator());
}

TEST(RunParallel, CallsEveryIndexOnce) {
  std::vector<int> calls(1000, 0);
  parallel_for(1000, kThreads, 7, [&](int i) { ++calls[static_cast<std::size_t>(i)]; });
  EXPECT_EQ(calls, std::vector<int>(1000, 1));
  parallel_for(0, kThreads, 1, [](int) { FAIL(); });
  const EagerHelpers eager_helpers;
  parallel_for(1000, kThreads, 7, [&](int i) { ++calls[static_cast<std::size_t>(i)]; });
  EXPECT_EQ(calls, std::vector<int>(1000, 2));
}

TEST(RunParallel, ThrowsWhatABodyThrewInsteadOfEndingTheProcess) {
  EXPECT_THROW(parallel_for(100, kThreads, 1,
                            [](int i) {
                              if (i == 50) throw std::bad_alloc();
                            }),
               std::bad_alloc);
  EXPECT_THROW(parallel_for(100, 0, 1, [](int) { throw std::runtime_error("every one"); }), std::runtime_error);
  const EagerHelpers eager_helpers;
  EXPECT_THROW(parallel_for(100, kThreads, 1, [](int) { throw std::runtime_error("every one"); }), std::runtime_error);
}

TEST(RunParallel, SkipsWhatIsLeftAfterAFailure) {
  for (const int threads : {1, kThreads}) {
    std::atomic<int> calls{0};
    const auto fail_at_once = [&](int) {
      ++calls;
      throw std::invalid_argument("first");
    };
    EXPECT_THROW(parallel_for(1000, threads, 1, fail_at_once), std::invalid_argument);
    EXPECT_LE(calls, threads);
    parallel_for(10, threads, 1, [&](int) { ++calls; });  // and the next loop is whole
    EXPECT_GE(calls, 11);
  }
}

TEST(RunParallel, GivesThreadsThatWorkAtTheSameTimeNumbersOfTheirOwn) {
  const EagerHelpers eager_helpers;
  std::vector<std::atomic<int>> at_work(kThreads);
  std::atomic<int> wrong{0};
  parallel_for(200, kThreads, 1, [&](int, int thread) {
    if (thread < 0 || thread >= kThreads || ++at_work[static_cast<std::size_t>(thread)] != 1) ++wrong;
    work_for(20e-6);
    --at_work[static_cast<std::size_t>(std::clamp(thread, 0, kThreads - 1))];
  });
  EXPECT_EQ(wrong, 0);
}

// The cause of frames that take twenty times as long next to a busy process, and of the time that is taken from it.
TEST(RunParallel, ThreadsSleepBetweenLoops) {
  constexpr int kLoops = 20, kAllCores = 0;
  constexpr double kWorkS = 250e-6;
  // Of each thread that has helped, from its first work on. Libraries have threads too, of which OpenBLAS' spin.
  struct Helped {
    clockid_t clock;
    double begin_s, worked_s;
  };
  std::map<std::thread::id, Helped> helpers;
  std::mutex mutex;
  for (int i = 0; i < kLoops; ++i) {
    parallel_for(40, kAllCores, 1, [&, caller = std::this_thread::get_id()](int) {
      const double begin_s = seconds_of(CLOCK_THREAD_CPUTIME_ID);
      work_for(kWorkS);
      const std::lock_guard<std::mutex> lock(mutex);
      if (std::this_thread::get_id() == caller) return;
      clockid_t clock{};
      ASSERT_EQ(pthread_getcpuclockid(pthread_self(), &clock), 0);
      helpers.insert({std::this_thread::get_id(), {clock, begin_s, 0}}).first->second.worked_s += kWorkS;
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(5));  // what a camera leaves between two frames
  }
  double idle_s = 0;
  for (const auto& [id, helped] : helpers) idle_s += seconds_of(helped.clock) - helped.begin_s - helped.worked_s;
  EXPECT_TRUE(available_cores() == 1 || !helpers.empty());
#ifdef GYRO_DEBLUR_TSAN
  GTEST_SKIP() << "ThreadSanitizer takes processor time itself";
#endif
  EXPECT_LT(idle_s / kLoops, 300e-6)
      << "processor time that the helping threads take in addition to their work, a loop";
}

TEST(RunParallel, SmallWorkStartsNoThread) {
  int grown = 0;
  constexpr int kTries = 20;  // a process that others keep from its core in mid-loop sees a long loop
  for (int i = 0; i < kTries; ++i) {
    const std::ptrdiff_t before = threads_of_process();
    // More threads than any loop before had.
    parallel_for(100, 2 * kThreads + i, 1, [](int) {});
    grown += threads_of_process() > before ? 1 : 0;
  }
#ifdef GYRO_DEBLUR_TSAN
  GTEST_SKIP() << "loops always call for help under ThreadSanitizer";
#endif
  EXPECT_LT(grown, kTries / 2);
}

TEST(RunParallel, DoesNotWaitForThreadsThatAreKeptElsewhere) {
  const EagerHelpers eager_helpers;
  std::mutex mutex;
  std::condition_variable changed;
  int inside = 0;
  bool released = false;
  // Two threads, this one's and a helper, that stay inside their loop.
  std::thread other([&] {
    parallel_for(2, 2, 1, [&](int) {
      std::unique_lock<std::mutex> lock(mutex);
      ++inside;
      changed.notify_all();
      changed.wait(lock, [&] { return released; });
    });
  });
  {
    std::unique_lock<std::mutex> lock(mutex);
    changed.wait(lock, [&] { return inside == 2; });
  }
  std::atomic<int> calls{0};
  parallel_for(1000, 2, 1, [&](int) { ++calls; });
  EXPECT_EQ(calls, 1000);
  {
    const std::lock_guard<std::mutex> lock(mutex);
    released = true;
  }
  changed.notify_all();
  other.join();
}

TEST(RunParallel, RunsWithinLoopsAndFromSeveralThreadsAtOnce) {
  const EagerHelpers eager_helpers;
  std::atomic<int> calls{0};
  std::vector<std::thread> cameras;
  for (int i = 0; i < kThreads; ++i) {
    cameras.emplace_back([&] {
      for (int frame = 0; frame < 50; ++frame) {
        parallel_for(10, kThreads, 1, [&](int) { parallel_for(10, 2, 1, [&](int) { ++calls; }); });
      }
    });
  }
  for (std::thread& camera : cameras) camera.join();
  EXPECT_EQ(calls, kThreads * 50 * 10 * 10);
}

// A loop is shorter than waking a helper for it is worth, and a helper that is awake joins all the same.
TEST(AwakeHelpers, JoinShortLoops) {
  constexpr int kTries = 50, kIterations = 16;
  constexpr double kWorkS = 20e-6;
  int shared = 0;
  for (int i = 0; i < kTries; ++i) {
    const AwakeHelpers helpers(2);
    std::atomic<int> of_helper{0};
    for (int loop = 0; loop < 4; ++loop) {
      parallel_for(kIterations, 2, 1, [&](int, int thread) {
        of_helper += thread;
        work_for(kWorkS);
      });
    }
    shared += of_helper > 0 ? 1 : 0;
  }
#ifdef GYRO_DEBLUR_TSAN
  GTEST_SKIP() << "loops always call for help under ThreadSanitizer";
#endif
  if (available_cores() == 1) GTEST_SKIP() << "one core";
  // Without, only a loop that is interrupted twice takes long enough for a helper to be called.
  EXPECT_GT(shared, kTries / 5) << "of " << kTries;
}

TEST(AwakeHelpers, CallEveryIndexOnceAndGiveThreadsNumbersOfTheirOwn) {
  constexpr int kCount = 300;
  std::vector<std::atomic<int>> calls(kCount), at_work(kThreads);
  std::atomic<int> wrong{0};
  const AwakeHelpers helpers(kThreads);
  for (int loop = 0; loop < 20; ++loop) {
    parallel_for(kCount, kThreads, 3, [&](int i, int thread) {
      ++calls[static_cast<std::size_t>(i)];
      if (thread < 0 || thread >= kThreads || ++at_work[static_cast<std::size_t>(thread)] != 1) ++wrong;
      work_for(1e-6);
      --at_work[static_cast<std::size_t>(std::clamp(thread, 0, kThreads - 1))];
    });
  }
  EXPECT_EQ(wrong, 0);
  for (const std::atomic<int>& count : calls) EXPECT_EQ(count, 20);
}

TEST(AwakeHelpers, PassOnWhatABodyThrew) {
  const AwakeHelpers helpers(kThreads);
  for (int loop = 0; loop < 100; ++loop) {
    std::atomic<int> calls{0};
    EXPECT_THROW(parallel_for(1000, kThreads, 1,
                              [&](int) {
                                ++calls;
                                throw std::runtime_error("every one");
                              }),
                 std::runtime_error);
    EXPECT_LE(calls, kThreads);
  }
}

TEST(AwakeHelpers, ServeLoopsWithinLoopsOfSeveralThreads) {
  std::atomic<int> calls{0};
  std::vector<std::thread> cameras;
  for (int i = 0; i < kThreads; ++i) {
    cameras.emplace_back([&] {
      for (int frame = 0; frame < 50; ++frame) {
        const AwakeHelpers helpers(kThreads);
        parallel_for(10, kThreads, 1, [&](int) { parallel_for(10, 2, 1, [&](int) { ++calls; }); });
      }
    });
  }
  for (std::thread& camera : cameras) camera.join();
  EXPECT_EQ(calls, kThreads * 50 * 10 * 10);
}

// A loop may end only when the helper in it has left.
TEST(AwakeHelpers, KeepTheLoopUntilTheyHaveLeft) {
  int joined = 0;
  for (int i = 0; i < 20; ++i) {
    const AwakeHelpers helpers(2);
    for (int loop = 0; loop < 8; ++loop) {
      std::atomic<int> inside{0}, of_helper{0};
      parallel_for(8, 2, 1, [&](int, int thread) {
        ++inside;
        of_helper += thread;
        work_for(thread == 0 ? 20e-6 : 1e-3);
        --inside;
      });
      EXPECT_EQ(inside, 0);
      joined += of_helper > 0 ? 1 : 0;
    }
  }
  EXPECT_TRUE(joined > 0 || available_cores() == 1);
}

TEST(AwakeHelpers, ServeSessionsOfDifferentSizes) {
  std::atomic<int> calls{0}, wrong{0};
  std::vector<std::thread> cameras;
  for (int threads = 1; threads <= kThreads; ++threads) {
    cameras.emplace_back([&, threads] {
      for (int frame = 0; frame < 100; ++frame) {
        const AwakeHelpers helpers(threads);
        parallel_for(40, threads, 1, [&](int, int thread) {
          ++calls;
          wrong += thread < 0 || thread >= threads ? 1 : 0;
        });
      }
    });
  }
  for (std::thread& camera : cameras) camera.join();
  EXPECT_EQ(calls, kThreads * 100 * 40);
  EXPECT_EQ(wrong, 0);
}

TEST(AwakeHelpers, LeaveTheCoresOfAForkedProcessAlone) {
  { const AwakeHelpers helpers(2); }
  cpu_set_t before;
  ASSERT_EQ(sched_getaffinity(0, sizeof(before), &before), 0);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    for (int i = 0; i < 3; ++i) {
      const AwakeHelpers helpers(2);
      parallel_for(4, 2, 1, [](int) {});
    }
    cpu_set_t after;
    _exit(sched_getaffinity(0, sizeof(after), &after) == 0 && CPU_EQUAL(&before, &after) ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

TEST(RunParallel, AForkedProcessRunsItsLoopsAlone) {
  const EagerHelpers eager;
  std::atomic<bool> stops{false};
  // Somebody has the lock of the helpers most of the time.
  std::thread busy([&stops] {
    while (!stops) parallel_for(2, 2, 1, [](int) {});
  });
  for (int i = 0; i < 20; ++i) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      alarm(10);  // ends it where it waits for ever
      int sum = 0;
      parallel_for(100, 2, 1, [&sum](int k) { sum += k; });
      _exit(sum == 4950 ? 0 : 1);
    }
    int status = -1;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_EQ(status, 0);
  }
  stops = true;
  busy.join();
}

TEST(AwakeHelpers, SleepAfterTheFrameAndWhereNoLoopComes) {
  constexpr int kFrames = 10;
  constexpr std::chrono::milliseconds kPause{30};
  const auto idle_s = [kPause](bool within) {
    double worked_s = 0;
    for (int i = 0; i < kFrames; ++i) {
      auto helpers = std::make_unique<AwakeHelpers>(kThreads);
      parallel_for(64, kThreads, 1, [](int) { work_for(5e-6); });
      if (!within) helpers.reset();
      const double begin_s = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
      std::this_thread::sleep_for(kPause);
      worked_s += seconds_of(CLOCK_PROCESS_CPUTIME_ID) - begin_s;
    }
    return worked_s / kFrames;
  };
  const double after_s = idle_s(false), within_s = idle_s(true);
#ifdef GYRO_DEBLUR_TSAN
  GTEST_SKIP() << "ThreadSanitizer takes processor time itself";
#endif
  EXPECT_LT(after_s, 1e-3) << "processor time between frames";
  // Three helpers that wait for two milliseconds.
  EXPECT_LT(within_s, 10e-3) << "processor time in a frame without loops";
}

TEST(AwakeHelpers, StayAsleepWhereThereIsNoOtherCore) {
  std::thread([] {
    cpu_set_t all, one;
    ASSERT_EQ(sched_getaffinity(0, sizeof(all), &all), 0);
    int core = 0;
    while (!CPU_ISSET(core, &all)) ++core;
    CPU_ZERO(&one);
    CPU_SET(core, &one);
    ASSERT_EQ(sched_setaffinity(0, sizeof(one), &one), 0);
    constexpr int kLoops = 20;
    int shared = 0;
    const AwakeHelpers helpers(2);
    for (int loop = 0; loop < kLoops; ++loop) {
      std::atomic<int> of_helper{0};
      parallel_for(16, 2, 1, [&](int, int thread) {
        of_helper += thread;
        work_for(5e-6);
      });
      shared += of_helper > 0 ? 1 : 0;
    }
#ifdef GYRO_DEBLUR_TSAN
    GTEST_SKIP() << "loops always call for help under ThreadSanitizer";
#endif
    EXPECT_LT(shared, kLoops / 2) << "a loop that others interrupt looks long";
  }).join();
}

TEST(AvailableCores, AreThoseOfTheAffinity) {
  EXPECT_GE(available_cores(), 1);
  std::thread([] {
    cpu_set_t all, one;
    ASSERT_EQ(sched_getaffinity(0, sizeof(all), &all), 0);
    EXPECT_EQ(available_cores(), CPU_COUNT(&all));
    int core = 0;
    while (!CPU_ISSET(core, &all)) ++core;
    CPU_ZERO(&one);
    CPU_SET(core, &one);
    ASSERT_EQ(sched_setaffinity(0, sizeof(one), &one), 0);
    EXPECT_EQ(available_cores(), 1);
    EXPECT_EQ(threads_or_all(0), 1);
    EXPECT_EQ(threads_or_all(3), 3);
  }).join();
}

}  // namespace
}  // namespace gyro_deblur::parallel_test
