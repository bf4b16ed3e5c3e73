#include "sync/gyro_source.hpp"

#include <algorithm>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <sstream>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::gyro_source_test {
namespace {

constexpr TimeNs kMs = 1'000'000, kSecond = 1'000'000'000;
constexpr double kFastRadS = 1.5;
constexpr char kImuFrame[] = "imu";
constexpr TimeNs kStart = 100 * kSecond;
constexpr TimeNs kImuPeriod = 5 * kMs;

class GyroSourceTest : public testing::Test {
 protected:
  static std::shared_ptr<GyroSource> make_source(TimeNs capacity_ns = 2 * kSecond) {
    return std::make_shared<GyroSource>(GyroSource::Options{capacity_ns, 500 * kMs, GyroOptions()},
                                        [](LogLevel, const std::string&) {});
  }
  bool add_one(TimeNs t_ns, double rate_rad_s) { return source_->add(GyroSample{t_ns, {0, rate_rad_s, 0}}, kImuFrame); }
  void add(TimeNs from_ns, TimeNs to_ns) {
    for (TimeNs t_ns = from_ns; t_ns <= to_ns; t_ns += kImuPeriod) add_one(t_ns, kFastRadS);
  }
  static void expect_range(const GyroReader& reader, TimeNs begin_ns, TimeNs end_ns) {
    EXPECT_FALSE(reader.empty());
    EXPECT_EQ(reader.available().begin_ns, begin_ns);
    EXPECT_EQ(reader.available().end_ns, end_ns);
    const std::vector<GyroSample> samples = reader.window({0, std::numeric_limits<TimeNs>::max()});
    ASSERT_FALSE(samples.empty());
    EXPECT_EQ(samples.front().t_ns, begin_ns);
    EXPECT_EQ(samples.back().t_ns, end_ns);
  }

