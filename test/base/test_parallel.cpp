#include "base/parallel.hpp"

#include <new>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur {
namespace {

constexpr int kThreads = 4;

TEST(RunParallel, CallsEveryIndexOnce) {
  std::vector<int> calls(1000, 0);
  run_parallel(1000, kThreads, 7, [&](int i) { ++calls[static_cast<std::size_t>(i)]; });
  EXPECT_EQ(calls, std::vector<int>(1000, 1));
  run_parallel(0, kThreads, 1, [](int) { FAIL(); });
}

TEST(RunParallel, ThrowsWhatABodyThrewInsteadOfEndingTheProcess) {
  EXPECT_THROW(run_parallel(100, kThreads, 1,
                            [](int i) {
                              if (i == 50) throw std::bad_alloc();
                            }),
               std::bad_alloc);
  EXPECT_THROW(run_parallel(100, 0, 1, [](int) { throw std::runtime_error("every one"); }), std::runtime_error);
}

TEST(FirstException, SkipsWhatIsLeftAfterAFailure) {
  FirstException failure;
  int calls = 0;
  failure.guard([&] { ++calls; });
  failure.guard([&] {
    ++calls;
    throw std::invalid_argument("first");
  });
  failure.guard([&] { ++calls; });
  EXPECT_EQ(calls, 2);
  EXPECT_THROW(failure.rethrow(), std::invalid_argument);
  EXPECT_NO_THROW(failure.rethrow()) << "it has been thrown";
}

}  // namespace
}  // namespace gyro_deblur
