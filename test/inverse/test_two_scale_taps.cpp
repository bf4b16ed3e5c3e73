#include "inverse/two_scale_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "inverse/line_taps.hpp"

namespace gyro_deblur {
namespace {

class TwoScaleTapsTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    loops_ = find_tap_loops(GetParam());
    if (loops_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
  }

  /// The kernel that the weights make at m = 0, 1, ..: the mean over the places that an output may have in its node.
  static std::vector<double> kernel_of(const TwoScaleFilter& filter) {
    const int d = filter.decimation, reach = (filter.coarse_radius + 2) * d;
    std::vector<double> sum(reach + 1, 0.0);
    for (int phase = 0; phase < d; ++phase) {
      const double u = (phase - (d - 1) / 2.0) / d;
      const double spline[] = {(0.5 - u) * (0.5 - u) / 2, 0.75 - u * u, (0.5 + u) * (0.5 + u) / 2};
      for (int m = 0; m <= reach; ++m) {
        // Sample m after an output at `phase` of node 0 is in this node.
        const int node = static_cast<int>(std::floor(static_cast<double>(phase + m) / d));
        double weight = 0;
        for (int q = -1; q <= 1; ++q) {
          const int k = node - q;
          if (std::abs(k) <= filter.coarse_radius) weight += spline[q + 1] * filter.coarse[k + filter.coarse_radius];
        }
        if (m <= filter.box_half) weight += filter.inner_box;
        if (m <= filter.box_half + 1) weight += filter.outer_box;
        sum[m] += weight / d;
      }
    }
    return sum;
  }

  const TapLoops* loops_ = nullptr;
  TwoScaleDesigns designs_;
};

// Compared by their spectra: up to a quarter cycle a node, where the coarse weights carry the
// kernel.
TEST_P(TwoScaleTapsTest, MakeTheKernelAgain) {
  TwoScaleTaps taps;
  const auto gain = [](const auto& half_kernel, double w) {
    double sum = -half_kernel[0];
    for (std::size_t m = 0; m < half_kernel.size(); ++m) sum += 2 * half_kernel[m] * std::cos(w * m);
    return sum;
  };
  for (const double extent_px : {40.0, 90.0, 131.0}) {
    const LineKernel kernel = wiener_kernel(extent_px, {});
    for (const double major : {0.72, 0.9, 1.0, -0.9}) {
      make_two_scale_taps(kernel, major, false, *loops_, designs_, taps);
      std::vector<float> on_axis;
      kernel_on_major_axis(kernel, major, on_axis);
      const std::vector<float> wanted(on_axis.begin() + on_axis.size() / 2, on_axis.end());
      const std::vector<double> made = kernel_of(taps.filter);
      double largest = 0, error = 0;
      for (int f = 0; f <= 100; ++f) {
        const double w = CV_PI / (2 * taps.filter.decimation) * f / 100;
        largest = std::max(largest, std::abs(gain(wanted, w)));
        error = std::max(error, std::abs(gain(made, w) - gain(wanted, w)));
      }
      EXPECT_LT(error, 0.03 * largest) << extent_px << " px, " << major;
    }
  }
}

TEST_P(TwoScaleTapsTest, KeepTheSum) {
  TwoScaleTaps taps;
  for (const double extent_px : {40.0, 57.3, 90.0, 131.0, 400.0}) {
    const LineKernel kernel = wiener_kernel(extent_px, {});
    for (const double major : {0.72, 0.9, 1.0}) {
      for (const bool fixed_point : {false, true}) {
        make_two_scale_taps(kernel, major, fixed_point, *loops_, designs_, taps);
        const TwoScaleFilter& filter = taps.filter;
        double coarse = 0;
        for (int k = 0; k <= 2 * filter.coarse_radius; ++k) coarse += filter.coarse[k];
        if (fixed_point) coarse = std::ldexp(filter.coarse_sum, -filter.coarse_shift);
        const double sum = coarse * filter.decimation +
                           static_cast<double>(filter.inner_box) * (2 * filter.box_half + 1) +
                           static_cast<double>(filter.outer_box) * (2 * filter.box_half + 3);
        EXPECT_NEAR(sum, 1.0, 1e-3) << extent_px << " px, " << major << ' ' << fixed_point;
      }
    }
  }
}

TEST_P(TwoScaleTapsTest, HaveTheCoarseWeightsInFixedPointToo) {
  TwoScaleTaps taps;
  for (const double extent_px : {40.0, 90.0, 400.0}) {
    make_two_scale_taps(wiener_kernel(extent_px, {}), 0.8, true, *loops_, designs_, taps);
    const TwoScaleFilter& filter = taps.filter;
    const auto low = [](std::int32_t pair) { return static_cast<std::int16_t>(pair & 0xffff); };
    const auto high = [](std::int32_t pair) { return static_cast<std::int16_t>(pair >> 16); };
    const int count = 2 * filter.coarse_radius + 1;
    const auto weight = [&](int index) { return index < 0 || index >= count ? 0.0 : filter.coarse[index]; };
    std::int64_t sum = 0;
    for (int i = -1; i <= filter.coarse_radius + 1; ++i) {
      const double unit = std::ldexp(1.0, -filter.coarse_shift);
      // Rounding, and what neighbours passed on.
      EXPECT_NEAR(low(filter.coarse_even[i]) * unit, weight(2 * i), 2.1 * unit) << extent_px << ' ' << i;
      EXPECT_NEAR(high(filter.coarse_even[i]) * unit, weight(2 * i + 1), 2.1 * unit) << extent_px << ' ' << i;
      EXPECT_EQ(high(filter.coarse_odd[i]), low(filter.coarse_even[i])) << extent_px << ' ' << i;
      const std::int32_t before = i < 0 ? 0 : high(filter.coarse_even[i - 1]);
      EXPECT_EQ(low(filter.coarse_odd[i]), before) << extent_px << ' ' << i;
      sum += low(filter.coarse_even[i]) + high(filter.coarse_even[i]);
    }
    EXPECT_EQ(sum, filter.coarse_sum) << extent_px;
    for (int i = 1; i <= kCoarseGuard; ++i) {
      EXPECT_EQ(filter.coarse[-i], 0);
      EXPECT_EQ(filter.coarse[count - 1 + i], 0);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, TwoScaleTapsTest, testing::Values("baseline", "avx2", "avx512"));

}  // namespace
}  // namespace gyro_deblur
