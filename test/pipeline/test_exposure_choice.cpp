// Which exposure time an image is deblurred by: given, from the images, or not known.
#include "pipeline/exposure_choice.hpp"

#include <cmath>
#include <optional>

#include <gtest/gtest.h>

namespace gyro_deblur::exposure_choice_test {
namespace {

constexpr TimeNs kMs = 1'000'000, kPeriod = 50 * kMs;
constexpr double kBrightness = 120;
constexpr double kStddev = 0.01;

/// A camera whose exposure is estimated without error, where they are looked at and it is within reach.
class Choice : public testing::Test {
 protected:
  /// One image.
  ChosenExposure image(TimeNs true_ns, const std::optional<GivenExposure>& given) {
    const ExposurePlan plan = choice_.plan(given, kPeriod);
    std::optional<ExposureEstimate> estimate;
    const double ratio = static_cast<double>(true_ns) / static_cast<double>(plan.exposure_ns);
    if (tells_ && plan.estimate && ratio > kMinExposureRatio && ratio < kMaxExposureRatio) {
      estimate = ExposureEstimate{ratio, kStddev};
    }
    EXPECT_GE(plan.longest_ns, plan.exposure_ns);
    const ChosenExposure chosen = choice_.decide(stamp_ns_, plan, estimate, kBrightness);
    stamp_ns_ += kPeriod;
    return chosen;
  }
  /// Images of so many seconds; the last one's.
  ChosenExposure images(double seconds, TimeNs true_ns, const std::optional<GivenExposure>& given) {
    ChosenExposure chosen;
    const auto count = std::lround(seconds * 1e9 / static_cast<double>(kPeriod));
    for (long i = 0; i < count; ++i) chosen = image(true_ns, given);
    return chosen;
  }
  static GivenExposure parameter(TimeNs exposure_ns) { return {ExposureOrigin::PARAMETER, exposure_ns}; }
  static GivenExposure message(TimeNs exposure_ns) { return {ExposureOrigin::MESSAGE, exposure_ns}; }
  static void expect_near(const ChosenExposure& chosen, ExposureOrigin origin, TimeNs exposure_ns) {
    EXPECT_STREQ(to_string(chosen.origin), to_string(origin));
    EXPECT_NEAR(static_cast<double>(chosen.exposure_ns), static_cast<double>(exposure_ns),
                0.01 * static_cast<double>(exposure_ns));
  }

