// The threads behind parallel_for().
#include "base/parallel.hpp"

#include <pthread.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <exception>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "base/time_slice.hpp"

namespace gyro_deblur {
namespace {

using Clock = std::chrono::steady_clock;  // its time is read without a system call, see work_until_worthwhile

// Least work for each helper. Under contention a helper that loses its core in the middle of a piece keeps the loop
// waiting, and every system call is a chance for the kernel to give this thread's core away
// (doc/reports/contention.md).
constexpr std::chrono::nanoseconds kMinWorkPerHelper{2'000'000};

// Frames of a robot are processed on a few cores beside others' work.
constexpr int kMostAwake = 3;
// In a frame's processing a loop follows the one before it sooner.
constexpr std::chrono::nanoseconds kLongestWait{2'000'000};

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
  int chunk() const { return chunk_; }
  /// Of a helper that joins: the thread that runs the loop is 0.
  int next_thread() { return ++threads_; }

  void rethrow() {
    if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
  }

  // Counts of helpers that were called, under their lock.
  int wanted = 0, joined = 0, at_work = 0;
  std::condition_variable all_left;

  // Of helpers that were awake: at which slots the loop was offered, and how many helpers have left it.
  std::array<bool, kMostAwake> offered{};
  int offers = 0;
  std::atomic<int> helpers_left{0};

 private:
  const int count_, chunk_;
  const LoopPart& part_;
  std::atomic<std::int64_t> next_{0};  // 64 bit: goes on past count_
  std::atomic<int> threads_{0};
  std::mutex failure_mutex_;
  std::exception_ptr failure_;
};

/// Lets the other thread of a core work, for some tens of cycles.
inline void pause() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("isb");  // yield does nothing on most Cortex-A
#endif
}

/// Where one helper that is awake waits for loops.
class alignas(64) Slot {
 public:
  // Of the helper.
  void wait() { loop_ = waiting(); }
  /// @return false where a loop was offered meanwhile
  bool leave() {
    Loop* expected = waiting();
    return loop_.compare_exchange_strong(expected, nullptr);
  }
  Loop* take() {
    Loop* loop = loop_.load(std::memory_order_relaxed);
    return loop != waiting() && loop_.compare_exchange_strong(loop, nullptr) ? loop : nullptr;
  }

  // Of the thread that runs a loop.
  /// @return false where nobody waits here
  bool offer(Loop& loop) {
    Loop* expected = waiting();
    return loop_.load(std::memory_order_relaxed) == expected && loop_.compare_exchange_strong(expected, &loop);
  }
  /// @return false where the helper has taken the loop
  bool withdraw(Loop& loop) {
    Loop* expected = &loop;
    return loop_.compare_exchange_strong(expected, waiting());
  }

  bool has_helper = false;  // under the lock of Helpers

 private:
  Loop* waiting() { return reinterpret_cast<Loop*>(this); }  // no loop has this address

