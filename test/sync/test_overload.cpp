#include "sync/overload.hpp"

#include <optional>
#include <string>

#include <gtest/gtest.h>

namespace gyro_deblur::overload_test {
namespace {

constexpr TimeNs kMs = 1'000'000, kPeriod = 33 * kMs;

OverloadRule rule_after(int frames, TimeNs takes_ns) {
  OverloadRule rule;
  for (int i = 0; i < frames; ++i) {
    rule.begin(i * takes_ns, true);
    rule.end((i + 1) * takes_ns);
  }
  return rule;
}

TEST(OverloadRule, PassesThroughWhatWaitsTooLongBehindSlowProcessing) {
  const OverloadRule rule = rule_after(5, 100 * kMs);
  const std::string text = rule.pass_through_text(kPeriod * 3, 0, 2, kPeriod);
  EXPECT_NE(text.find("processing (0.100000000 s a frame) is slower than the camera"), std::string::npos) << text;
  EXPECT_EQ(rule.pass_through_text(kPeriod * 3, 0, 1, kPeriod), "") << "one of the newest two";
  EXPECT_EQ(rule.pass_through_text(kPeriod * 2, 0, 5, kPeriod), "") << "as long as a queue of two explains";
  EXPECT_EQ(rule.pass_through_text(kPeriod * 3, 0, 2, std::nullopt), "") << "nobody knows the camera's rate";
  EXPECT_EQ(rule.pass_through_text(0, 0, 20, kPeriod), "") << "a clock that stands still";
}

TEST(OverloadRule, FastProcessingWorksABurstOff) {
  EXPECT_EQ(rule_after(5, kPeriod / 2).pass_through_text(kPeriod * 10, 0, 20, kPeriod), "");
  EXPECT_NE(rule_after(5, kPeriod * 2 / 3).pass_through_text(kPeriod * 10, 0, 20, kPeriod), "");
}

TEST(OverloadRule, OneSlowFrameIsNoOverload) {
  OverloadRule rule = rule_after(1, 500 * kMs);
  EXPECT_EQ(rule.pass_through_text(kPeriod * 10, 0, 5, kPeriod), "") << "the first";
  rule = rule_after(4, 5 * kMs);
  rule.begin(0, true);
  rule.end(500 * kMs);
  EXPECT_EQ(rule.pass_through_text(kPeriod * 10, 0, 5, kPeriod), "");
}

TEST(OverloadRule, TimeWithoutWorkIsNotProcessing) {
  OverloadRule rule = rule_after(5, 5 * kMs);
  for (int i = 1; i < 10; ++i) rule.end(i * 1000 * kMs);
  EXPECT_EQ(rule.pass_through_text(kPeriod * 10, 0, 5, kPeriod), "");
}

TEST(OverloadRule, WaitingForAStereoPartnerIsNotProcessing) {
  OverloadRule rule;
  for (int i = 0; i < 5; ++i) {
    const TimeNs begin_ns = i * 1000 * kMs;
    rule.begin(begin_ns, true);
    for (const int ms : {2, 80}) {
      rule.pause(begin_ns + ms * kMs);
      rule.resume(begin_ns + 10 * ms * kMs);
    }
    rule.end(begin_ns + 805 * kMs);
  }
  EXPECT_EQ(rule.pass_through_text(kPeriod * 10, 0, 5, 140 * kMs), "");
  EXPECT_NE(rule.pass_through_text(kPeriod * 10, 0, 5, 120 * kMs), "") << "2 + 60 + 5 ms of work";
}

TEST(OverloadRule, FramesThatHaveTimeMayTakeIt) {
  OverloadRule rule;
  for (int i = 0; i < 5; ++i) {
    rule.begin(i * 100 * kMs, false);
    rule.end((i + 1) * 100 * kMs);
  }
  EXPECT_EQ(rule.pass_through_text(kPeriod * 10, 0, 5, kPeriod), "");
}

TEST(OverloadRule, SlownessThatIsOverIsForgotten) {
  OverloadRule rule = rule_after(5, 100 * kMs);
  for (int i = 0; i < 3; ++i) {
    rule.begin(i * kPeriod, false);
    rule.end(i * kPeriod + 5 * kMs);
  }
  EXPECT_EQ(rule.pass_through_text(kPeriod * 10, 0, 5, kPeriod), "");
}

TEST(OverloadRule, AFrameIsBehindTheRateBeforeAnyIsPassedThrough) {
  EXPECT_TRUE(OverloadRule::is_behind_camera_rate(kPeriod + 1, 0, 1, kPeriod));
  EXPECT_FALSE(OverloadRule::is_behind_camera_rate(kPeriod, 0, 1, kPeriod)) << "as long as the frame before explains";
  EXPECT_FALSE(OverloadRule::is_behind_camera_rate(kPeriod * 5, 0, 0, kPeriod)) << "the newest";
  EXPECT_FALSE(OverloadRule::is_behind_camera_rate(kPeriod * 5, 0, 5, std::nullopt))
      << "nobody knows the camera's rate";
}

}  // namespace
}  // namespace gyro_deblur::overload_test
