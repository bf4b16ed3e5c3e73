#include "inverse/expected_errors.hpp"

#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "inverse/filter_bank.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::expected_errors_test {
namespace {

constexpr double kNoiseToSignalRatio = 0.01;

struct Left {
  double texture = 0, noise = 0;  ///< of a texture of c = 1 and noise of v = 1
};

/// By summing the taps of the kernel itself.
Left left_by(double extent_px, int doublings) {
  const FilterBank bank{FilterOptions{kNoiseToSignalRatio, 8}};
  const LineKernel& kernel = bank.kernel(extent_px, doublings);
  Left left;
  for (const float tap : kernel.taps) left.noise += tap * tap;
  const int steps = 4000;
  for (int i = 0; i < steps; ++i) {
    const double f = 0.5 * (i + 0.5) / steps;
    double w = 0;
    for (int k = 0; k < static_cast<int>(kernel.taps.size()); ++k) {
      w += kernel.taps[k] * std::cos(2 * CV_PI * f * (k - kernel.radius()));
    }
    const double lost = 1 - w * test::sinc(CV_PI * extent_px * f);
    left.texture += lost * lost / (f * f) / steps;
  }
  return left;
}

TEST(ExpectedErrors, AreThoseOfTheKernels) {
  const ExpectedErrors errors(kNoiseToSignalRatio);
  for (const double extent_px : {4.0, 16.0, 45.25}) {
    for (const double noise_to_texture : {0.01, 1.0, 100.0}) {
      const FilterChoice choice = errors.least(extent_px, noise_to_texture);
      const Left chosen = left_by(extent_px, choice.ratio_doublings);
      double blurred = 0;
      for (int i = 0; i < 4000; ++i) {
        const double f = 0.5 * (i + 0.5) / 4000, lost = 1 - test::sinc(CV_PI * extent_px * f);
        blurred += lost * lost / (f * f) / 4000;
      }
      EXPECT_NEAR(choice.gain, 1 - (chosen.texture + noise_to_texture * std::max(0.0, chosen.noise - 1)) / blurred,
                  0.05)
          << extent_px << ' ' << noise_to_texture;
      // Expected is that of the whole inverse; what the taps leave out of a short one has up to a fifth of its noise.
      EXPECT_GT(choice.noise_gain, 0.95 * chosen.noise) << extent_px << ' ' << noise_to_texture;
      EXPECT_LT(choice.noise_gain, 1.25 * chosen.noise) << extent_px << ' ' << noise_to_texture;
      // No other noise-to-signal ratio is better by more than what the taps' limited number makes.
      for (int doublings = 0; doublings <= 7; ++doublings) {
        const Left other = left_by(extent_px, doublings);
        EXPECT_LT(chosen.texture + noise_to_texture * chosen.noise,
                  1.03 * (other.texture + noise_to_texture * other.noise))
            << extent_px << ' ' << doublings;
      }
    }
  }
}

TEST(ExpectedErrors, AskForMoreRegularizationTheMoreNoiseThereIs) {
  const ExpectedErrors errors(kNoiseToSignalRatio);
  for (const double extent_px : {1.0, 3.0, 10.0, 33.3, 150.0, 500.0}) {
    EXPECT_EQ(errors.least(extent_px, 0).ratio_doublings, 0);
    int doublings = 0;
    for (double noise_to_texture = 1e-4; noise_to_texture < 1e5; noise_to_texture *= 2) {
      const FilterChoice choice = errors.least(extent_px, noise_to_texture);
      EXPECT_GE(choice.ratio_doublings, doublings) << extent_px;
      EXPECT_LE(choice.gain, 1) << extent_px;
      doublings = choice.ratio_doublings;
    }
    EXPECT_GT(doublings, 3) << extent_px;
  }
}

TEST(ExpectedErrors, SayWhereAFilterDoesHarm) {
  const ExpectedErrors errors(kNoiseToSignalRatio);
  // What is left of 3 px of blur for a filter to find is all noise.
  EXPECT_LT(errors.least(3, 100).gain, -0.3);
  EXPECT_GT(errors.least(3, 0.1).gain, 0.5);
  EXPECT_GT(errors.least(40, 0.1).gain, 0.5);
}

TEST(ExpectedErrors, EndAtTheLargestNoiseToSignalRatio) {
  for (const double ratio : {1e-5, 0.3, 0.5, 1.0}) {
    const FilterChoice choice = ExpectedErrors(ratio).least(10, 1e6);
    EXPECT_GE(std::ldexp(ratio, choice.ratio_doublings), 0.5) << ratio;
    EXPECT_LT(std::ldexp(ratio, choice.ratio_doublings), 2) << ratio;
  }
}

}  // namespace
}  // namespace gyro_deblur::expected_errors_test