  std::atomic<Loop*> loop_{nullptr};  // offered; nullptr: nobody waits here
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
  /// @return false in a child that was forked from the process: no thread helps it, and one may have had the lock
  bool call(Loop& loop, int count) {
    if (getpid() != process_) return false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      loop.wanted = count;
      loops_.push_back(&loop);
      start_threads(count + awake_);
    }
    for (int i = 0; i < count; ++i) called_.notify_one();
    return true;
  }

  /// Returns when nobody has to do with the loop any more, nor will have.
  void dismiss(Loop& loop) {
    std::unique_lock<std::mutex> lock(mutex_);
    close(loop);
    loop.all_left.wait(lock, [&loop] { return loop.at_work == 0; });
  }

  /// Until end_session() this thread works, and up to `count` helpers are awake, as far as there are cores for them and
  /// for the threads of all sessions.
  /// @return false where there is nothing to end
  bool begin_session(int count) {
    cpu_set_t cores;
    if (getpid() != process_ || sched_getaffinity(0, sizeof(cores), &cores) != 0) return false;
    int woken = 0;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      const int others = ++sessions_ - 1, free = std::max(CPU_COUNT(&cores) - 1 - others, 0);
      const int most = std::min({count, kMostAwake, free});
      wanted_awake_ = others == 0 ? most : std::min(std::max<int>(wanted_awake_, most), free);
      ++session_number_;
      if (most > 0) {
        start_threads(most);
        leave_core_of_caller(&cores);
        woken = wanted_awake_ - awake_;
      }
    }
    for (int i = 0; i < woken; ++i) called_.notify_one();
    return true;
  }

  void end_session() { --sessions_; }

  /// Offers the loop to `most` helpers that are awake, at most, each once.
  void offer(Loop& loop, int most) {
    if (sessions_.load(std::memory_order_relaxed) == 0) return;
    for (std::size_t i = 0; i < slots_.size() && loop.offers < most; ++i) {
      if (loop.offered[i] || !slots_[i].offer(loop)) continue;
      loop.offered[i] = true;
      ++loop.offers;
    }
  }

  /// Returns when no helper that is awake has to do with the loop any more, nor will have.
  void withdraw(Loop& loop) {
    if (loop.offers == 0) return;
    int taken = 0;
    for (std::size_t i = 0; i < slots_.size(); ++i) taken += loop.offered[i] && !slots_[i].withdraw(loop) ? 1 : 0;
    const auto all_left = [&] { return loop.helpers_left == taken; };
    // A piece of a loop takes less, unless its helper lost its core.
    constexpr int kPauses = 2000;
    for (int i = 0; i < kPauses; ++i) {
      if (all_left()) return;
      pause();
    }
    std::unique_lock<std::mutex> lock(mutex_);
    ++sleepers_;
    helper_left_.wait(lock, all_left);
    --sleepers_;
  }

 private:
  /// As many as can be had, up to `count`: those who are there do it all.
  void start_threads(int count) {
    try {
      ids_.reserve(static_cast<std::size_t>(std::max(count, threads_)));
      for (; threads_ < count; ++threads_) std::thread([this] { help(); }).detach();
    } catch (const std::system_error&) {
    } catch (const std::bad_alloc&) {
    }
  }

  void help() {
    pthread_setname_np(pthread_self(), "gyro_deblur");
    ask_for_time_slice_of_a_frame();
    std::unique_lock<std::mutex> lock(mutex_);
    ids_.push_back(static_cast<pid_t>(syscall(SYS_gettid)));
    while (true) {
      Loop* loop = nullptr;
      called_.wait(lock, [&] { return (loop = open_loop()) != nullptr || is_wanted_awake(); });
      if (!loop) {
        stay_awake(lock);
        continue;
      }
      const int thread = loop->next_thread();
      ++loop->joined;
      ++loop->at_work;
      lock.unlock();
      while (loop->step(thread)) {
      }
      lock.lock();
      close(*loop);
      if (--loop->at_work == 0) loop->all_left.notify_one();
    }
  }

  /// Has helpers wake on other cores than this thread's. In a virtual machine Linux takes a halted processor for one
  /// that the host took away, and would wake them here.
  /// @param cores  at least two
  void leave_core_of_caller(cpu_set_t* cores) {
    CPU_CLR(sched_getcpu(), cores);
    if (placed_ == ids_.size() && CPU_EQUAL(cores, &cores_)) return;
    for (const pid_t id : ids_) (void)sched_setaffinity(id, sizeof(*cores), cores);
    cores_ = *cores;
    placed_ = ids_.size();
  }

  bool is_wanted_awake() const { return sessions_ > 0 && awake_ < wanted_awake_; }

  /// Waits for loops without the lock until nobody wants helpers to be awake.
  void stay_awake(std::unique_lock<std::mutex>& lock) {
    Slot& slot = *std::find_if(slots_.begin(), slots_.end(), [](const Slot& each) { return !each.has_helper; });
    slot.has_helper = true;
    ++awake_;
    lock.unlock();
    const int session = help_while_awake(slot);
    lock.lock();
    --awake_;
    slot.has_helper = false;
    // A helper that no loop came for is not wanted until another session begins. Where too many left because fewer are
    // wanted, the last of them come back.
    if (session == session_number_) wanted_awake_ = std::min<int>(wanted_awake_, awake_);
  }

  /// Until all sessions have ended, or no loop came for kLongestWait, or fewer helpers are wanted.
  /// @return the number of the newest session; 0 where fewer are wanted
  int help_while_awake(Slot& slot) {
    constexpr int kPausesBetweenLooks = 50;
    auto last = Clock::now();
    int session = session_number_;
    slot.wait();
    while (true) {
      for (int i = 0; i < kPausesBetweenLooks; ++i) {
        if (Loop* loop = slot.take()) {
          const int thread = loop->next_thread();
          while (loop->step(thread)) {
          }
          ++loop->helpers_left;  // the loop may be gone from here on
          wake_sleepers();
          slot.wait();
          last = Clock::now();
        }
        pause();
      }
      if (const int newest = session_number_; newest != session) {
        session = newest;
        last = Clock::now();
      }
      const bool idle = sessions_ == 0 || Clock::now() - last > kLongestWait;
      if ((idle || awake_ > wanted_awake_) && slot.leave()) return idle ? session : 0;
    }
  }

  void wake_sleepers() {
    if (sleepers_ == 0) return;
    const std::lock_guard<std::mutex> lock(mutex_);
    helper_left_.notify_all();
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
  const pid_t process_ = getpid();  // a child that was forked from it has no helpers
  int threads_ = 0;
  std::vector<pid_t> ids_;  // of those that run
  cpu_set_t cores_{};       // of the first placed_ of them
  std::size_t placed_ = 0;
  // Of helpers that are awake. Written under the lock, but for the end of a session.
  std::array<Slot, kMostAwake> slots_;
  std::atomic<int> sessions_{0}, session_number_{0}, wanted_awake_{0}, awake_{0};
  std::atomic<int> sleepers_{0};  // threads that wait for a helper to leave their loop
  std::condition_variable helper_left_;
};

