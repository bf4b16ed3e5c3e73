// Which blocks no fast method of the CPU engine takes, and that they are counted.
#include "engine/cpu/block_method.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "engine/cpu/cpu_engine.hpp"
#include "engine/engine.hpp"
#include "filter_grids.hpp"
#include "images.hpp"
#include "inverse/filter_bank.hpp"

namespace gyro_deblur::block_method_test {
namespace {

using test::random_image;

constexpr double kAngle_rad = 0.4;  // far from an axis
constexpr double kSlope = 0.42;

const char* const kZeros = "a kernel of zeros";
const char* const kSmallRatio = "noise-to-signal ratio too small for the fast methods";
const char* const kDeepShort = "16 bit and blur below 36 px";
const char* const kDeepNonuniform = "16 bit and blur at non-uniform speed below 57 px near an axis";
const char* const kLongShort = "more than 257 taps for blur below 36 px";

/// As a path at non-uniform speed gives it: nobody knows its shape.
LineKernel without_box(int taps) {
  LineKernel kernel;
  kernel.taps.assign(taps, 1.0f / static_cast<float>(taps));
  return kernel;
}

FilterOptions with_ratio(double ratio) {
  FilterOptions options;
  options.noise_to_signal_ratio = ratio;
  return options;
}

FilterOptions of_length(double factor) {
  FilterOptions options;
  options.length_factor = factor;
  return options;
}

/// Kernels that no fast method takes, for one reason each, and the depth of their image.
struct FallbackCase {
  std::string reason;
  LineKernel kernel;
  int depth;
  double angle_rad = kAngle_rad;
};

std::vector<FallbackCase> fallback_cases() {
  LineKernel zero;
  zero.taps.assign(9, 0.0f);
  return {{kZeros, zero, CV_8U},
          {kSmallRatio, wiener_kernel(60, with_ratio(0.007)), CV_8U},
          {kDeepShort, wiener_kernel(35.75, {}), CV_16U},
          {kDeepNonuniform, without_box(201), CV_16U, 0.1},
          {kLongShort, wiener_kernel(33, of_length(8)), CV_8U}};
}

TEST(FallbackReason, IsGivenForEveryKernelThatNoFastMethodTakes) {
  for (const FallbackCase& c : fallback_cases()) {
    EXPECT_EQ(fallback_reason(c.kernel, std::tan(c.angle_rad), c.depth), c.reason);
  }
}

// The other side of each limit.
TEST(FallbackReason, IsNotGivenWhereAFastMethodServes) {
  EXPECT_EQ(fallback_reason(wiener_kernel(60, with_ratio(0.009)), kSlope, CV_8U), "");
  EXPECT_EQ(fallback_reason(wiener_kernel(36, {}), kSlope, CV_16U), "");
  EXPECT_EQ(fallback_reason(without_box(9), kSlope, CV_8U), "");
  for (const int depth : {CV_8U, CV_16U}) {
    EXPECT_EQ(fallback_reason(without_box(145), kSlope, depth), "");
    EXPECT_EQ(fallback_reason(without_box(259), kSlope, depth), "");
    EXPECT_EQ(fallback_reason(without_box(4001), kSlope, depth), "");
  }
  EXPECT_EQ(fallback_reason(wiener_kernel(32, of_length(8)), kSlope, CV_8U), "");
  EXPECT_EQ(fallback_reason(wiener_kernel(500, of_length(8)), kSlope, CV_8U), "");
  for (const double extent_px : {1.0, 5.0, 35.0, 36.0, 57.0, 130.0, 500.0}) {
    EXPECT_EQ(fallback_reason(wiener_kernel(extent_px, {}), kSlope, CV_8U), "") << extent_px;
  }
}

// Near an axis: not along it, where short tiles serve, nor further off.
TEST(FallbackReason, IsGivenForDeepNonuniformBlurNearAnAxisAlone) {
  for (const double slope : {0.07, -0.07, 0.14, -0.14}) {
    EXPECT_EQ(fallback_reason(without_box(145), slope, CV_16U), kDeepNonuniform) << slope;
    EXPECT_EQ(fallback_reason(without_box(145), slope, CV_8U), "") << slope;
    EXPECT_EQ(fallback_reason(without_box(229), slope, CV_16U), "") << slope << ", 57 px";
    EXPECT_EQ(fallback_reason(wiener_kernel(40, {}), slope, CV_16U), "") << slope << ", even speed";
  }
  for (const double slope : {0.0, 0.05, -0.05, 0.16, 1.0}) {
    EXPECT_EQ(fallback_reason(without_box(145), slope, CV_16U), "") << slope;
  }
}

// A kernel whose taps cancel each other leaves too few bits to each, unless exact taps are enough.
TEST(FallbackReason, IsTheGainOfAKernelWithoutABox) {
  const auto alternating = [](int taps, float gain) {
    LineKernel kernel;
    for (int i = 0; i < taps; ++i) kernel.taps.push_back((i % 2 == 0 ? gain : -gain) / static_cast<float>(taps));
    return kernel;
  };
  EXPECT_EQ(fallback_reason(alternating(301, 70), kSlope, CV_8U), "");
  EXPECT_EQ(fallback_reason(alternating(301, 90), kSlope, CV_8U), kSmallRatio);
  EXPECT_EQ(fallback_reason(alternating(201, 90), kSlope, CV_8U), "");
  EXPECT_FALSE(takes_sheared_columns(alternating(201, 90), 0.5, CV_8U));
  EXPECT_TRUE(takes_sheared_columns(alternating(201, 70), 0.5, CV_8U));
  EXPECT_EQ(fallback_reason(alternating(201, 90), kSlope, CV_16U), kSmallRatio);
}

TEST(CpuEngineFallbackCounts, AreCountedByReason) {
  const std::vector<FallbackCase> cases = fallback_cases();
  const LineKernel fast = wiener_kernel(90, {});
  CpuEngine engine(2);
  EXPECT_EQ(engine.fallback_counts(), FallbackCounts{}) << "before the first image";
  for (const int depth : {CV_8U, CV_16U}) {
    // Block i has the kernel of case i / 3, copied blocks and fast ones in between.
    FallbackCounts expected;
    const cv::Mat image = random_image(static_cast<int>(cases.size()) * 3 * 24, 20, depth, 3);
    const FilterGrid grid = test::make_grid(image.size(), 24, [&](int i) -> BlockFilter {
      const FallbackCase& c = cases[i / 3];
      if (i % 3 == 1) return {kAngle_rad, i % 2 == 0 ? nullptr : &fast};
      if (c.depth != depth) return {kAngle_rad, &fast};
      ++expected[c.reason];
      return {c.angle_rad, &c.kernel};
    });
    cv::Mat dst;
    engine.filter(image, grid, dst);
    EXPECT_EQ(engine.fallback_counts(), expected);
    ASSERT_EQ(expected.size(), depth == CV_8U ? 3u : 2u);
    for (const auto& [reason, count] : expected) EXPECT_EQ(count, 2u) << reason;
    // The next image starts from nothing.
    engine.filter(image, test::one_block(image.size(), 0.4, fast), dst);
    EXPECT_EQ(engine.fallback_counts(), FallbackCounts{});
  }
}

TEST(CpuEngineFallbackCounts, AreNoneWhereNothingIsFiltered) {
  CpuEngine engine(1);
  const cv::Mat image = random_image(40, 30, CV_16UC1, 3);
  cv::Mat dst;
  const LineKernel kernel = without_box(9);
  engine.filter(image, test::one_block(image.size(), 0.4, kernel), dst);
  EXPECT_EQ(engine.fallback_counts().size(), 1u);
  engine.filter(image, {{0, 40}, {0, 30}, {{}}}, dst);
  EXPECT_EQ(engine.fallback_counts(), FallbackCounts{});
}

}  // namespace
}  // namespace gyro_deblur::block_method_test
