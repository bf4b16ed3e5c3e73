#include "base/time_slice.hpp"

#include <thread>

#include <gtest/gtest.h>

namespace gyro_deblur::time_slice_test {
namespace {

TEST(TimeSliceOfAFrame, IsOfTheThreadThatAsksAlone) {
  const auto others = scheduling_attributes();
  if (!others || others->runtime_ns == 0) GTEST_SKIP() << "this kernel has no time slice to ask for";
  std::optional<SchedulingAttributes> asking, started_by_it;
  std::thread([&] {
    ask_for_time_slice_of_a_frame();
    asking = scheduling_attributes();
    std::thread([&] { started_by_it = scheduling_attributes(); }).join();
  }).join();
  ASSERT_TRUE(asking && started_by_it);
  EXPECT_EQ(asking->runtime_ns, 3'000'000u);
  EXPECT_EQ(asking->policy, others->policy);
  EXPECT_EQ(asking->nice, others->nice);
  if (others->nice >= 0) {
    EXPECT_EQ(started_by_it->runtime_ns, others->runtime_ns);
  }
  EXPECT_EQ(scheduling_attributes()->runtime_ns, others->runtime_ns);
}

}  // namespace
}  // namespace gyro_deblur::time_slice_test
