#include "blur/exposure_advice.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::exposure_advice_test {
namespace {

constexpr TimeNs kMs = 1'000'000, kSecond = 1000 * kMs;

/// Of an image that was exposed for 10 ms.
ExposureTerms terms_of(double speed_px_s, double noise_to_contrast) {
  ExposureTerms terms;
  terms.speed_px_s = speed_px_s;
  terms.exposure_ns = 10 * kMs;
  terms.noise_to_contrast = noise_to_contrast;
  return terms;
}

TEST(ExpectedRepeatabilityAt, IsThatOfBlurThatGrowsAndNoiseThatFalls) {
  ExposureTerms terms = terms_of(500, 0.04);
  BlockBlur block;
  block.extent_px = 1;
  EXPECT_NEAR(expected_repeatability_at(terms, 2 * kMs), *expected_repeatability(block, 0.04 * std::sqrt(5)), 1e-6);
  block.extent_px = 20;
  block.status = BlockStatus::DEBLURRED;
  EXPECT_NEAR(expected_repeatability_at(terms, 40 * kMs), *expected_repeatability(block, 0.02), 1e-6);
  terms.noise = {0, 1, 0};
  EXPECT_NEAR(expected_repeatability_at(terms, 40 * kMs), *expected_repeatability(block, 0.01), 1e-6);
  terms.noise = {0, 0, 1};
  EXPECT_NEAR(expected_repeatability_at(terms, 40 * kMs), *expected_repeatability(block, 0.04), 1e-6);
  terms.noise = {0.5, 0.3, 0.2};
  EXPECT_NEAR(expected_repeatability_at(terms, 40 * kMs),
              *expected_repeatability(block, 0.04 * std::sqrt(0.5 / 4 + 0.3 / 16 + 0.2)), 1e-6);
  terms.blur_field.max_extent_px = 19;
  block.status = BlockStatus::TOO_LARGE;
  EXPECT_NEAR(expected_repeatability_at(terms, 40 * kMs),
              *expected_repeatability(block, 0.04 * std::sqrt(0.5 / 4 + 0.3 / 16 + 0.2)), 1e-6);
}

TEST(AdviseExposure, LosesAQuarterOfTheMostCornersAndNoMoreBeforeIt) {
  const ExposureTerms terms = terms_of(700, 0.05);
  const auto advice = advise_exposure(terms, kSecond);
  ASSERT_TRUE(advice);
  EXPECT_NEAR(expected_repeatability_at(terms, advice->longest_ns), 0.75 * advice->best_share, 1e-6);
  for (TimeNs exposure_ns = kMs / 10; exposure_ns < kSecond; exposure_ns += kMs / 10) {
    EXPECT_LE(expected_repeatability_at(terms, exposure_ns), 1.0001 * advice->best_share) << exposure_ns;
    if (exposure_ns > advice->longest_ns) {
      EXPECT_LT(expected_repeatability_at(terms, exposure_ns), 0.75 * advice->best_share) << exposure_ns;
    }
  }
  EXPECT_EQ(expected_repeatability_at(terms, advice->best_ns), advice->best_share);
}

// Without noise the least blur is best, and a deblurred block has .79 / (1 + e / 54) of its corners, an unblurred .963.
TEST(AdviseExposure, IsKnownInClosedFormWithoutNoise) {
  const double extent_px = 54 * (0.79 / (0.75 * 0.963) - 1);
  for (const double speed_px_s : {20.0, 300.0, 1000.0}) {
    const auto advice = advise_exposure(terms_of(speed_px_s, 1e-6), kSecond);
    ASSERT_TRUE(advice);
    EXPECT_NEAR(to_seconds(advice->longest_ns), extent_px / speed_px_s, 0.002 * extent_px / speed_px_s) << speed_px_s;
  }
}

// Blur and noise are the same functions of exposure times speed where noise^2 times speed is the same (photons), or
// noise times speed (reading).
TEST(AdviseExposure, ScalesWithSpeedAndNoiseAsTheModelDoes) {
  ExposureTerms slow = terms_of(200, 0.06), fast = terms_of(800, 0.03);
  EXPECT_NEAR(to_seconds(advise_exposure(slow, kSecond)->longest_ns),
              4 * to_seconds(advise_exposure(fast, kSecond)->longest_ns), 1e-4);
  slow.noise = fast.noise = {0, 1, 0};
  fast.noise_to_contrast = 0.015;
  EXPECT_NEAR(to_seconds(advise_exposure(slow, kSecond)->longest_ns),
              4 * to_seconds(advise_exposure(fast, kSecond)->longest_ns), 1e-4);
}

TEST(AdviseExposure, IsTheSameWhateverTheExposureThatNoiseIsKnownOf) {
  ExposureTerms other = terms_of(400, 0.08 / 2);
  other.exposure_ns = 40 * kMs;
  EXPECT_NEAR(to_seconds(advise_exposure(terms_of(400, 0.08), kSecond)->longest_ns),
              to_seconds(advise_exposure(other, kSecond)->longest_ns), 1e-6);
}

TEST(AdviseExposure, IsShorterTheFasterAndLongerTheNoisier) {
  constexpr TimeNs kMinute = 60 * kSecond;  // no limit
  for (const NoiseShares noise : {NoiseShares{1, 0, 0}, NoiseShares{0, 1, 0}, NoiseShares{0.5, 0.5, 0}}) {
    TimeNs of_less_noise[20] = {};
    for (const double noise_to_contrast : {0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32}) {
      TimeNs slower_ns = kMinute;
      int i = 0;
      for (double speed_px_s = 50; speed_px_s < 6000; speed_px_s *= 1.4, ++i) {
        ExposureTerms terms = terms_of(speed_px_s, noise_to_contrast);
        terms.noise = noise;
        const auto advice = advise_exposure(terms, kMinute);
        if (!advice) continue;
        EXPECT_LT(advice->longest_ns, slower_ns) << speed_px_s << " px/s, noise " << noise_to_contrast;
        slower_ns = advice->longest_ns;
        if (speed_px_s * to_seconds(advice->longest_ns) > 0.99 * terms.blur_field.max_extent_px) continue;
        EXPECT_GT(advice->longest_ns, of_less_noise[i]) << speed_px_s << " px/s, noise " << noise_to_contrast;
        of_less_noise[i] = advice->longest_ns;
      }
    }
  }
}

TEST(AdviseExposure, StaysWithinTheLimitAndMaxExtent) {
  EXPECT_EQ(advise_exposure(terms_of(0, 0.05), 50 * kMs)->longest_ns, 50 * kMs) << "the camera stands still";
  EXPECT_EQ(advise_exposure(terms_of(0, 0.05), 50 * kMs)->best_ns, 50 * kMs);
  EXPECT_EQ(advise_exposure(terms_of(100, 0.1), 20 * kMs)->longest_ns, 20 * kMs);
  ExposureTerms terms = terms_of(500, 0.1);
  const TimeNs free_ns = advise_exposure(terms, kSecond)->longest_ns;
  ASSERT_GT(500 * to_seconds(free_ns), 10);
  terms.blur_field.max_extent_px = 10;
  EXPECT_NEAR(500 * to_seconds(advise_exposure(terms, kSecond)->longest_ns), 10, 0.01);
}

TEST(AdviseExposure, SaysNothingWhereEveryExposureIsPoor) {
  EXPECT_TRUE(advise_exposure(terms_of(1000, 0.3), kSecond));
  EXPECT_FALSE(advise_exposure(terms_of(5000, 1), kSecond));
  EXPECT_FALSE(advise_exposure(terms_of(1000, 0.3), kMs / 100)) << "too dark within the limit";
}

TEST(ExposureTerms, AreThoseOfTheField) {
  FrameBlur field = uniform_blur_field(640, 256, 0, 12, {});
  field.exposure_ns = 20 * kMs;
  EXPECT_FALSE(exposure_terms(field, assess_quality(field), {})) << "noise and contrast are not known";
  field.noise = 3;
  field.contrast = 5;
  const auto terms = exposure_terms(field, assess_quality(field), {});
  ASSERT_TRUE(terms);
  EXPECT_NEAR(terms->speed_px_s, 600, 1e-3);
  EXPECT_EQ(terms->exposure_ns, 20 * kMs);
  EXPECT_NEAR(terms->noise_to_contrast, 0.75, 1e-9);
  EXPECT_EQ(terms->noise.photons, 1);
  for (BlockBlur& block : field.blocks) block.status = BlockStatus::NO_GYRO;
  EXPECT_FALSE(exposure_terms(field, assess_quality(field), {})) << "the motion is not known";
}

}  // namespace
}  // namespace gyro_deblur::exposure_advice_test
