#include "gyro_deblur/exposure.hpp"

#include <random>
#include <string>

#include <gtest/gtest.h>

namespace gyro_deblur::exposure_test {
namespace {

constexpr TimeNs kMs = 1'000'000;
constexpr TimeNs kStamp = 1'403'715'273'262'142'976;

ShutterTiming timing(TimeNs exposure_ns, TimeNs readout_ns) {
  ShutterTiming result;
  result.exposure_ns = exposure_ns;
  result.readout_ns = readout_ns;
  return result;
}

TEST(RowExposure, FollowsThePaper) {
  const RowExposure rows(kStamp, 480, timing(10 * kMs, 24 * kMs));
  EXPECT_EQ(rows.start(0), kStamp);
  EXPECT_EQ(rows.start(240), kStamp + 12 * kMs);
  EXPECT_EQ(rows.start(0.5), kStamp + 25'000);
  EXPECT_EQ(rows.middle(240), kStamp + 17 * kMs);
  EXPECT_EQ(rows.end(240), kStamp + 22 * kMs);
  EXPECT_EQ(rows.frame().begin_ns, kStamp);
  EXPECT_EQ(rows.frame().end_ns, rows.end(479));
  EXPECT_EQ(rows.end(479), kStamp + 24 * kMs * 479 / 480 + 10 * kMs);
}

TEST(RowExposure, BottomUpReadoutReversesTheRows) {
  const RowExposure rows(kStamp, 480, timing(10 * kMs, -24 * kMs));
  EXPECT_EQ(rows.start(0), kStamp);
  EXPECT_EQ(rows.start(240), kStamp - 12 * kMs);
  EXPECT_EQ(rows.frame().begin_ns, rows.start(479));
  EXPECT_EQ(rows.frame().end_ns, kStamp + 10 * kMs);
}

TEST(RowExposure, GlobalShutterExposesAllRowsAtOnce) {
  const RowExposure rows(kStamp, 480, timing(10 * kMs, 0));
  EXPECT_EQ(rows.start(0), rows.start(479));
  EXPECT_EQ(rows.frame().begin_ns, kStamp);
  EXPECT_EQ(rows.frame().end_ns, kStamp + 10 * kMs);
}

TEST(RowExposure, RoundsToNearest) {
  const RowExposure rows(0, 3, timing(5, 10));
  EXPECT_EQ(rows.start(1), 3);   // 3.33
  EXPECT_EQ(rows.start(2), 7);   // 6.67
  EXPECT_EQ(rows.middle(0), 3);  // 2.5, away from zero
  const RowExposure reversed(0, 3, timing(5, -10));
  EXPECT_EQ(reversed.start(1), -3);
  EXPECT_EQ(reversed.start(2), -7);
}

struct StampCase {
  StampRow row;
  StampPhase phase;
};

class StampConvention : public testing::TestWithParam<std::tuple<StampCase, TimeNs>> {};

// Whatever the convention, the exposure of the row it names is at the stamp in the phase it names.
TEST_P(StampConvention, HoldsAtTheStamp) {
  const auto& [stamp, readout_ns] = GetParam();
  ShutterTiming t = timing(10 * kMs, readout_ns);
  t.stamp_row = stamp.row;
  t.stamp_phase = stamp.phase;
  const int n = 480;
  const RowExposure rows(kStamp, n, t);
  const double y = stamp.row == StampRow::FIRST ? 0 : stamp.row == StampRow::MIDDLE ? 239.5 : 479;
  const TimeNs at_stamp = stamp.phase == StampPhase::START    ? rows.start(y)
                          : stamp.phase == StampPhase::MIDDLE ? rows.middle(y)
                                                              : rows.end(y);
  EXPECT_LE(std::abs(at_stamp - kStamp), 1);
  EXPECT_EQ(rows.reference_time(RectifyTo::STAMP), kStamp);
  EXPECT_EQ(rows.reference_time(RectifyTo::FIRST_ROW), rows.middle(0));
  EXPECT_EQ(rows.reference_time(RectifyTo::MIDDLE_ROW), rows.middle(239.5));
  EXPECT_EQ(rows.reference_time(RectifyTo::LAST_ROW), rows.middle(479));
  EXPECT_EQ(rows.start(479) - rows.start(0), readout_ns * 479 / 480);
}

INSTANTIATE_TEST_SUITE_P(All, StampConvention,
                         testing::Combine(testing::Values(StampCase{StampRow::FIRST, StampPhase::START},
                                                          StampCase{StampRow::FIRST, StampPhase::MIDDLE},
                                                          StampCase{StampRow::FIRST, StampPhase::END},
                                                          StampCase{StampRow::MIDDLE, StampPhase::START},
                                                          StampCase{StampRow::MIDDLE, StampPhase::MIDDLE},
                                                          StampCase{StampRow::MIDDLE, StampPhase::END},
                                                          StampCase{StampRow::LAST, StampPhase::START},
                                                          StampCase{StampRow::LAST, StampPhase::MIDDLE},
                                                          StampCase{StampRow::LAST, StampPhase::END}),
                                          testing::Values(TimeNs{24 * kMs}, TimeNs{0}, TimeNs{-24 * kMs})));

TEST(RowExposure, OneRowIsFirstMiddleAndLast) {
  const RowExposure rows(kStamp, 1, timing(10 * kMs, 24 * kMs));
  EXPECT_EQ(rows.reference_time(RectifyTo::FIRST_ROW), kStamp + 5 * kMs);
  EXPECT_EQ(rows.reference_time(RectifyTo::LAST_ROW), kStamp + 5 * kMs);
  EXPECT_EQ(rows.frame().end_ns, kStamp + 10 * kMs);
}

TEST(RowExposure, RefusesBadTimingByName) {
  const auto message = [](TimeNs exposure_ns, TimeNs readout_ns, int rows) -> std::string {
    try {
      RowExposure(0, rows, timing(exposure_ns, readout_ns));
    } catch (const OptionError& error) {
      return error.what();
    }
    return {};
  };
  const TimeNs s = 1000 * kMs;
  EXPECT_EQ(message(1, 0, 480), "");
  EXPECT_EQ(message(s, s, 480), "");
  EXPECT_EQ(message(s, -s, 480), "");
  EXPECT_EQ(message(0, 0, 480).rfind("exposure_time = 0", 0), 0u);
  EXPECT_EQ(message(-1, 0, 480).rfind("exposure_time", 0), 0u);
  EXPECT_EQ(message(s + 1, 0, 480).rfind("exposure_time = 1.000000001", 0), 0u);
  EXPECT_EQ(message(kMs, s + 1, 480).rfind("readout_time", 0), 0u);
  EXPECT_EQ(message(kMs, -s - 1, 480).rfind("readout_time", 0), 0u);
  EXPECT_EQ(message(kMs, 0, 0).rfind("rows = 0", 0), 0u);
}

TEST(FramePeriod, IsTheMedianOfTheIntervals) {
  FramePeriod period;
  constexpr TimeNs kPeriod = 33'000'000;
  TimeNs stamp_ns = 1'000'000'000;
  for (int i = 0; i < 5; ++i) {
    EXPECT_FALSE(period.get()) << i;
    period.add(stamp_ns += kPeriod);
  }
  period.add(stamp_ns += kPeriod);
  EXPECT_EQ(period.get(), kPeriod);
  period.add(stamp_ns += 4 * kPeriod);  // lost frames
  period.add(stamp_ns += 1);            // a bad stamp
  EXPECT_EQ(period.get(), kPeriod);
  period.add(stamp_ns - 1'000'000'000);  // back in time
  EXPECT_EQ(period.get(), kPeriod);
  period.clear();
  EXPECT_FALSE(period.get());
}

/// Stamps of a camera of 30 Hz whose driver stamps frames on arrival.
struct Driver {
  const char* name;
  double scatter_s;  ///< standard deviation
  int burst;         ///< so many frames arrive together
  double dropped;    ///< part of the frames
};

constexpr double kPeriodS = 1 / 30.0;
constexpr Driver kDrivers[] = {{"exact", 0, 1, 0},           {"scatter 4 ms", 4e-3, 1, 0},
                               {"scatter 5 ms", 5e-3, 1, 0}, {"scatter 6 ms", 6e-3, 1, 0},
                               {"pairs", 0.2e-3, 2, 0},      {"pairs, scatter 6 ms", 6e-3, 2, 0},
                               {"dropped", 0, 1, 0.1},       {"dropped pairs", 0.2e-3, 2, 0.1},
                               {"all of it", 6e-3, 2, 0.1},  {"threes", 0.2e-3, 3, 0}};

/// Calls `each(frames so far, period)` after every frame of two minutes in all, anew every ten seconds.
template <typename Each>
void drive(const Driver& driver, Each&& each) {
  std::mt19937 random(7);
  std::normal_distribution<double> scatter_s(0, driver.scatter_s);
  std::bernoulli_distribution drops(driver.dropped);
  for (int part = 0; part < 12; ++part) {
    FramePeriod period;
    int frames = 0;
    for (int i = 0; i < 300; ++i) {
      const int arrives = i - i % driver.burst + driver.burst - 1;
      const double stamp_s = 100 + arrives * kPeriodS + (driver.scatter_s > 0 ? scatter_s(random) : 0);
      if (drops(random)) continue;
      period.add(to_ns(stamp_s));
      each(++frames, period);
    }
  }
}

bool refuses(const FramePeriod& period, double readout_s) {
  try {
    period.require_plausible_readout("readout", to_ns(readout_s));
    return false;
  } catch (const OptionError&) {
    return true;
  }
}

bool refuses_exposure(const FramePeriod& period, double exposure_s) {
  try {
    period.require_plausible_exposure("exposure", to_ns(exposure_s));
    return false;
  } catch (const OptionError&) {
    return true;
  }
}

TEST(FramePeriod, AnExposureOfAPeriodIsNeverRefused) {
  for (const Driver& driver : kDrivers) {
    int refused = 0;
    drive(driver, [&refused](int, const FramePeriod& period) { refused += refuses_exposure(period, kPeriodS); });
    EXPECT_EQ(refused, 0) << driver.name;
  }
}

TEST(FramePeriod, AnExposureFarAboveItIsRefusedFromTheFourthFrameOn) {
  FramePeriod period;
  for (int i = 0; i < 100; ++i) {
    period.add(to_ns(100 + i * kPeriodS));
    EXPECT_EQ(refuses_exposure(period, 3 * kPeriodS), i >= 3) << i;
    EXPECT_FALSE(refuses_exposure(period, 1.05 * kPeriodS)) << i;
    if (i >= 74) {
      EXPECT_TRUE(refuses_exposure(period, 1.2 * kPeriodS)) << i;
    }
  }
  try {
    period.require_plausible_exposure("exposure_time", to_ns(0.2));
    FAIL() << "accepted";
  } catch (const OptionError& error) {
    EXPECT_STREQ(error.what(), "exposure_time = 0.2 s is longer than the frame period 0.0333333 s: is its unit right?");
  }
}

// As webcams do in dim light.
TEST(FramePeriod, AnExposureThatSlowsTheCameraDownIsAcceptedOnceItHas) {
  FramePeriod period;
  double stamp_s = 100;
  for (int i = 0; i < 100; ++i) period.add(to_ns(stamp_s += kPeriodS));
  EXPECT_TRUE(refuses_exposure(period, 1.9 * kPeriodS));
  for (int i = 0; i < 100; ++i) {
    period.add(to_ns(stamp_s += 2 * kPeriodS));
    EXPECT_EQ(refuses_exposure(period, 1.9 * kPeriodS), i < 2) << i;
  }
  // And back: nothing that was right before is wrong now.
  for (int i = 0; i < 100; ++i) {
    period.add(to_ns(stamp_s += kPeriodS));
    EXPECT_FALSE(refuses_exposure(period, kPeriodS)) << i;
  }
}

TEST(FramePeriod, NoScatterOfStampsRefusesAReadoutOfAPeriod) {
  for (const Driver& driver : kDrivers) {
    int refused = 0;
    drive(driver, [&refused](int, const FramePeriod& period) {
      refused += refuses(period, kPeriodS) + refuses(period, -kPeriodS);
    });
    EXPECT_EQ(refused, 0) << driver.name;
  }
}

TEST(FramePeriod, AReadoutThatCannotBeIsRefusedWhateverTheScatter) {
  for (const Driver& driver : kDrivers) {
    int passed_soon = 0, passed_later = 0;
    drive(driver, [&](int frames, const FramePeriod& period) {
      // A data sheet's microseconds taken for ten, and half as much again: what the time of two frames looks like.
      if (frames >= 25) passed_soon += !refuses(period, 10 * kPeriodS);
      if (frames >= 75) passed_later += !refuses(period, 1.5 * kPeriodS);
    });
    EXPECT_EQ(passed_soon, 0) << driver.name;
    EXPECT_EQ(passed_later, 0) << driver.name;
  }
}

TEST(FramePeriod, ResetsOfTimeAndPausesRefuseNothing) {
  for (const int from : {3, 4, 5, 8, 20, 70}) {
    for (const double step_s : {-1000.0, -5.0, -0.9, -0.3, -0.1, -0.05, -0.03, 0.0, 0.1, 5.0, 1000.0}) {
      FramePeriod period;
      for (int i = 0; i < 200; ++i) {
        period.add(to_ns(2000 + i * kPeriodS + (i >= from ? step_s : 0)));
        EXPECT_FALSE(refuses(period, kPeriodS)) << step_s << " s from " << from << ", frame " << i;
      }
      EXPECT_TRUE(refuses(period, 1.2 * kPeriodS)) << step_s << " s from " << from;
    }
  }
}

TEST(FramePeriod, BoundsTheReadout) {
  constexpr TimeNs kPeriod = 50'000'000;
  EXPECT_NO_THROW(require_plausible_readout("readout", kPeriod, kPeriod));
  EXPECT_NO_THROW(require_plausible_readout("readout", -kPeriod, kPeriod));
  EXPECT_THROW(require_plausible_readout("readout", 60'000'000, kPeriod), OptionError);
  EXPECT_THROW(require_plausible_readout("readout", -60'000'000, kPeriod), OptionError);
}

}  // namespace
}  // namespace gyro_deblur::exposure_test
