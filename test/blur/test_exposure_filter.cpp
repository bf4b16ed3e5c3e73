#include "blur/exposure_filter.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "base/median.hpp"

namespace gyro_deblur::exposure_filter_test {
namespace {

constexpr TimeNs kFrameNs = 50'000'000;
constexpr double kMs = 1e6, kBright = 120;

/// A camera whose exposure is estimated to a few percent.
class Camera {
 public:
  explicit Camera(double stddev, std::uint64_t seed = 1) : stddev_(stddev), rng_(seed) {}

  /// One frame more. @param assumed_ns  0: what the filter says, or the truth where it says nothing
  void expose(ExposureFilter* filter, double exposure_ns, double assumed_ns = 0, double brightness = kBright,
              bool blurred = true) {
    t_ns_ += kFrameNs;
    const auto state = filter->state();
    if (assumed_ns == 0) assumed_ns = state ? static_cast<double>(state->exposure_ns) : exposure_ns;
    const bool looked = blurred && filter->wants_estimate();
    looked_ += looked ? 1 : 0;
    std::optional<ExposureEstimate> estimate;
    const double ratio = exposure_ns / assumed_ns * std::exp(rng_.gaussian(stddev_));
    if (looked && ratio >= kMinExposureRatio && ratio <= kMaxExposureRatio) estimate = {ratio, stddev_};
    filter->add(t_ns_, std::llround(assumed_ns), estimate, brightness);
  }
  TimeNs now_ns() const { return t_ns_; }
  int looked() const { return looked_; }

 private:
  double stddev_;
  cv::RNG rng_;
  TimeNs t_ns_ = 0;
  int looked_ = 0;
};

double error(const ExposureFilter& filter, double exposure_ns) {
  const auto state = filter.state();
  return state ? std::abs(std::log(static_cast<double>(state->exposure_ns) / exposure_ns)) : 10;
}

TEST(ExposureFilter, KnowsNothingBeforeAnEstimate) {
  ExposureFilter filter;
  EXPECT_FALSE(filter.state());
  EXPECT_TRUE(filter.wants_estimate());
  filter.add(kFrameNs, 10'000'000, std::nullopt, kBright);
  EXPECT_FALSE(filter.state());
  // One estimate alone may be an outlier.
  filter.add(2 * kFrameNs, 10'000'000, ExposureEstimate{2, 0.02}, kBright);
  EXPECT_FALSE(filter.state());
  filter.add(3 * kFrameNs, 20'000'000, ExposureEstimate{1.01, 0.02}, kBright);
  ASSERT_TRUE(filter.state());
  EXPECT_NEAR(static_cast<double>(filter.state()->exposure_ns), 20.1e6, 0.2e6);
  filter.reset();
  EXPECT_FALSE(filter.state());
}

TEST(ExposureFilter, FindsAConstantExposureFromWrongAssumptions) {
  for (const double assumption : {0.35, 0.6, 1.0, 1.6, 3.0}) {
    ExposureFilter filter;
    Camera camera(0.03);
    for (int i = 0; i < 20; ++i) camera.expose(&filter, 20 * kMs, filter.state() ? 0 : assumption * 20 * kMs);
    EXPECT_LT(error(filter, 20 * kMs), 0.03) << assumption;
    EXPECT_LT(filter.state()->log_stddev, 0.03) << assumption;
  }
}

TEST(ExposureFilter, SaysHonestlyHowWellItKnows) {
  // Errors over what was said, of many cameras at various times.
  std::vector<double> normalized;
  for (std::uint64_t seed = 1; seed <= 100; ++seed) {
    ExposureFilter filter;
    Camera camera(0.04, seed);
    for (int i = 0; i < 30; ++i) {
      camera.expose(&filter, 15 * kMs);
      if (i % 10 == 9) normalized.push_back(error(filter, 15 * kMs) / filter.state()->log_stddev);
    }
  }
  const auto within = [&](double limit) {
    const auto count = std::count_if(normalized.begin(), normalized.end(), [&](double n) { return n < limit; });
    return static_cast<double>(count) / static_cast<double>(normalized.size());
  };
  EXPECT_GT(within(1), 0.55);
  EXPECT_GT(within(3), 0.97);
}

TEST(ExposureFilter, FollowsAGlide) {
  // From 5 to 30 ms in 2 s.
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 20; ++i) camera.expose(&filter, 5 * kMs);
  std::vector<double> errors;
  for (int i = 1; i <= 40; ++i) {
    const double exposure_ns = 5 * kMs * std::pow(6, i / 40.0);
    camera.expose(&filter, exposure_ns);
    errors.push_back(error(filter, exposure_ns));
    // Before the next look it cannot be known.
    constexpr int kNextLook = 6;
    const auto state = filter.state();
    EXPECT_TRUE(i <= kNextLook || !state || errors.back() < 4 * state->log_stddev) << i;
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.04);
  for (int i = 0; i < 15; ++i) camera.expose(&filter, 30 * kMs);
  EXPECT_LT(error(filter, 30 * kMs), 0.03);
}

TEST(ExposureFilter, FollowsJumpsThatBrightnessShowsAtOnce) {
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 30; ++i) camera.expose(&filter, 10 * kMs);
  ASSERT_FALSE(filter.wants_estimate());  // sure
  camera.expose(&filter, 20 * kMs, 0, 1.6 * kBright);
  EXPECT_TRUE(filter.wants_estimate());
  EXPECT_GT(filter.state() ? filter.state()->log_stddev : 1, 0.1);
  for (int i = 0; i < 3; ++i) camera.expose(&filter, 20 * kMs, 0, 1.6 * kBright);
  EXPECT_LT(error(filter, 20 * kMs), 0.05);
}

