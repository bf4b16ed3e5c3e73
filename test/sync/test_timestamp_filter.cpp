#include "sync/timestamp_filter.hpp"

#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::timestamp_filter_test {
namespace {

struct Message {
  TimeNs t_ns;
};

constexpr TimeNs kGap = 50, kJump = 500;

/// What became of the messages of a stream.
struct Log {
  std::vector<TimeNs> taken;  ///< since the last reset, less what was given back
  std::vector<std::pair<TimeNs, RejectReason>> refused;
  std::vector<std::pair<TimeNs, TimeNs>> resets;
};

class Feed {
 public:
  explicit Feed(const StampLimits& limits) : limits_(limits) {}
  Feed& operator()(const std::vector<TimeNs>& stamps) {
    for (const TimeNs stamp_ns : stamps) {
      const auto result = rule_.add({stamp_ns}, limits_);
      if (result.newest_refused) log_.taken.pop_back();
      if (result.reset) {
        log_.resets.emplace_back(result.reset->from_ns, result.reset->to_ns);
        log_.taken.clear();
      }
      for (const Message& each : result.taken) log_.taken.push_back(each.t_ns);
      for (const auto& each : result.refused) log_.refused.emplace_back(each.message.t_ns, each.why);
      EXPECT_EQ(rule_.newest_ns(), log_.taken.back());
    }
    return *this;
  }
  /// Each from `first` on, `count` of them.
  Feed& steps(TimeNs first_ns, TimeNs period_ns, int count) {
    for (int i = 0; i < count; ++i) (*this)({first_ns + i * period_ns});
    return *this;
  }
  const Log& log() const { return log_; }
  TimestampFilter<Message>& rule() { return rule_; }