  ExposureChoice choice_;
  TimeNs stamp_ns_ = 1'000'000'000;
  bool tells_ = true;
};

TEST_F(Choice, WhatIsNotKnownStaysSoUntilItIsEstimated) {
  tells_ = false;
  EXPECT_EQ(images(2, 20 * kMs, {}).origin, ExposureOrigin::ASSUMED);
  tells_ = true;
  expect_near(images(1, 20 * kMs, {}), ExposureOrigin::IMAGES, 20 * kMs);
  tells_ = false;
  expect_near(images(5, 20 * kMs, {}), ExposureOrigin::IMAGES, 20 * kMs);
  EXPECT_FALSE(choice_.conflict());
}

TEST_F(Choice, AssumptionsReachFromAFewMillisecondsToTheFramePeriod) {
  for (const TimeNs true_ns : {3500 * TimeNs{1000}, 8 * kMs, 20 * kMs, 33 * kMs, 48 * kMs}) {
    choice_.reset();
    expect_near(images(2, true_ns, {}), ExposureOrigin::IMAGES, true_ns);
  }
  ExposureChoice fresh;
  EXPECT_LE(fresh.plan({}, kPeriod).longest_ns, kPeriod);
  EXPECT_LE(fresh.plan({}, 5 * kMs).exposure_ns, 5 * kMs);
}

TEST_F(Choice, GivenValuesThatAgreeAreKept) {
  // An estimate is a few percent off at times.
  for (const GivenExposure& given : {parameter(19 * kMs), message(21 * kMs), message(20 * kMs)}) {
    choice_.reset();
    const ChosenExposure chosen = images(10, 20 * kMs, given);
    EXPECT_EQ(chosen.origin, given.origin);
    EXPECT_EQ(chosen.exposure_ns, given.exposure_ns);
    EXPECT_FALSE(choice_.conflict());
  }
}

TEST_F(Choice, AWrongParameterIsReplacedAfterSeconds) {
  for (const double factor : {0.05, 0.5, 0.8, 1.22, 2.0}) {
    choice_.reset();
    const TimeNs given_ns = std::llround(20e6 * factor);
    EXPECT_EQ(images(1.5, 20 * kMs, parameter(given_ns)).exposure_ns, given_ns) << factor;
    EXPECT_FALSE(choice_.conflict()) << factor;
    expect_near(images(2.5, 20 * kMs, parameter(given_ns)), ExposureOrigin::IMAGES, 20 * kMs);
    ASSERT_TRUE(choice_.conflict()) << factor;
    EXPECT_TRUE(choice_.conflict()->replaced);
    EXPECT_EQ(choice_.conflict()->given.exposure_ns, given_ns);
    EXPECT_NEAR(choice_.conflict()->ratio(), 1 / factor, 0.01 / factor);
    // Another value is another matter.
    EXPECT_EQ(image(20 * kMs, parameter(given_ns + 1)).origin, ExposureOrigin::PARAMETER);
    EXPECT_FALSE(choice_.conflict());
  }
}

TEST_F(Choice, ConfiguredKeepsAWrongParameter) {
  choice_.set_policy(OnExposureConflict::CONFIGURED);
  const ChosenExposure chosen = images(4, 20 * kMs, parameter(10 * kMs));
  EXPECT_EQ(chosen.origin, ExposureOrigin::PARAMETER);
  EXPECT_EQ(chosen.exposure_ns, 10 * kMs);
  ASSERT_TRUE(choice_.conflict());
  EXPECT_FALSE(choice_.conflict()->replaced);
  EXPECT_NEAR(choice_.conflict()->ratio(), 2, 0.02);
}

TEST_F(Choice, AMessageThatChangesIsComparedImageByImageAndKept) {
  std::optional<ExposureConflict> conflict;
  for (int i = 0; i < 80; ++i) {
    const TimeNs true_ns = (10 + i % 20) * kMs, told_ns = true_ns / 2;
    const ChosenExposure chosen = image(true_ns, message(told_ns));
    EXPECT_EQ(chosen.origin, ExposureOrigin::MESSAGE);
    EXPECT_EQ(chosen.exposure_ns, told_ns);
    conflict = choice_.conflict();
    if (i < 40) {
      EXPECT_FALSE(conflict) << i;
    }
  }
  ASSERT_TRUE(conflict);
  EXPECT_FALSE(conflict->replaced);
  EXPECT_NEAR(conflict->ratio(), 2, 0.02);
  images(4, 20 * kMs, message(20 * kMs));
  EXPECT_FALSE(choice_.conflict()) << "the driver was corrected";
}

TEST_F(Choice, AFewEstimatesAreNoContradiction) {
  images(0.1, 20 * kMs, parameter(10 * kMs));
  tells_ = false;
  EXPECT_EQ(images(5, 20 * kMs, parameter(10 * kMs)).exposure_ns, 10 * kMs);
  EXPECT_FALSE(choice_.conflict());
}

TEST_F(Choice, AParameterCorrectedInTheSceneIsNoLongerContradicted) {
  images(4, 20 * kMs, parameter(10 * kMs));
  ASSERT_TRUE(choice_.conflict());
  const ChosenExposure chosen = images(4, 10 * kMs, parameter(10 * kMs));  // the camera has changed its exposure
  EXPECT_FALSE(choice_.conflict());
  EXPECT_EQ(chosen.origin, ExposureOrigin::PARAMETER);
}

// An image that shows a picture again goes by what was found for the picture.
TEST_F(Choice, WhatIsSettledStaysAndCountsOnce) {
  images(1, 20 * kMs, {});
  ExposurePlan plan = choice_.plan({}, kPeriod);
  plan.origin = ExposureOrigin::ASSUMED;
  plan.exposure_ns = 7 * kMs;
  plan.decided = true;
  const ChosenExposure chosen = choice_.decide(stamp_ns_, plan, ExposureEstimate{2.5, kStddev}, kBrightness);
  EXPECT_EQ(chosen.origin, ExposureOrigin::ASSUMED);
  EXPECT_EQ(chosen.exposure_ns, 7 * kMs);
  expect_near(image(20 * kMs, {}), ExposureOrigin::IMAGES, 20 * kMs);
}

TEST_F(Choice, AnImageThatComesLateChangesNothing) {
  for (const std::optional<GivenExposure>& given :
       {std::optional<GivenExposure>(), std::optional(parameter(12 * kMs))}) {
    choice_.reset();
    expect_near(images(5, 20 * kMs, given), ExposureOrigin::IMAGES, 20 * kMs);
    stamp_ns_ -= 3 * kPeriod;
    expect_near(image(20 * kMs, given), ExposureOrigin::IMAGES, 20 * kMs);
    stamp_ns_ += 2 * kPeriod;
    tells_ = false;
    expect_near(image(20 * kMs, given), ExposureOrigin::IMAGES, 20 * kMs);
    tells_ = true;
  }
}

TEST_F(Choice, ResetForgetsButKeepsThePolicy) {
  choice_.set_policy(OnExposureConflict::CONFIGURED);
  images(4, 20 * kMs, parameter(10 * kMs));
  choice_.reset();
  EXPECT_FALSE(choice_.conflict());
  EXPECT_EQ(choice_.plan({}, kPeriod).origin, ExposureOrigin::ASSUMED);
  EXPECT_EQ(images(4, 20 * kMs, parameter(10 * kMs)).exposure_ns, 10 * kMs);
}

}  // namespace
}  // namespace gyro_deblur::exposure_choice_test
