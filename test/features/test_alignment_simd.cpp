// The loops that align blurred patches, for every instruction set that this processor runs.
#include "features/alignment_simd.hpp"

#include <array>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "compiled_sets.hpp"

namespace gyro_deblur::alignment_simd_test {
namespace {

class AlignmentSimdTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<AlignmentSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }
  /// Of exactly the room that is promised, so that AddressSanitizer sees what is read or written beyond it.
  std::vector<float> random_patch(int width, int height, bool clear_room) {
    std::vector<float> patch(static_cast<std::size_t>((width + kPatchRoom) * height));
    std::uniform_real_distribution<float> value(-1, 1);
    for (std::size_t i = 0; i < patch.size(); ++i) {
      const bool in_room = static_cast<int>(i) % (width + kPatchRoom) >= width;
      patch[i] = clear_room && in_room ? 0 : value(random_);
    }
    return patch;
  }

  const AlignmentSimd* simd_ = nullptr;
  std::mt19937 random_{5};
};

TEST_P(AlignmentSimdTest, ConvolveAnyWidth) {
  const std::array<int, 3> columns{0, 2, 3}, rows{0, 1, 2};
  const std::array<float, 3> shares{0.5f, -0.25f, 0.75f};
  for (int width = 1; width <= 110; ++width) {
    const int height = 1 + width % 4, read_stride = width + 3 + kPatchRoom, stride = width + kPatchRoom;
    const std::vector<float> read = random_patch(width + 3, height + 2, false);
    std::vector<float> written(static_cast<std::size_t>(stride * height));
    std::array<int, 3> offsets;
    for (std::size_t k = 0; k < 3; ++k) offsets[k] = columns[k] + rows[k] * read_stride;
    simd_->convolve(read.data(), read_stride, offsets.data(), shares.data(), 3, written.data(), stride, width, height);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        float sum = 0;
        for (std::size_t k = 0; k < 3; ++k) {
          sum += shares[k] * read[static_cast<std::size_t>(offsets[k] + y * read_stride + x)];
        }
        ASSERT_NEAR(written[static_cast<std::size_t>(y * stride + x)], sum, 1e-6f) << width << ": " << x << ", " << y;
      }
    }
  }
}

TEST_P(AlignmentSimdTest, SortColumnsOfAnyCount) {
  for (int count = 1; count <= 40; ++count) {
    for (const int n : {2, 3}) {
      const std::vector<float> pixels = random_patch(n * count, 1, false);
      std::vector<float> sorted(static_cast<std::size_t>(n * count));
      (n == 2 ? simd_->sort_by_two : simd_->sort_by_three)(pixels.data(), sorted.data(), count);
      for (int i = 0; i < n * count; ++i) {
        ASSERT_EQ(sorted[static_cast<std::size_t>(i % n * count + i / n)], pixels[static_cast<std::size_t>(i)])
            << count;
      }
    }
  }
}

TEST_P(AlignmentSimdTest, SampleWithTheWeightsOfBothFractions) {
  // Weights that show their step: pixel 0 has 1 - fraction, pixel 5 has the fraction.
  std::vector<float> table(static_cast<std::size_t>((kInterpolationSteps + 1) * kInterpolationStride), 0.0f);
  for (int i = 0; i <= kInterpolationSteps; ++i) {
    const float fraction = static_cast<float>(i) / kInterpolationSteps;
    table[static_cast<std::size_t>(i * kInterpolationStride)] = 1 - fraction;
    table[static_cast<std::size_t>(i * kInterpolationStride + kInterpolationTaps - 1)] = fraction;
  }
  constexpr int kWidth = 40, kHeight = 30, kStride = kWidth + kPatchRoom, kCount = 21;
  const std::vector<float> pixels = random_patch(kWidth, kHeight, false);
  std::vector<float> sampled(kCount);
  const float x = 1.25f, y = 2.5f, dx = 1.125f, dy = 0.25f;  // whole steps of the table
  simd_->sample_row(pixels.data(), kStride, table.data(), x, y, dx, dy, kCount, sampled.data());
  for (int i = 0; i < kCount; ++i) {
    const float at_x = x + static_cast<float>(i) * dx, at_y = y + static_cast<float>(i) * dy;
    const int left = static_cast<int>(at_x), top = static_cast<int>(at_y);
    const float fx = at_x - static_cast<float>(left), fy = at_y - static_cast<float>(top);
    const auto at = [&](int column, int row) {
      return pixels[static_cast<std::size_t>((top + row) * kStride + left + column)];
    };
    const float expected =
        (1 - fy) * ((1 - fx) * at(0, 0) + fx * at(5, 0)) + fy * ((1 - fx) * at(0, 5) + fx * at(5, 5));
    ASSERT_NEAR(sampled[static_cast<std::size_t>(i)], expected, 1e-6f) << i;
  }
}

