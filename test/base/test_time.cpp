// time.hpp and option_error.hpp.
#include "gyro_deblur/time.hpp"

#include <cmath>
#include <limits>
#include <string>

#include <gtest/gtest.h>

#include "base/require_range.hpp"
#include "option_error_text.hpp"

namespace gyro_deblur::time_test {
namespace {

using test::option_error;

TEST(Time, SecondsToNanosecondsRoundsToNearest) {
  EXPECT_EQ(to_ns(0), 0);
  EXPECT_EQ(to_ns(1), 1'000'000'000);
  EXPECT_EQ(to_ns(0.0244944), 24'494'400);
  EXPECT_EQ(to_ns(0.6e-9), 1);
  EXPECT_EQ(to_ns(0.4e-9), 0);
  EXPECT_EQ(to_ns(-0.6e-9), -1);
  EXPECT_EQ(to_ns(-0.017552), -17'552'000);
  EXPECT_EQ(to_ns(-1.25), -1'250'000'000);
}

TEST(Time, StampsSince1970KeepWhatADoubleHolds) {
  const double stamp_s = 1403715273.262143;  // a double has steps of 238 ns there
  EXPECT_EQ(to_ns(1403715273.5), 1'403'715'273'500'000'000);
  const double fraction = stamp_s - 1403715273.0;
  EXPECT_EQ(to_ns(stamp_s), 1'403'715'273'000'000'000 + std::llround(fraction * 1e9));
}

TEST(Time, NanosecondsToSeconds) {
  EXPECT_DOUBLE_EQ(to_seconds(1), 1e-9);
  EXPECT_DOUBLE_EQ(to_seconds(-2'500'000'000), -2.5);
  for (const TimeNs t : {0LL, 1LL, -7LL, 123'456'789LL, 86'400'000'000'123LL}) EXPECT_EQ(to_ns(to_seconds(t)), t);
}

TEST(Time, RangeIsClosedAndMayBeEmpty) {
  const TimeRange range{10, 20};
  EXPECT_TRUE(range.contains(10));
  EXPECT_TRUE(range.contains(20));
  EXPECT_FALSE(range.contains(21));
  EXPECT_TRUE(range.contains(TimeRange{10, 20}));
  EXPECT_FALSE(range.contains(TimeRange{9, 20}));
  EXPECT_FALSE(range.contains(TimeRange{15, 14}));
  EXPECT_TRUE(TimeRange{}.empty());
}

TEST(RequireRange, NamesValueAndRange) {
  EXPECT_EQ(option_error([] { require_range("noise_to_signal_ratio", 2, 0.5, 1, "W"); }),
            "noise_to_signal_ratio = 2 is outside [0.5, 1] W");
  EXPECT_EQ(option_error([] { require_range("n", -1, 0, 10); }), "n = -1 is outside [0, 10]");
  EXPECT_NO_THROW(require_range("noise_to_signal_ratio", 1, 0.5, 1));
  EXPECT_NO_THROW(require_range("noise_to_signal_ratio", 0.5, 0.5, 1));
  EXPECT_NE(option_error([] { require_range("noise_to_signal_ratio", std::nan(""), 0, 1); }), "");
  EXPECT_NE(option_error([] { require_range("noise_to_signal_ratio", std::numeric_limits<double>::infinity(), 0, 1); }),
            "");
}

}  // namespace
}  // namespace gyro_deblur::time_test