TEST(ExposureFilter, FollowsJumpsThatNothingShowsWithinAFewLooks) {
  for (const double factor : {0.5, 2.0}) {
    ExposureFilter filter;
    Camera camera(0.02);
    for (int i = 0; i < 30; ++i) camera.expose(&filter, 10 * kMs);
    int frames = 0;
    while (error(filter, factor * 10 * kMs) > 0.05 && frames < 100) camera.expose(&filter, factor * 10 * kMs), ++frames;
    EXPECT_LE(frames, 12) << factor;
  }
}

TEST(ExposureFilter, FindsAJumpBetweenImagesWithoutBlurAsSoonAsThereIsSome) {
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 30; ++i) camera.expose(&filter, 30 * kMs);
  for (int i = 0; i < 9; ++i) camera.expose(&filter, 15 * kMs, 0, kBright, false);
  for (int i = 0; i < 4; ++i) camera.expose(&filter, 15 * kMs);
  EXPECT_LT(error(filter, 15 * kMs), 0.05);
}

TEST(ExposureFilter, OutliersAloneChangeNothing) {
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 30; ++i) camera.expose(&filter, 10 * kMs);
  for (const double outlier : {2.0, 0.5, 1.4}) {
    const auto before = filter.state();
    camera.expose(&filter, 10 * kMs);
    filter.add(camera.now_ns() + kFrameNs / 2, before->exposure_ns, ExposureEstimate{outlier, 0.02}, kBright);
    for (int i = 0; i < 3; ++i) camera.expose(&filter, 10 * kMs);
    EXPECT_LT(error(filter, 10 * kMs), 0.03) << outlier;
  }
}

TEST(ExposureFilter, LooksLessOftenWhenSureAndWhenInVain) {
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 20; ++i) camera.expose(&filter, 10 * kMs);
  const int before = camera.looked();
  for (int i = 0; i < 80; ++i) camera.expose(&filter, 10 * kMs);
  EXPECT_LE(camera.looked() - before, 20);
  EXPECT_GE(camera.looked() - before, 10);
  ExposureFilter in_vain;
  int wanted = 0;
  for (int i = 1; i <= 90; ++i) {
    wanted += in_vain.wants_estimate() ? 1 : 0;
    in_vain.add(i * kFrameNs, 10'000'000, std::nullopt, kBright);
  }
  EXPECT_LE(wanted, 45);
  EXPECT_GE(wanted, 20);
}

TEST(ExposureFilter, FramesWithoutBlurLoseLittle) {
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 30; ++i) camera.expose(&filter, 10 * kMs);
  for (int i = 0; i < 100; ++i) camera.expose(&filter, 10 * kMs, 0, kBright, false);
  EXPECT_LT(error(filter, 10 * kMs), 0.03);
  EXPECT_LT(filter.state()->log_stddev, 0.06);
  // What is bright in other ways may be so by another exposure.
  camera.expose(&filter, 10 * kMs, 0, 3 * kBright, false);
  EXPECT_FALSE(filter.state());
}

TEST(ExposureFilter, BrightnessOfTheSceneAloneForgetsLittle) {
  // A filter that takes every change of brightness for one of the exposure knows what its last estimate said: it ends
  // at the standard deviation of an estimate.
  constexpr double kStddev = 0.03;
  std::vector<double> stddevs, errors;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    ExposureFilter filter;
    Camera camera(kStddev, seed);
    for (int i = 0; camera.looked() < 20 && i < 200; ++i) {
      camera.expose(&filter, 20 * kMs, 0, i % 2 == 0 ? kBright : 2 * kBright);
    }
    errors.push_back(error(filter, 20 * kMs));
    stddevs.push_back(filter.state() ? filter.state()->log_stddev : 1);
  }
  EXPECT_LT(median(stddevs), 0.75 * kStddev);
  EXPECT_LT(median(errors), 0.4 * kStddev);
}

TEST(ExposureFilter, ForgetsWhenTimeJumpsBack) {
  ExposureFilter filter;
  Camera camera(0.02);
  for (int i = 0; i < 10; ++i) camera.expose(&filter, 10 * kMs);
  ASSERT_TRUE(filter.state());
  filter.add(kFrameNs, 10'000'000, std::nullopt, kBright);
  EXPECT_FALSE(filter.state());
}

}  // namespace
}  // namespace gyro_deblur::exposure_filter_test