TEST_P(AlignmentSimdTest, WidenAnyWidth) {
  for (int width = 1; width <= 70; ++width) {
    const int height = 1 + width % 3, stride = width + kPatchRoom, byte_stride = width + 5;
    // Of exactly the image's size: nothing is read behind it.
    std::vector<unsigned char> bytes(static_cast<std::size_t>(byte_stride * (height - 1) + width));
    for (unsigned char& byte : bytes) byte = static_cast<unsigned char>(random_() % 256);
    std::vector<float> written(static_cast<std::size_t>(stride * height));
    simd_->widen(bytes.data(), byte_stride, written.data(), stride, width, height);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        ASSERT_EQ(written[static_cast<std::size_t>(y * stride + x)],
                  bytes[static_cast<std::size_t>(y * byte_stride + x)])
            << width << ": " << x << ", " << y;
      }
    }
  }
}

TEST_P(AlignmentSimdTest, CompareAndCombineAnyWidth) {
  for (int width = 1; width <= 70; ++width) {
    const int height = 1 + width % 5, stride = width + kPatchRoom;
    const std::vector<float> a = random_patch(width, height, false), b = random_patch(width, height, true);
    std::vector<float> combined = random_patch(width, height, false);
    const std::vector<float> before = combined;
    std::array<float, 3> sums;
    simd_->compare(a.data(), stride, 0.25f, b.data(), stride, width, height, sums.data());
    simd_->combine(a.data(), stride, 2, b.data(), stride, -0.5f, 3, combined.data(), stride, width, height);
    std::array<double, 3> expected{};
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(y * stride + x);
        const double value = a[i] - 0.25;
        expected[0] += value;
        expected[1] += value * b[i];
        expected[2] += value * value;
        ASSERT_NEAR(combined[i], 2 * a[i] - 0.5 * b[i] + 3, 1e-5) << width << ": " << x << ", " << y;
      }
      const auto end = static_cast<std::size_t>(y * stride + width);
      ASSERT_TRUE(combined[end] == before[end] || combined[end] == 0) << "written, and not 0";
    }
    for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(sums[k], expected[k], 1e-4) << width;
  }
}

TEST_P(AlignmentSimdTest, DifferentiateAnyWidth) {
  // Of a quadratic surface Scharr's derivatives are exact.
  const auto value = [](int x, int y) { return static_cast<float>(0.5 * x * x - 0.25 * x * y + y * y + 3 * x - y); };
  for (int width = 1; width <= 70; ++width) {
    const int height = 1 + width % 5, stride = width + kPatchRoom, read_stride = width + 2 + kPatchRoom;
    std::vector<float> patch = random_patch(width + 2, height + 2, false), along_x(random_patch(width, height, false)),
                       along_y(along_x);
    const std::vector<float> before = along_x;
    for (int y = -1; y <= height; ++y) {
      for (int x = -1; x <= width; ++x) patch[static_cast<std::size_t>((y + 1) * read_stride + x + 1)] = value(x, y);
    }
    simd_->differentiate(patch.data() + read_stride + 1, read_stride, along_x.data(), along_y.data(), stride, width,
                         height);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(y * stride + x);
        ASSERT_NEAR(along_x[i], x - 0.25 * y + 3, 1e-3) << width << ": " << x << ", " << y;
        ASSERT_NEAR(along_y[i], -0.25 * x + 2 * y - 1, 1e-3) << width << ": " << x << ", " << y;
      }
      const auto end = static_cast<std::size_t>(y * stride + width);
      ASSERT_TRUE(along_x[end] == before[end] || along_x[end] == 0) << "written, and not 0";
    }
  }
}