  std::shared_ptr<GyroSource> source_ = make_source();
};

TEST_F(GyroSourceTest, ReadersSeeTheSameSamplesAndEachItsOwnNews) {
  GyroReader first(source_), second(source_);
  EXPECT_TRUE(first.empty());
  EXPECT_FALSE(first.update().newest_ns);
  add(kStart, kStart + 100 * kMs);
  expect_range(first, kStart, kStart + 100 * kMs);
  expect_range(second, kStart, kStart + 100 * kMs);
  EXPECT_EQ(first.update().samples, 21u);
  EXPECT_EQ(first.update().samples, 0u);
  const GyroReader::News news = second.update();
  EXPECT_EQ(news.samples, 21u);
  EXPECT_EQ(news.newest_ns, kStart + 100 * kMs);
  EXPECT_FALSE(news.restarted);
  EXPECT_EQ(source_->statistics().imu_accepted, 21u) << "taken in once";
  EXPECT_EQ(source_->frame_id(), kImuFrame);
}

TEST_F(GyroSourceTest, OneThatComesLaterSeesWhatIsThere) {
  add(kStart, kStart + 100 * kMs);
  GyroReader reader(source_);
  expect_range(reader, kStart, kStart + 100 * kMs);
}

TEST_F(GyroSourceTest, ForgettingIsTheReadersOwnAndEndsAtItsLastUpdate) {
  GyroReader first(source_), second(source_);
  add(kStart, kStart + 50 * kMs);
  first.update();
  add(kStart + 55 * kMs, kStart + 100 * kMs);
  first.forget();
  expect_range(first, kStart + 55 * kMs, kStart + 100 * kMs);
  expect_range(second, kStart, kStart + 100 * kMs);
  first.update();
  first.forget();
  EXPECT_TRUE(first.empty());
  EXPECT_TRUE(first.window({kStart, kStart + kSecond}).empty());
  EXPECT_FALSE(second.empty());
}

TEST_F(GyroSourceTest, ClockSetBackIsNoticedOnceByTheSourceAndByEachReader) {
  GyroReader first(source_), second(source_);
  add(kStart, kStart + kSecond);
  first.update();
  second.update();
  first.forget();
  add(kStart - 10 * kSecond, kStart - 10 * kSecond + 15 * kMs);
  EXPECT_FALSE(first.update().restarted) << "four stamps may be wrong";
  add(kStart - 10 * kSecond + 20 * kMs, kStart - 9 * kSecond);
  for (GyroReader* reader : {&first, &second}) {
    const GyroReader::News news = reader->update();
    EXPECT_TRUE(news.restarted);
    EXPECT_EQ(news.from_ns, kStart + kSecond);
    EXPECT_EQ(news.to_ns, kStart - 10 * kSecond);
    EXPECT_EQ(news.newest_ns, kStart - 9 * kSecond);
    EXPECT_FALSE(reader->update().restarted);
    expect_range(*reader, kStart - 10 * kSecond, kStart - 9 * kSecond);
  }
}

TEST_F(GyroSourceTest, BagShorterThanTheThresholdRestartsIt) {
  GyroReader reader(source_);
  add(kStart, kStart + 300 * kMs);
  add(kStart, kStart + 40 * kMs);
  EXPECT_FALSE(reader.update().restarted);
  add(kStart + 45 * kMs, kStart + 100 * kMs);
  EXPECT_TRUE(reader.update().restarted);
  expect_range(reader, kStart, kStart + 100 * kMs);
}

TEST_F(GyroSourceTest, CapacityGrowsToWhatIsRequired) {
  source_ = make_source(100 * kMs);
  GyroReader reader(source_);
  add(kStart, kStart + kSecond);
  expect_range(reader, kStart + 900 * kMs, kStart + kSecond);
  source_->require_capacity(300 * kMs);
  source_->require_capacity(200 * kMs);
  add(kStart + kSecond + kImuPeriod, kStart + 2 * kSecond);
  expect_range(reader, kStart + 1700 * kMs, kStart + 2 * kSecond);
}

TEST_F(GyroSourceTest, ReturnsWhetherAMessageIsOfUse) {
  int good = 0;
  EXPECT_TRUE(add_one(kStart, 1));
  EXPECT_FALSE(add_one(kStart + kMs, std::numeric_limits<double>::quiet_NaN()));
  EXPECT_FALSE(source_->add(std::nullopt, kImuFrame));
  EXPECT_EQ(source_->statistics().imu_not_finite, 1u);
  EXPECT_EQ(source_->statistics().imu_without_gyroscope, 1u);
  for (const TimeNs stray_ns : {kStart + 1000 * kSecond, kStart + kSecond, kStart - kMs, kStart, TimeNs{0}}) {
    EXPECT_FALSE(add_one(stray_ns, 1)) << stray_ns;
    EXPECT_TRUE(add_one(kStart + 3 * kMs + (++good) * kMs, 1)) << stray_ns;
  }
}

TEST_F(GyroSourceTest, CountsWhatIsWrongWithStampsOnceEach) {
  add(kStart, kStart + 20 * kMs);
  add_one(kStart + 15 * kMs, 1);
  EXPECT_EQ(source_->statistics().imu_out_of_order, 1u) << "whether or not another one comes";
  add_one(kStart + 20 * kMs, 1);
  add_one(kStart + 10 * kSecond, 1);
  add(kStart + 25 * kMs, kStart + 30 * kMs);
  EXPECT_EQ(source_->statistics().imu_out_of_order, 1u);
  EXPECT_EQ(source_->statistics().imu_duplicate, 1u);
  EXPECT_EQ(source_->statistics().imu_stray, 1u);
  EXPECT_EQ(source_->statistics().imu_accepted, 7u);
}

constexpr double kWrongRadS = 9;

TEST_F(GyroSourceTest, AStampAheadCostsThatSampleAloneAtAnyRate) {
  constexpr int kBefore = 20;
  constexpr TimeNs kAfter = 250 * kMs;
  for (const int rate_hz : {100, 200, 400, 1000, 4000}) {
    const TimeNs period_ns = kSecond / rate_hz;
    for (const double jitter : {0.0, 0.2}) {  // of the period
      std::mt19937 random(7);
      std::uniform_real_distribution<double> scatter(-jitter * static_cast<double>(period_ns),
                                                     jitter * static_cast<double>(period_ns));
      for (TimeNs ahead_ns = kMs; ahead_ns <= 200 * kMs; ahead_ns += kMs) {
        source_ = make_source();
        GyroReader reader(source_);
        const int count = kBefore + 1 + static_cast<int>(kAfter / period_ns);
        for (int i = 0; i < count; ++i) {
          const bool wrong = i == kBefore;
          const TimeNs stamp_ns = kStart + i * period_ns + static_cast<TimeNs>(scatter(random));
          add_one(stamp_ns + (wrong ? ahead_ns : 0), wrong ? kWrongRadS : kFastRadS);
          reader.update();
        }
        std::ostringstream where;
        where << rate_hz << " Hz, " << ahead_ns / kMs << " ms ahead, scatter " << jitter;
        SCOPED_TRACE(where.str());
        const auto samples = reader.window({0, std::numeric_limits<TimeNs>::max()});
        const auto is_wrong = [](const GyroSample& sample) { return sample.rate_rad_s.y() == kWrongRadS; };
        const auto wrong = std::count_if(samples.begin(), samples.end(), is_wrong);
        const ImuStatistics statistics = source_->statistics();
        ASSERT_EQ(statistics.imu_accepted, samples.size()) << "no reset";
        if (static_cast<double>(ahead_ns) >= (1 + 2 * jitter) * static_cast<double>(period_ns)) {
          ASSERT_EQ(wrong, 0);
          ASSERT_EQ(samples.size(), static_cast<std::size_t>(count - 1));
        } else {  // it may still come before the next one, and looks like a right one
          ASSERT_GE(samples.size() - static_cast<std::size_t>(wrong), static_cast<std::size_t>(count - 2));
        }
        ASSERT_EQ(statistics.imu_stray + statistics.imu_duplicate + statistics.imu_out_of_order,
                  count - samples.size());
      }
    }
  }
}

TEST_F(GyroSourceTest, ASampleThatIsLateItselfCostsNoOther) {
  for (const int rate_hz : {100, 200, 400, 1000, 4000}) {
    const TimeNs period_ns = kSecond / rate_hz;
    for (const double late : {1.0, 1.3, 1.7, 2.0, 2.5, 30.0}) {  // periods
      source_ = make_source();
      GyroReader reader(source_);
      for (int i = 0; i < 100; ++i) {
        const bool wrong = i == 50;
        const TimeNs off_ns = wrong ? static_cast<TimeNs>(late * static_cast<double>(period_ns)) : 0;
        add_one(kStart + i * period_ns - off_ns, wrong ? kWrongRadS : kFastRadS);
      }
      const auto samples = reader.window({0, std::numeric_limits<TimeNs>::max()});
      EXPECT_EQ(samples.size(), 99u) << rate_hz << " Hz, " << late;
      for (const GyroSample& sample : samples)
        EXPECT_EQ(sample.rate_rad_s.y(), kFastRadS) << rate_hz << " Hz, " << late;
    }
  }
}

TEST_F(GyroSourceTest, ASaturatedSampleThatIsGivenBackIsNotCounted) {
  GyroOptions gyro;
  gyro.range_rad_s = 5;
  source_ = std::make_shared<GyroSource>(GyroSource::Options{2 * kSecond, 500 * kMs, gyro},
                                         [](LogLevel, const std::string&) {});
  add(kStart, kStart + 100 * kMs);
  add_one(kStart + 140 * kMs, kWrongRadS);
  EXPECT_EQ(source_->statistics().imu_saturated, 1u);
  add(kStart + 110 * kMs, kStart + 150 * kMs);
  EXPECT_EQ(source_->statistics().imu_saturated, 0u);
  EXPECT_EQ(source_->statistics().imu_stray, 1u);
  EXPECT_EQ(source_->statistics().imu_accepted, 30u);
}

TEST_F(GyroSourceTest, AClockThatCatchesUpWithinAGapIsNotReset) {
  // 40 ms are 16 to 160 samples, and less than max_gap_ns.
  for (const TimeNs period_ns : {kMs / 4, kMs, 5 * kMs / 2}) {
    for (const int ahead : {0, 2, 5}) {  // so many are ahead; or else the clock is set back
      source_ = make_source();
      GyroReader reader(source_);
      for (int i = 0; i < 400; ++i) {
        const bool off = ahead == 0 ? i >= 200 : i >= 200 && i < 200 + ahead;
        add_one(kStart + i * period_ns + (off ? (ahead == 0 ? -1 : 1) * 40 * kMs : 0), 1);
      }
      EXPECT_FALSE(reader.update().restarted) << period_ns << " ns, " << ahead;
      EXPECT_EQ(reader.available().begin_ns, kStart);
    }
  }
}

TEST_F(GyroSourceTest, LoopOfAShortBagRestartsItAtAnyRate) {
  for (const int rate_hz : {100, 200, 400, 1000, 4000}) {
    const TimeNs period_ns = kSecond / rate_hz;
    source_ = make_source();
    GyroReader reader(source_);
    for (int loop = 0; loop < 3; ++loop) {
      for (TimeNs t_ns = kStart; t_ns <= kStart + 300 * kMs; t_ns += period_ns) add_one(t_ns, loop);
      EXPECT_EQ(reader.update().restarted, loop > 0) << rate_hz << " Hz";
      const auto samples = reader.window({0, std::numeric_limits<TimeNs>::max()});
      EXPECT_EQ(samples.size(), static_cast<std::size_t>(300 * kMs / period_ns + 1));
      EXPECT_EQ(samples.front().rate_rad_s.y(), loop);
    }
  }
}

TEST_F(GyroSourceTest, ReadersMayReadWhileItIsFed) {
  constexpr int kLoops = 20;
  std::thread imu([this] {
    for (int loop = 0; loop < kLoops; ++loop) add(kStart, kStart + kSecond);
  });
  std::vector<std::thread> cameras;
  for (int camera = 0; camera < 2; ++camera) {
    cameras.emplace_back([this] {
      GyroReader reader(source_);
      while (source_->statistics().imu_accepted < kLoops * 201) {
        if (reader.update().restarted) reader.forget();
        const std::vector<GyroSample> samples = reader.window(reader.available());
        for (std::size_t i = 1; i < samples.size(); ++i) ASSERT_LT(samples[i - 1].t_ns, samples[i].t_ns);
      }
    });
  }
  imu.join();
  for (std::thread& camera : cameras) camera.join();
}

}  // namespace
}  // namespace gyro_deblur::gyro_source_test
