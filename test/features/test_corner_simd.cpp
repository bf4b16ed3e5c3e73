// The loops that search for corners, for every instruction set that this processor runs.
#include "features/corner_simd.hpp"

#include <array>
#include <cstddef>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "compiled_sets.hpp"

namespace gyro_deblur::corner_simd_test {
namespace {

/// With the room that is promised and no more, so that AddressSanitizer sees what is read or written beyond it.
class Row {
 public:
  explicit Row(int width) : values_(static_cast<std::size_t>(width + 2 * kCornerRoom)) {}
  float* data() { return values_.data() + kCornerRoom; }
  float& operator[](int x) { return data()[x]; }
  void fill(std::mt19937* random) {
    std::uniform_real_distribution<float> value(-1, 1);
    for (float& each : values_) each = value(*random);
  }

 private:
  std::vector<float> values_;
};

class CornerSimdTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<CornerSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }
  std::array<Row, 3> random_rows(int width) {
    std::array<Row, 3> rows{Row(width), Row(width), Row(width)};
    for (Row& row : rows) row.fill(&random_);
    return rows;
  }

  const CornerSimd* simd_ = nullptr;
  std::mt19937 random_{5};
};

TEST_P(CornerSimdTest, HalveAnyWidth) {
  for (int width = 1; width <= 70; ++width) {
    std::vector<unsigned char> upper(static_cast<std::size_t>(2 * width)), lower(upper);
    for (std::vector<unsigned char>* row : {&upper, &lower}) {
      for (unsigned char& pixel : *row) pixel = static_cast<unsigned char>(random_() % 256);
    }
    Row half(width);
    simd_->downsample2x(upper.data(), lower.data(), half.data(), width);
    for (int x = 0; x < width; ++x) {
      const auto at = static_cast<std::size_t>(2 * x);
      ASSERT_EQ(half[x], 0.25f * static_cast<float>(upper[at] + upper[at + 1] + lower[at] + lower[at + 1])) << width;
    }
  }
}

TEST_P(CornerSimdTest, MultiplyGradientsOfAnyWidth) {
  for (int width = 1; width <= 70; ++width) {
    std::array<Row, 3> rows = random_rows(width), products = random_rows(width);
    simd_->multiply(rows[0].data(), rows[1].data(), rows[2].data(),
                    {products[0].data(), products[1].data(), products[2].data()}, width);
    for (int x = 0; x < width; ++x) {
      const float across = rows[1][x + 1] - rows[1][x - 1], down = rows[2][x] - rows[0][x];
      ASSERT_NEAR(products[0][x], across * across, 1e-6f);
      ASSERT_NEAR(products[1][x], across * down, 1e-6f);
      ASSERT_NEAR(products[2][x], down * down, 1e-6f);
    }
  }
}

TEST_P(CornerSimdTest, RateIsDeterminantOverTrace) {
  constexpr int kWidth = 45;
  std::array<Row, 3> xx = random_rows(kWidth), xy = random_rows(kWidth), yy = random_rows(kWidth);
  std::array<GradientProducts, 3> products;
  for (std::size_t i = 0; i < 3; ++i) {
    for (int x = -1; x <= kWidth; ++x) {  // a texture in all directions
      xx[i][x] += 3;
      yy[i][x] += 4;
    }
    products[i] = {xx[i].data(), xy[i].data(), yy[i].data()};
  }
  Row strengths(kWidth);
  simd_->rate(products.data(), strengths.data(), kWidth);
  for (int x = 0; x < kWidth; ++x) {
    double sum_xx = 0, sum_xy = 0, sum_yy = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      for (int k = x - 1; k <= x + 1; ++k) {
        sum_xx += xx[i][k];
        sum_xy += xy[i][k];
        sum_yy += yy[i][k];
      }
    }
    ASSERT_NEAR(strengths[x], (sum_xx * sum_yy - sum_xy * sum_xy) / (sum_xx + sum_yy), 1e-4);
  }
}

TEST_P(CornerSimdTest, FindPeaksOfAnyWidth) {
  for (int width = 3; width <= 70; ++width) {
    std::array<Row, 3> rows = random_rows(width);
    rows[1][width / 2] = rows[1][width / 2 + 1] = 2;  // of two equal maxima the first
    std::vector<int> expected;
    for (int x = 1; x < width - 1; ++x) {
      bool is_peak = true;
      for (int i = 0; i < 9; ++i) {
        const float other = rows[static_cast<std::size_t>(i / 3)][x - 1 + i % 3];
        is_peak = is_peak && (i == 4 || (i < 4 ? rows[1][x] > other : rows[1][x] >= other));
      }
      if (is_peak) expected.push_back(x);
    }
    std::vector<int> columns(static_cast<std::size_t>(width - 2) + 1);
    columns.resize(static_cast<std::size_t>(
        simd_->find_peaks(rows[0].data(), rows[1].data(), rows[2].data(), 1, width - 1, columns.data())));
    ASSERT_EQ(columns, expected) << width;
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, CornerSimdTest, testing::ValuesIn(test::kInstructionSets));

TEST(CornerSimd, OfTheWidestSetAreTheBest) {
  const char* widest = "baseline";
  for (const char* name : test::kInstructionSets) widest = find_for_cpu<CornerSimd>(name) != nullptr ? name : widest;
  EXPECT_STREQ(select_for_cpu<CornerSimd>().name, widest);
}

}  // namespace
}  // namespace gyro_deblur::corner_simd_test
