#include "base/one_thread.hpp"

#include <gtest/gtest.h>

#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>

#include <opencv2/core.hpp>

namespace gyro_deblur::one_thread_test {
namespace {

/// Threads that OpenCV runs a loop's stripes on.
std::set<std::thread::id> threads_of_a_loop() {
  constexpr int kStripes = 64;
  std::mutex mutex;
  std::set<std::thread::id> threads;
  cv::parallel_for_(
      cv::Range(0, kStripes),
      [&](const cv::Range&) {
        const std::lock_guard<std::mutex> lock(mutex);
        threads.insert(std::this_thread::get_id());
      },
      kStripes);
  return threads;
}

TEST(OnOneThread, OpenCvsLoopsRunOnTheCallers) {
  const int before = cv::getNumThreads();
  cv::setNumThreads(4);
  const bool has_threads = cv::getNumThreads() > 1;
  std::set<std::thread::id> threads;
  on_one_thread([&threads] {
    for (int k = 0; k < 100; ++k) threads.merge(threads_of_a_loop());
  });
  cv::setNumThreads(before);
  EXPECT_EQ(threads, std::set<std::thread::id>{std::this_thread::get_id()});
  if (!has_threads) GTEST_SKIP() << "this OpenCV has no threads";
}

TEST(OnOneThread, PassesOnWhatIsThrown) {
  EXPECT_THROW(on_one_thread([] { throw std::runtime_error("no corners"); }), std::runtime_error);
  bool ran = false;
  on_one_thread([&ran] { ran = true; });
  EXPECT_TRUE(ran);
}

}  // namespace
}  // namespace gyro_deblur::one_thread_test
