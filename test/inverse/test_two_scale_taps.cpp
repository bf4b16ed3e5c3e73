#include "inverse/two_scale_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <set>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "compiled_sets.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur::two_scale_taps_test {
namespace {

class TwoScaleTapsTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<TapSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
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

  const TapSimd* simd_ = nullptr;
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
      make_two_scale_taps(kernel, major, false, *simd_, designs_, taps);
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
        make_two_scale_taps(kernel, major, fixed_point, *simd_, designs_, taps);
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
    make_two_scale_taps(wiener_kernel(extent_px, {}), 0.8, true, *simd_, designs_, taps);
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

TEST_P(TwoScaleTapsTest, HaveAllTheirShapesAhead) {
  for (const double length_factor : {2.0, 4.0, 8.0}) {
    FilterOptions options;
    options.length_factor = length_factor;
    std::set<TwoScaleShape> shapes;
    std::vector<LineKernel> kernels;
    for (const double extent_px : {36.0, 36.25, 57.25, 90.5, 151.0}) {
      kernels.push_back(wiener_kernel(extent_px, options));
      add_two_scale_shapes(kernels.back(), shapes);
    }
    TwoScaleDesigns designs;
    const auto get = [&](const TwoScaleShape& shape) {
      return &designs.get(shape, [&] { return TwoScaleDesign(shape.first, shape.second); });
    };
    for (const TwoScaleShape& shape : shapes) get(shape);
    EXPECT_EQ(designs.size(), shapes.size());
    TwoScaleTaps taps;
    for (const LineKernel& kernel : kernels) {
      for (int i = 0; i <= 450; ++i) {
        make_two_scale_taps(kernel, std::cos(CV_PI / 4 * i / 450), true, *simd_, designs, taps);
      }
    }
    EXPECT_EQ(designs.size(), shapes.size()) << "made in time, not ahead";
    // Others are forgotten, and what is kept stays where it is.
    shapes.clear();
    add_two_scale_shapes(kernels.back(), shapes);
    const TwoScaleDesign* kept = get(*shapes.begin());
    designs.keep_only(shapes);
    EXPECT_EQ(designs.size(), shapes.size());
    EXPECT_EQ(get(*shapes.begin()), kept);
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, TwoScaleTapsTest, testing::ValuesIn(test::kInstructionSets));

// What the spline between nodes of one sample makes of the weights is the kernel, reversed.
TEST(ShearedTaps, MakeTheKernelAgain) {
  const Path1d path_px{-35, -30, -24, -16, 0, 20, 45, 70, 90};
  LineKernel of_path = wiener_kernel(path_px, {});
  LineKernel ramp;
  for (int i = 0; i < 81; ++i) ramp.taps.push_back(static_cast<float>(i) / 3240);
  TwoScaleTaps taps;
  for (const LineKernel* kernel : {&of_path, &ramp}) {
    for (const double major : {0.72, 0.9, 1.0, -0.9}) {
      for (const bool fixed_point : {false, true}) {
        make_sheared_taps(*kernel, major, fixed_point, taps);
        const TwoScaleFilter& filter = taps.filter;
        ASSERT_EQ(filter.decimation, 1);
        std::vector<float> on_axis;
        kernel_on_major_axis(*kernel, major, on_axis);
        const int steps = static_cast<int>(on_axis.size() / 2);
        double largest = 0;
        for (const float tap : on_axis) largest = std::max<double>(largest, std::abs(tap));
        const auto weight = [&](int k) {
          const int index = k + filter.coarse_radius;
          if (index < 0 || index > 2 * filter.coarse_radius) return 0.0;
          if (!fixed_point) return static_cast<double>(filter.coarse[index]);
          const std::int32_t pair = filter.coarse_even[index / 2];
          return std::ldexp(static_cast<std::int16_t>(index % 2 == 0 ? pair & 0xffff : pair >> 16),
                            -filter.coarse_shift);
        };
        const double tolerance = fixed_point ? std::ldexp(2.1, -filter.coarse_shift) : 1e-5 * largest;
        double sum = 0;
        for (int k = -steps - 8; k <= steps + 8; ++k) {
          const double made = 0.75 * weight(k) + 0.125 * (weight(k - 1) + weight(k + 1)) +
                              (k == 0 ? filter.inner_box : 0) + (std::abs(k) <= 1 ? filter.outer_box : 0);
          const double wanted = std::abs(k) <= steps ? on_axis[steps - k] : 0;
          ASSERT_NEAR(made, wanted, tolerance + 1e-4 * std::abs(on_axis.front())) << major << ", step " << k;
          sum += made;
        }
        EXPECT_NEAR(sum, 1, 1e-3) << major << ' ' << fixed_point;
      }
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::two_scale_taps_test
