// The loops that align blurred patches, for every instruction set that this processor runs.
#include "features/alignment_simd.hpp"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Dense>

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
    const int height = 1 + width % 9, read_stride = width + 3 + kPatchRoom, stride = width + kPatchRoom;
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

/// Lagrange's interpolation of six pixels.
class QuinticInterpolation {
 public:
  QuinticInterpolation() {
    for (int i = 0; i <= kInterpolationSteps; ++i) {
      for (int k = 0; k < kInterpolationStride; ++k) {
        const double fraction = static_cast<double>(i) / kInterpolationSteps;
        table_.push_back(k < kInterpolationTaps ? static_cast<float>(weight(k, fraction)) : 0);
      }
    }
    weights_.table = table_.data();
    const Eigen::Vector3d s(0.1, 0.3, 0.5), square = s.cwiseAbs2();
    Eigen::Matrix3d powers;
    powers << Eigen::Vector3d::Ones(), square, square.cwiseAbs2();
    for (int k = 0; k < kInterpolationTaps / 2; ++k) {
      const auto of = [k](double at) { return weight(kInterpolationTaps - 1 - k, 0.5 + at); };
      const Eigen::Vector3d above = s.unaryExpr(of), below = (-s).unaryExpr(of);
      const Eigen::Vector3d even = powers.inverse() * (above + below) / 2,
                            odd = powers.inverse() * (above - below).cwiseQuotient(2 * s);
      for (int i = 0; i < 3; ++i) {
        weights_.even[k][i] = static_cast<float>(even[i]);
        weights_.odd[k][i] = static_cast<float>(odd[i]);
      }
    }
  }
  const Interpolation& weights() const { return weights_; }

 private:
  static double weight(int k, double fraction) {
    double product = 1;
    for (int other = 0; other < kInterpolationTaps; ++other) {
      if (other != k) product *= (2 + fraction - other) / (k - other);
    }
    return product;
  }
  std::vector<float> table_;
  Interpolation weights_{};
};

TEST_P(AlignmentSimdTest, SampleWithTheWeightsOfBothFractions) {
  // Of such a surface they are exact, in whatever order and along whichever rows.
  const QuinticInterpolation quintic;
  constexpr int kWidth = 150, kHeight = 60, kStride = kWidth + kPatchRoom, kMostSamples = 40;
  std::vector<float> pixels = random_patch(kWidth, kHeight, false);
  const auto value = [](float x, float y) {
    const float u = (x - 60) / 40, v = (y - 25) / 20;
    return u * u * u * v * v - 2 * v * v * v * v * u + v * v + 3 * u + 1;
  };
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      pixels[static_cast<std::size_t>(y * kStride + x)] = value(static_cast<float>(x), static_cast<float>(y));
    }
  }
  const std::array<std::array<float, 2>, 8> steps{{{1, 0},
                                                   {1.0625f, 0.125f},
                                                   {0.9375f, -0.1875f},
                                                   {1, 0.5f},
                                                   {2.125f, 0.0625f},
                                                   {3, -0.25f},
                                                   {0.25f, 0.75f},
                                                   {-1, 0.125f}}};
  for (const auto& [dx, dy] : steps) {
    for (const int width : {1, 3, 8, 13, 17, 36, kMostSamples}) {
      const SampleGrid grid{width, 6, dx > 0 ? 1.25f : 60.75f, dy > 0 ? 2.5f : 20.5f, dx, dy, 0.0625f, 1.0625f};
      const int stride = width + kPatchRoom;
      std::vector<float> sampled(static_cast<std::size_t>(stride * grid.height));
      simd_->sample(pixels.data(), kStride, quintic.weights(), grid, sampled.data(), stride);
      for (int k = 0; k < grid.height; ++k) {
        for (int i = 0; i < width; ++i) {
          const float at_x = grid.x + static_cast<float>(i) * dx + static_cast<float>(k) * grid.row_dx,
                      at_y = grid.y + static_cast<float>(i) * dy + static_cast<float>(k) * grid.row_dy;
          ASSERT_NEAR(sampled[static_cast<std::size_t>(k * stride + i)], value(at_x + 2, at_y + 2), 2e-3f)
              << width << ", " << dx << ", " << dy << ": " << i << ", " << k;
        }
      }
    }
  }
}