/// Works, with helpers that are awake as soon as there are any, until it is known whether the rest is worth waking
/// others. Makes no system call.
/// @return how many helpers it is worth to wake, `most` less those that were awake at most; 0: none
int work_until_worthwhile(Loop& loop, int most, Helpers& pool) {
  pool.offer(loop, most);
  if (eager_helpers > 0) return most - loop.offers;
  auto before = Clock::now();
  std::chrono::nanoseconds elapsed{0}, longest{0};
  for (int steps = 1; loop.step(0); ++steps) {
    pool.offer(loop, most);
    const auto now = Clock::now();
    elapsed += now - before;
    longest = std::max(longest, now - before);
    before = now;
    // The longest step may have been interrupted: it is no measure.
    constexpr int kStepsThatTell = 3;
    if (steps < kStepsThatTell) continue;
    const double step_ns = static_cast<double>((elapsed - longest).count()) / (steps - 1);
    const double rest_ns = step_ns * (loop.count() - loop.begun()) / loop.chunk();
    const double worth = rest_ns / static_cast<double>(kMinWorkPerHelper.count()) - loop.offers;
    if (worth >= 1) return static_cast<int>(std::min<double>(worth, most - loop.offers));
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
  Helpers& pool = Helpers::instance();
  int helpers = work_until_worthwhile(loop, most - 1, pool);
  try {
    if (helpers > 0 && !pool.call(loop, helpers)) helpers = 0;
  } catch (const std::bad_alloc&) {
    // Nobody else is called.
  }
  while (loop.step(0)) pool.offer(loop, most - 1 - helpers);
  pool.withdraw(loop);
  if (helpers > 0) pool.dismiss(loop);
  loop.rethrow();
}

AwakeHelpers::AwakeHelpers(int threads) : wakes_(Helpers::instance().begin_session(threads_or_all(threads) - 1)) {}
AwakeHelpers::~AwakeHelpers() {
  if (wakes_) Helpers::instance().end_session();
}

EagerHelpers::EagerHelpers() { ++eager_helpers; }
EagerHelpers::~EagerHelpers() { --eager_helpers; }

}  // namespace gyro_deblur