 private:
  StampLimits limits_;
  TimestampFilter<Message> rule_;
  Log log_;
};

using Stamps = std::vector<TimeNs>;
using Refused = std::vector<std::pair<TimeNs, RejectReason>>;
using Resets = std::vector<std::pair<TimeNs, TimeNs>>;

StampLimits imu() { return imu_stamps(kGap, kJump); }
StampLimits watched() { return watched_stamps(kJump); }

TEST(TimestampFilter, TakesWhatFits) {
  for (const StampLimits& limits : {imu(), watched()}) {
    Feed feed(limits);
    EXPECT_EQ(feed.rule().newest_ns(), std::nullopt);
    feed({1000, 1001, 1050, 1100});
    EXPECT_EQ(feed.log().taken, (Stamps{1000, 1001, 1050, 1100}));
    EXPECT_TRUE(feed.log().refused.empty());
    EXPECT_TRUE(feed.log().resets.empty());
  }
}

TEST(TimestampFilter, RefusesRepeatsAndLateOnesOnceTheNextShowsIt) {
  for (const StampLimits& limits : {imu(), watched()}) {
    Feed feed(limits);
    feed({1000, 1030, 1030});
    EXPECT_EQ(feed.log().refused, (Refused{{1030, RejectReason::REPEATED}}));
    feed({980});
    EXPECT_EQ(feed.log().refused.size(), 1u) << "it may be the first after a reset";
    feed({1040});
    EXPECT_EQ(feed.log().refused.back(), std::make_pair(TimeNs{980}, RejectReason::LATE));
    EXPECT_EQ(feed.log().taken, (Stamps{1000, 1030, 1040}));
  }
}

TEST(TimestampFilter, ReportsLateOnesAtOnce) {
  TimestampFilter<Message> rule;
  const auto is_late = [&rule](TimeNs stamp_ns) { return rule.add({stamp_ns}, imu()).late; };
  for (const TimeNs stamp_ns : {1000, 1010, 1010, 90'000, 90'010, 90'010}) EXPECT_FALSE(is_late(stamp_ns)) << stamp_ns;
  EXPECT_TRUE(is_late(90'005)) << "of those that are held";
  EXPECT_TRUE(is_late(1005));
  EXPECT_FALSE(is_late(1020));
  EXPECT_FALSE(is_late(0)) << "far";
}

TEST(TimestampFilter, AStrayStampCostsOneMessageAlone) {
  for (const TimeNs stray_ns : {TimeNs{90'000}, TimeNs{1'100}, TimeNs{0}}) {
    Feed feed(imu());
    feed({1000, 1010, stray_ns, 1020, 1030});
    EXPECT_EQ(feed.log().taken, (Stamps{1000, 1010, 1020, 1030}));
    EXPECT_EQ(feed.log().refused, (Refused{{stray_ns, RejectReason::FAR}}));
    EXPECT_TRUE(feed.log().resets.empty());
  }
}

TEST(TimestampFilter, ImuBelievesFiveFarOnesInARow) {
  for (const TimeNs first_ns : {TimeNs{90'000}, TimeNs{0}}) {
    Feed feed(imu());
    feed({1000, 1010}).steps(first_ns, 10, 4);
    EXPECT_EQ(feed.log().taken, (Stamps{1000, 1010}));
    feed.steps(first_ns + 40, 10, 1);
    const Resets back = {{1010, first_ns}};
    EXPECT_EQ(feed.log().resets, first_ns < 1000 ? back : Resets{}) << "one that was silent was not set back";
    EXPECT_EQ(feed.log().taken.size(), first_ns < 1000 ? 5u : 7u);
    EXPECT_TRUE(feed.log().refused.empty());
  }
}

TEST(TimestampFilter, FarOnesHaveToAgreeWithEachOther) {
  Feed feed(imu());
  feed({1000}).steps(90'000, 10, 4)({90'030 + kGap + 1}).steps(95'000, 10, 4)({1010});
  EXPECT_EQ(feed.log().taken, (Stamps{1000, 1010}));
  EXPECT_EQ(feed.log().refused.size(), 9u);
  for (const auto& [stamp_ns, why] : feed.log().refused) EXPECT_EQ(why, RejectReason::FAR) << stamp_ns;
}

TEST(TimestampFilter, RepeatsAndLateOnesAmongTheFarOnesAreRefusedAlone) {
  Feed feed(imu());
  feed({1000, 90'000, 90'000, 90'010, 90'005, 90'020, 90'020, 90'030, 90'040});
  EXPECT_EQ(feed.log().taken, (Stamps{1000, 90'000, 90'010, 90'020, 90'030, 90'040}));
  EXPECT_EQ(
      feed.log().refused,
      (Refused{{90'000, RejectReason::REPEATED}, {90'005, RejectReason::LATE}, {90'020, RejectReason::REPEATED}}));
}

TEST(TimestampFilter, ImuBelievesTenLateOnesInOrder) {
  Feed feed(imu());
  feed({1000}).steps(700, 10, 5)({720}).steps(730, 10, 8);
  EXPECT_TRUE(feed.log().resets.empty()) << "the sixth was not in order";
  feed({810});
  EXPECT_EQ(feed.log().resets, (Resets{{1000, 720}}));
  EXPECT_EQ(feed.log().taken.size(), 10u);
  EXPECT_EQ(feed.log().refused.size(), 5u);
}

TEST(TimestampFilter, ImuTakesTheLateOnesWithAHoleAmongThem) {
  Feed feed(imu());
  feed({1000}).steps(700, 10, 9)({780 + kGap + 1});
  EXPECT_EQ(feed.log().resets, (Resets{{1000, 700}}));
  EXPECT_EQ(feed.log().taken.back(), 780 + kGap + 1);
  EXPECT_EQ(feed.log().taken.size(), 10u);
}

TEST(TimestampFilter, ImuSetBackByLittleMoreThanTheLimitIsLate) {
  // The first is far; those after it fit again, if late, which refutes it.
  Feed feed(imu());
  feed({1000}).steps(1000 - kJump - 5, 10, 10);
  EXPECT_EQ(feed.log().refused, (Refused{{1000 - kJump - 5, RejectReason::FAR}}));
  EXPECT_TRUE(feed.log().resets.empty());
  feed({1000 - kJump + 95});
  EXPECT_EQ(feed.log().resets, (Resets{{1000, 1000 - kJump + 5}}));
  EXPECT_EQ(feed.log().taken.size(), 10u);
}

TEST(TimestampFilter, ImuGivesTheNewestBackWhenItCameBeforeOlderOnes) {
  for (const TimeNs ahead_ns : {10, 11, 19, 20, 25, 40}) {
    Feed feed(imu());
    feed.steps(1000, 10, 20)({1200 + ahead_ns});
    EXPECT_EQ(feed.log().taken.back(), 1200 + ahead_ns);
    feed.steps(1210, 10, 10);
    EXPECT_EQ(feed.log().taken.size(), 30u) << ahead_ns;
    const RejectReason why = ahead_ns == 10 ? RejectReason::REPEATED : RejectReason::AHEAD;
    EXPECT_EQ(feed.log().refused, (Refused{{1200 + ahead_ns, why}}));
  }
  Feed feed(imu());
  feed.steps(1000, 10, 20)({1230, 960, 1210, 1220});
  EXPECT_EQ(feed.log().refused, (Refused{{960, RejectReason::LATE}, {1230, RejectReason::AHEAD}}))
      << "one late from elsewhere";
  EXPECT_EQ(feed.log().taken.back(), 1220);
}

TEST(TimestampFilter, ImuKeepsTheNewestThatCameInOrder) {
  Feed feed(imu());
  feed.steps(1000, 10, 20)({1185, 1190, 1200, 1214, 1210});
  EXPECT_EQ(feed.log().refused, (Refused{{1190, RejectReason::REPEATED}, {1185, RejectReason::LATE}}))
      << "1210 is held";
  EXPECT_EQ(feed.log().taken.back(), 1214);
}

TEST(TimestampFilter, ImuThatCatchesUpWithinAGapIsNotReset) {
  Feed feed(imu());
  feed.steps(1000, 1, 100).steps(1099 - kGap, 1, 60);
  EXPECT_TRUE(feed.log().resets.empty());
  EXPECT_EQ(feed.log().taken.size(), 109u);
  feed.steps(1108 - kGap - 1, 1, 10);
  EXPECT_EQ(feed.log().resets.size(), 1u);
}

TEST(TimestampFilter, AStrayStampDoesNotHideAReset) {
  Feed feed(imu());
  feed({1000}).steps(700, 10, 5)({90'000, 0}).steps(750, 10, 5);
  EXPECT_EQ(feed.log().resets, (Resets{{1000, 700}}));
  EXPECT_EQ(feed.log().taken.size(), 10u);
}

TEST(TimestampFilter, WatchedStreamIsResetAtOnce) {
  Feed feed(watched());
  feed({1000, 1000 - kJump});
  EXPECT_TRUE(feed.log().resets.empty());
  feed({1000 - kJump - 1});
  EXPECT_EQ(feed.log().resets, (Resets{{1000, 1000 - kJump - 1}}));
  EXPECT_EQ(feed.log().taken, (Stamps{1000 - kJump - 1}));
}

TEST(TimestampFilter, WatchedStreamIsBelievedAheadByItsSecondMessage) {
  Feed feed(watched());
  feed({1000, 90'000, 1010});
  EXPECT_EQ(feed.log().taken, (Stamps{1000, 1010}));
  feed({90'000, 90'000});
  EXPECT_EQ(feed.log().taken, (Stamps{1000, 1010, 90'000})) << "the repeat is refused, but agrees";
  EXPECT_TRUE(feed.log().resets.empty());
}

TEST(TimestampFilter, SlowStreamIsOneMessageBehindAndCannotBeLedAstray) {
  Feed feed(watched());
  feed({0, 1000, 2000, 3000});
  EXPECT_EQ(feed.log().taken, (Stamps{0, 1000, 2000}));
  feed({90'000, 4000, 5000, 6000});
  EXPECT_EQ(feed.log().taken, (Stamps{0, 1000, 2000, 3000, 4000, 5000}));
  EXPECT_TRUE(feed.log().resets.empty());
}

TEST(TimestampFilter, WatchedStreamKeepsToWhatIsAheadWhereThatOverlaps) {
  Feed feed(watched());
  feed({1000, 1000 + kJump + 100, 1000 + kJump - 50});
  EXPECT_EQ(feed.log().taken, (Stamps{1000, 1000 + kJump + 100})) << "the third agrees with the second";
  feed({1000 + kJump + 200, 90'000, 90'000, 90'000 - kJump});
  EXPECT_EQ(feed.log().taken.back(), 90'000);
  EXPECT_TRUE(feed.log().resets.empty()) << "the late one from before says nothing";
}

TEST(TimestampFilter, RestartForgetsWhatCameBefore) {
  Feed feed(watched());
  feed({1000, 90'000});
  feed.rule().restart({10});
  EXPECT_EQ(feed.rule().newest_ns(), 10);
  EXPECT_TRUE(feed.rule().add({20}, watched()).refused.empty());
  EXPECT_EQ(feed.rule().newest_ns(), 20);
}

}  // namespace
}  // namespace gyro_deblur::timestamp_filter_test