TEST_P(AlignmentSimdTest, ConvolvePairsOfAnyWidth) {
  const std::array<int, 3> columns{0, 2, 3}, rows{0, 1, 2};
  const std::array<int, 3> first{16384, 5, 32767}, second{0, 32767, 8192};
  constexpr float kScale = 1.0f / 65536;
  for (int width = 1; width <= 110; ++width) {
    for (const bool is_below : {false, true}) {
      const int height = 1 + width % 9, read_width = width + 3 + (is_below ? 0 : 1),
                read_height = height + 2 + (is_below ? 1 : 0), byte_stride = read_width + 5,
                pair_stride = read_width + kPatchRoom, stride = width + kPatchRoom;
      // Of exactly the image's size: nothing is read behind it.
      std::vector<unsigned char> bytes(static_cast<std::size_t>(byte_stride * (read_height - 1) + read_width));
      for (unsigned char& byte : bytes) byte = static_cast<unsigned char>(random_() % 256);
      std::vector<std::int32_t> pairs(static_cast<std::size_t>(pair_stride * (read_height + 1) + kPatchRoom)), weights;
      simd_->make_pairs(bytes.data(), byte_stride, is_below ? byte_stride : 1, pairs.data(), pair_stride, width + 3,
                        height + 2);
      std::vector<int> offsets;
      for (std::size_t k = 0; k < 3; ++k) {
        offsets.push_back(columns[k] + rows[k] * pair_stride);
        weights.push_back(first[k] | second[k] * (1 << 16));
      }
      std::vector<float> written(static_cast<std::size_t>(stride * height));
      simd_->convolve_pairs(pairs.data(), pair_stride, is_below ? pair_stride : 1, offsets.data(), weights.data(), 3,
                            kScale, written.data(), stride, width, height);
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          int sum = 0;
          for (std::size_t k = 0; k < 3; ++k) {
            const auto at = static_cast<std::size_t>((y + rows[k]) * byte_stride + x + columns[k]);
            sum += first[k] * bytes[at] + second[k] * bytes[at + static_cast<std::size_t>(is_below ? byte_stride : 1)];
          }
          ASSERT_FLOAT_EQ(written[static_cast<std::size_t>(y * stride + x)], kScale * static_cast<float>(sum))
              << width << ": " << x << ", " << y;
        }
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

TEST_P(AlignmentSimdTest, DisplaceAnyWidth) {
  const std::array<float, 6> b{0.01f, -0.02f, 0.03f, 0.015f, -0.005f, 0.025f};
  constexpr float kMiddleX = 7.5f, kMiddleY = 2;
  for (int width = 1; width <= 70; ++width) {
    const int height = 5, stride = width + kPatchRoom, patch_stride = width + 2 + kPatchRoom;
    const std::vector<float> patch = random_patch(width + 2, height + 2, false);
    std::vector<float> displaced = random_patch(width, height, false);
    const auto at = [&](int x, int y) { return patch[static_cast<std::size_t>((y + 1) * patch_stride + x + 1)]; };
    simd_->displace(patch.data() + patch_stride + 1, patch_stride, b.data(), kMiddleX, kMiddleY, displaced.data(),
                    stride, width, height);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double u = x - kMiddleX, v = y - kMiddleY;
        const double moved_x = b[0] * u * u + b[2] * u * v + b[4] * v * v,
                     moved_y = b[1] * u * u + b[3] * u * v + b[5] * v * v;
        const double expected =
            at(x, y) - 0.5 * (at(x + 1, y) - at(x - 1, y)) * moved_x - 0.5 * (at(x, y + 1) - at(x, y - 1)) * moved_y;
        ASSERT_NEAR(displaced[static_cast<std::size_t>(y * stride + x)], expected, 2e-4) << width << ": " << x;
      }
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
