#include "base/once_map.hpp"

#include <atomic>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::once_map_test {
namespace {

TEST(OnceMap, MakesEachValueOnceForAllThreads) {
  OnceMap<int, int> values;
  std::atomic<int> made{0};
  std::vector<std::vector<const int*>> seen(8, std::vector<const int*>(100));
  std::vector<std::thread> threads;
  for (auto& of_thread : seen) {
    threads.emplace_back([&] {
      for (int key = 0; key < 100; ++key) {
        of_thread[key] = &values.get(key, [&] {
          ++made;
          return 3 * key;
        });
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(made, 100);
  EXPECT_EQ(values.size(), 100u);
  for (int key = 0; key < 100; ++key) {
    EXPECT_EQ(*seen[0][key], 3 * key);
    for (const auto& of_thread : seen) EXPECT_EQ(of_thread[key], seen[0][key]);
  }
}

// The other value is made while the first is in the making: without that this would wait forever.
TEST(OnceMap, MakesAValueThatNeedsAnother) {
  OnceMap<int, int> values;
  EXPECT_EQ(values.get(1, [&] { return values.get(2, [] { return 20; }) + 1; }), 21);
}

TEST(OnceMap, TriesAgainAfterAnException) {
  OnceMap<int, int> values;
  EXPECT_THROW(values.get(1, []() -> int { throw std::runtime_error("no room"); }), std::runtime_error);
  EXPECT_EQ(values.get(1, [] { return 5; }), 5);
  EXPECT_EQ(values.get(1, [] { return 6; }), 5);
}

TEST(OnceMap, ForgetsWhatIsNotKept) {
  OnceMap<int, int> values;
  for (int key = 0; key < 4; ++key) values.get(key, [] { return 1; });
  values.keep_only({1, 3, 7});
  EXPECT_EQ(values.size(), 2u);
  EXPECT_EQ(values.get(3, [] { return 2; }), 1);
  EXPECT_EQ(values.get(0, [] { return 2; }), 2);
}

}  // namespace
}  // namespace gyro_deblur::once_map_test
