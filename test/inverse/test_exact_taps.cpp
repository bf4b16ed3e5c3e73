#include "inverse/exact_taps.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <utility>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "inverse/filter_bank.hpp"

namespace gyro_deblur::exact_taps_test {
namespace {

std::int32_t low_half(const PairTap& tap) { return static_cast<std::int16_t>(tap.weights & 0xffff); }
std::int32_t high_half(const PairTap& tap) { return tap.weights >> 16; }

/// Weights by (m, n), in grey levels a grey level.
std::map<std::pair<int, int>, double> weights_of(const ExactFilter& filter) {
  std::map<std::pair<int, int>, double> weights;
  for (int i = 0; i < filter.count; ++i) {
    const PairTap& tap = filter.taps[i];
    weights[{tap.m, tap.n}] += low_half(tap) * static_cast<double>(filter.scale);
    weights[{tap.m, tap.n + 1}] += high_half(tap) * static_cast<double>(filter.scale);
  }
  return weights;
}

// Each weight is off by rounding and what a neighbour passed on: one unit of its own, one of the pair's share.
TEST(ExactTaps, AreTheRotatedTapsMirroredAndRounded) {
  ExactTaps exact;  // used again and again
  for (const double extent_px : {2.0, 9.0, 29.8}) {
    const LineKernel kernel = wiener_kernel(extent_px, {});
    for (const bool byte_weights : {false, true}) {
      for (int degrees = 0; degrees < 180; degrees += 13) {
        const double angle_rad = degrees * CV_PI / 180;
        make_exact_taps(kernel, direction_of(angle_rad), byte_weights, exact);
        std::map<std::pair<int, int>, double> missing = weights_of(exact.filter);
        const bool major_is_y = direction_of(angle_rad).major_is_y;
        for (const KernelTap& tap : rotate_kernel(kernel, angle_rad)) {
          // The output at p takes the input at p - tap.
          missing[major_is_y ? std::pair(-tap.dy, -tap.dx) : std::pair(-tap.dx, -tap.dy)] -= tap.weight;
        }
        for (const auto& [place, error] : missing) {
          EXPECT_LE(std::abs(error), 2 * exact.filter.scale)
              << extent_px << " px, " << degrees << " deg, " << byte_weights << ": " << place.first << ", "
              << place.second;
        }
      }
    }
  }
}

TEST(ExactTaps, KeepTheSumAndStayWithinTheirBits) {
  ExactTaps exact;
  for (const double extent_px : {2.0, 9.0, 29.8}) {
    const LineKernel kernel = wiener_kernel(extent_px, {});
    for (const bool byte_weights : {false, true}) {
      for (int degrees = 0; degrees < 180; degrees += 13) {
        make_exact_taps(kernel, direction_of(degrees * CV_PI / 180), byte_weights, exact);
        const ExactFilter& filter = exact.filter;
        // Short kernels have fine weights whatever the engine takes.
        EXPECT_EQ(filter.weights_are_bytes, byte_weights && kernel.radius() > 12) << extent_px;
        const int most = filter.weights_are_bytes ? kMaxByteWeight : kMaxPairWeight;
        int radius_m = 0, n_min = 1000, n_max = -1000, largest = 0;
        std::int64_t sum = 0;
        for (int i = 0; i < filter.count; ++i) {
          const PairTap& tap = filter.taps[i];
          largest = std::max({largest, std::abs(low_half(tap)), std::abs(high_half(tap))});
          sum += low_half(tap) + high_half(tap);
          radius_m = std::max(radius_m, std::abs(tap.m));
          n_min = std::min(n_min, tap.n);
          n_max = std::max(n_max, tap.n);
        }
        EXPECT_LE(largest, most) << extent_px << ' ' << degrees;
        EXPECT_GT(largest, most / 2) << extent_px << ' ' << degrees << ": uses the room";
        EXPECT_NEAR(static_cast<double>(sum) * filter.scale, 1.0, 1e-4) << extent_px << ' ' << degrees;
        EXPECT_EQ(filter.radius_m, radius_m);
        EXPECT_EQ(filter.n_min, n_min);
        EXPECT_EQ(filter.n_max, n_max);
      }
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::exact_taps_test