TEST_P(AlignmentSimdTest, MultiplyByDerivativesOfAnyWidth) {
  // Of cubic surfaces five-point differences are exact.
  const auto value = [](double x, double y) { return 1e-3 * x * x * x + 0.02 * x * y - 1e-2 * y * y * y + x; };
  for (int width = 1; width <= 70; ++width) {
    const int height = 1 + width % 5, stride = width + kPatchRoom, read_stride = width + 4 + kPatchRoom;
    const std::vector<float> a = random_patch(width, height, true), b = random_patch(width, height, true);
    std::vector<float> patch = random_patch(width + 4, height + 4, false);
    for (int y = -2; y < height + 2; ++y) {
      for (int x = -2; x < width + 2; ++x) {
        patch[static_cast<std::size_t>((y + 2) * read_stride + x + 2)] = static_cast<float>(value(x - 30, y));
      }
    }
    std::array<float, 3> sums;
    simd_->multiply_by_derivatives(a.data(), b.data(), stride, patch.data() + 2 * read_stride + 2, read_stride, width,
                                   height, sums.data());
    std::array<double, 3> expected{};
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(y * stride + x);
        const double along_x = 3e-3 * (x - 30) * (x - 30) + 0.02 * y + 1, along_y = 0.02 * (x - 30) - 3e-2 * y * y;
        expected[0] += a[i] * along_x;
        expected[1] += a[i] * along_y + b[i] * along_x;
        expected[2] += b[i] * along_y;
      }
    }
    for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(sums[k], expected[k], 2e-3) << width;
  }
}

TEST_P(AlignmentSimdTest, SumProductsOfAnyWidth) {
  for (int width = 1; width <= 70; ++width) {
    const int height = 1 + width % 5, stride = width + kPatchRoom;
    const std::vector<float> a = random_patch(width, height, false), b = random_patch(width, height, false),
                             c = random_patch(width, height, true), d = random_patch(width, height, true),
                             e = random_patch(width, height, true);
    const std::array<const float*, 3> factors{c.data(), d.data(), e.data()};
    std::array<float, 3> projected, multiplied;
    simd_->project(a.data(), stride, factors.data(), stride, width, height, projected.data());
    simd_->multiply_gradients(a.data(), b.data(), c.data(), d.data(), stride, width, height, multiplied.data());
    std::array<double, 3> of_projection{}, of_gradients{};
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(y * stride + x);
        for (std::size_t k = 0; k < 3; ++k) of_projection[k] += a[i] * factors[k][i];
        of_gradients[0] += a[i] * c[i];
        of_gradients[1] += a[i] * d[i] + b[i] * c[i];
        of_gradients[2] += b[i] * d[i];
      }
    }
    for (std::size_t k = 0; k < 3; ++k) {
      ASSERT_NEAR(projected[k], of_projection[k], 1e-4) << width;
      ASSERT_NEAR(multiplied[k], of_gradients[k], 1e-4) << width;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, AlignmentSimdTest, testing::ValuesIn(test::kInstructionSets));

TEST(AlignmentSimd, OfTheWidestSetAreTheBest) {
  const char* widest = "baseline";
  for (const char* name : test::kInstructionSets) widest = find_for_cpu<AlignmentSimd>(name) != nullptr ? name : widest;
  EXPECT_STREQ(select_for_cpu<AlignmentSimd>().name, widest);
}

}  // namespace
}  // namespace gyro_deblur::alignment_simd_test
