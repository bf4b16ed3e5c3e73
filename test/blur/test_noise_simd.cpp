// The loop that the estimate of noise spends its time in, for every instruction set that this processor runs.
#include "blur/noise_simd.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "compiled_sets.hpp"

namespace gyro_deblur::noise_simd_test {
namespace {

class NoiseSimdTest : public testing::TestWithParam<const char*> {};

TEST_P(NoiseSimdTest, SumsABand) {
  const NoiseSimd* simd = find_for_cpu<NoiseSimd>(GetParam());
  if (simd == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
  EXPECT_STREQ(simd->name, GetParam());
  std::mt19937 random(7);
  std::uniform_real_distribution<float> grey(-5, 255);
  constexpr std::array<double, 5> kFilter = {1, -4, 6, -4, 1};
  for (const int cols : {5, 12, 13, 64, 67, 200}) {
    std::vector<std::vector<float>> band(kNoiseBandRows, std::vector<float>(cols));
    std::vector<const float*> rows;
    for (std::vector<float>& row : band) {
      std::generate(row.begin(), row.end(), [&] { return grey(random); });
      rows.push_back(row.data());
    }
    std::vector<float> down(cols), power(cols, -1), first(cols, -1), second(cols, -1), clipped(cols, -1);
    simd->sum_band(rows.data(), cols, down.data(), {power.data(), first.data(), second.data(), clipped.data()});
    for (int x = 0; x < cols; ++x) {
      EXPECT_EQ(clipped[x], std::count_if(rows.begin(), rows.end(), [x](const float* row) { return row[x] < 0; }));
      if (x < kNoiseReachPx || x >= cols - kNoiseReachPx) continue;
      double powers = 0, means = 0, squares = 0;
      for (int y = 0; y < kNoiseSquarePx; ++y) {
        double finest = 0;
        for (int i = 0; i < 5; ++i) {
          for (int j = 0; j < 5; ++j) finest += kFilter[i] * kFilter[j] * band[y + i][x + j - kNoiseReachPx];
        }
        powers += finest * finest;
        if (y % 2 == 1) continue;
        const std::vector<float>&upper = band[y + 2], &lower = band[y + 3];
        const double mean = (upper[x] + upper[x + 1] + lower[x] + lower[x + 1]) / 4;
        means += mean;
        squares += mean * mean;
      }
      EXPECT_NEAR(power[x], powers, 1e-5 * powers) << x << " of " << cols;
      EXPECT_NEAR(first[x], means, 1e-3);
      EXPECT_NEAR(second[x], squares, 1e-5 * squares);
    }
  }
}

template <typename Pixel>
void expect_added(void (*add)(const Pixel*, int, int, float, int, float*), int full_scale) {
  constexpr float kScale = 0.25f;
  std::mt19937 random(3);
  std::uniform_int_distribution<int> grey(0, full_scale + full_scale / 10);
  for (const int stride : {1, 2, 3, 6}) {
    for (const int count : {1, 7, 64, 131}) {
      std::vector<Pixel> from(static_cast<std::size_t>(stride * count));
      std::generate(from.begin(), from.end(),
                    [&] { return static_cast<Pixel>(std::min<int>(grey(random), std::numeric_limits<Pixel>::max())); });
      from.front() = 0;
      std::vector<float> sums(static_cast<std::size_t>(count), 10);
      add(from.data(), stride, count, kScale, full_scale, sums.data());
      for (int x = 0; x < count; ++x) {
        const int sample = from[static_cast<std::size_t>(x * stride)];
        const bool is_clipped = sample == 0 || sample >= full_scale;
        EXPECT_EQ(sums[static_cast<std::size_t>(x)], 10 + (kScale * sample + (is_clipped ? kNoiseClipped : 0)));
      }
    }
  }
}

TEST_P(NoiseSimdTest, AddsSamples) {
  const NoiseSimd* simd = find_for_cpu<NoiseSimd>(GetParam());
  if (simd == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
  expect_added<std::uint8_t>(simd->add_samples8, 255);
  expect_added<std::uint16_t>(simd->add_samples16, 4095);
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, NoiseSimdTest, testing::ValuesIn(test::kInstructionSets));

}  // namespace
}  // namespace gyro_deblur::noise_simd_test
