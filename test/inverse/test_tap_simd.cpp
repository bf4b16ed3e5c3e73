// The loops that make weights, for every instruction set that this processor runs.
#include "inverse/tap_simd.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "compiled_sets.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur::tap_simd_test {
namespace {

class TapSimdTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<TapSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }

  const TapSimd* simd_ = nullptr;
};

TEST_P(TapSimdTest, ResampleKernelsAsOntoTheMajorAxis) {
  const FilterBank bank{FilterOptions{}};
  for (const double extent_px : {2.0, 31.7, 34.0, 90.0, 251.3, 500.0}) {
    const LineKernel& kernel = bank.kernel(extent_px);
    for (const double step : {std::sqrt(0.5), 0.71, 0.8, 0.9, 0.999, 1.0}) {
      std::vector<float> expected;
      kernel_on_major_axis(kernel, step, expected);
      const int steps = static_cast<int>(expected.size() / 2);
      std::vector<float> actual(steps + kRowGroup, 100.0f);
      simd_->resample_kernel(kernel.taps.data() + kernel.radius(), kernel.radius(), step, steps, actual.data());
      float largest = 0;
      for (const float element : expected) largest = std::max(largest, std::abs(element));
      for (int m = 0; m <= steps; ++m) {
        ASSERT_NEAR(actual[m], expected[steps + m], 1e-5 * largest) << extent_px << " px, " << step << ", step " << m;
      }
    }
  }
}

TEST_P(TapSimdTest, CombineColumnsByTheirFactors) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(-1, 1);
  for (const int count : {0, 1, 3, 4, 5, 31, 400}) {
    std::vector<float> columns(count * kRowGroup), factors(count), sums(kRowGroup, 100.0f);
    for (float& element : columns) element = uniform(random);
    for (float& factor : factors) factor = uniform(random);
    simd_->combine_columns(columns.data(), factors.data(), count, sums.data());
    for (int i = 0; i < kRowGroup; ++i) {
      double expected = 0;
      for (int m = 0; m < count; ++m) expected += static_cast<double>(factors[m]) * columns[m * kRowGroup + i];
      EXPECT_NEAR(sums[i], expected, 1e-5 * std::sqrt(std::max(count, 1))) << count << " columns, row " << i;
    }
  }
}

// Against elimination, with bands from none to full.
TEST_P(TapSimdTest, SolveToeplitzSystems) {
  std::mt19937 random(6);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (const int n : {1, 2, 3, 8, 17, 90, 241}) {
    for (const int band : {1, 2, 5, n / 2 + 1, n}) {
      if (band > n) continue;
      // The autocorrelation of noise, and something on the diagonal.
      Eigen::VectorXd noise(band);
      for (double& element : noise) element = uniform(random);
      std::vector<double> lags(band);
      for (int lag = 0; lag < band; ++lag) lags[band - 1 - lag] = noise.head(band - lag).dot(noise.tail(band - lag));
      lags[band - 1] += 0.01;
      Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          if (std::abs(i - j) < band) matrix(i, j) = lags[band - 1 - std::abs(i - j)];
        }
      }
      std::vector<double> sides(2 * n), work(5 * (n + kToeplitzRoom) + band, 7.0), solved(2 * n, 7.0);
      for (double& side : sides) side = uniform(random);
      simd_->solve_toeplitz(lags.data(), band, n, sides.data(), work.data(), solved.data());
      const Eigen::MatrixXd expected =
          matrix.partialPivLu().solve(Eigen::Map<const Eigen::MatrixXd>(sides.data(), n, 2));
      const Eigen::Map<const Eigen::MatrixXd> actual(solved.data(), n, 2);
      EXPECT_LT((actual - expected).cwiseAbs().maxCoeff(), 1e-7 * expected.cwiseAbs().maxCoeff()) << n << ' ' << band;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, TapSimdTest, testing::ValuesIn(test::kInstructionSets));

TEST(TapSimd, OfTheWidestSetAreTheBest) {
  const char* widest = "baseline";
  for (const char* name : test::kInstructionSets) widest = find_for_cpu<TapSimd>(name) != nullptr ? name : widest;
  EXPECT_STREQ(select_for_cpu<TapSimd>().name, widest);
}

TEST(TapSimd, AreThereForKnownNamesAlone) {
  EXPECT_NE(find_for_cpu<TapSimd>("baseline"), nullptr);
  EXPECT_EQ(find_for_cpu<TapSimd>("abacus"), nullptr);
  EXPECT_EQ(find_for_cpu<TapSimd>(""), nullptr);
}

}  // namespace
}  // namespace gyro_deblur::tap_simd_test
