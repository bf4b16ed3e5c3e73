// Images at half their size, and back.
#include "engine/half_size.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "compiled_sets.hpp"
#include "images.hpp"
#include "naive_convolution.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::half_size_test {
namespace {

/// A wave of (fx, fy) cycles/px around the middle of the range.
cv::Mat wave(cv::Size size, double fx, double fy) {
  cv::Mat image(size, CV_16UC1);
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      image.at<std::uint16_t>(y, x) =
          cv::saturate_cast<std::uint16_t>(32768 + 30000 * std::cos(2 * CV_PI * (fx * x + fy * y)));
    }
  }
  return image;
}

cv::Mat doubled(const cv::Mat& half, const cv::Rect& rect, const HalfSizeSimd& simd) {
  cv::Mat result(rect.size(), CV_32F);
  std::vector<float> scratch;
  const cv::Rect part = needed_of_half(rect, half.size());
  double_size(part, half(part).clone().ptr<float>(), rect, scratch, result.ptr<float>(), simd);
  return result;
}

class HalfSizeTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<HalfSizeSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }

  cv::Mat halved(const cv::Mat& image, int threads = 1) const {
    cv::Mat half;
    downsample2x(image, threads, half, *simd_);
    return half;
  }

  const HalfSizeSimd* simd_ = nullptr;
};

TEST_P(HalfSizeTest, IsTheLowPassAtEverySecondPixel) {
  for (const cv::Size& size : {cv::Size(75, 40), cv::Size(64, 1), cv::Size(6, 5), cv::Size(1, 1)}) {
    for (const int type : {CV_8UC1, CV_16UC1}) {
      const cv::Mat image = test::random_image(size.width, size.height, type, 3), half = halved(image);
      ASSERT_EQ(half.size(), cv::Size((size.width + 1) / 2, (size.height + 1) / 2));
      for (int y = 0; y < half.rows; ++y) {
        for (int x = 0; x < half.cols; ++x) {
          double expected = 0;
          for (int i = 0; i < kHalvingTapCount; ++i) {
            for (int k = 0; k < kHalvingTapCount; ++k) {
              const int at_x = std::clamp(2 * x - 3 + k, 0, size.width - 1),
                        at_y = std::clamp(2 * y - 3 + i, 0, size.height - 1);
              expected += static_cast<double>(kHalvingTaps[i]) * kHalvingTaps[k] * test::pixel_at(image, at_x, at_y, 0);
            }
          }
          ASSERT_NEAR(half.at<float>(y, x), expected, type == CV_8UC1 ? 1e-4 : 0.03)
              << size << " at " << x << ", " << y;
        }
      }
    }
  }
}

TEST_P(HalfSizeTest, IsDoubledByTheLowPassBetweenZeros) {
  cv::Mat half(21, 38, CV_32F);
  cv::RNG(5).fill(half, cv::RNG::UNIFORM, -200.0, 200.0);
  for (const cv::Rect& rect :
       {cv::Rect(0, 0, 76, 42), cv::Rect(0, 0, 75, 41), cv::Rect(3, 5, 40, 20), cv::Rect(9, 0, 1, 1)}) {
    const cv::Mat result = doubled(half, rect, *simd_);
    for (int y = 0; y < rect.height; ++y) {
      for (int x = 0; x < rect.width; ++x) {
        const auto for_taps = [](int at, const auto& add) {
          for (int i = at / 2 - 4; i <= at / 2 + 4; ++i) {
            const int k = at - 2 * i + 3;
            if (k >= 0 && k < kHalvingTapCount) add(i, 2.0 * kHalvingTaps[k]);
          }
        };
        double expected = 0;
        for_taps(rect.y + y, [&](int at_y, double tap_y) {
          for_taps(rect.x + x, [&](int at_x, double tap_x) {
            expected +=
                tap_x * tap_y * half.at<float>(std::clamp(at_y, 0, half.rows - 1), std::clamp(at_x, 0, half.cols - 1));
          });
        });
        ASSERT_NEAR(result.at<float>(y, x), expected, 3e-4) << rect << " at " << x << ", " << y;
      }
    }
  }
}

TEST_P(HalfSizeTest, LeavesOfAWaveWhatIsSaid) {
  const cv::Size size(200, 160);
  for (const auto& [fx, fy] :
       {std::pair(0.03, 0.0), std::pair(0.0, 0.12), std::pair(0.15, 0.2), std::pair(0.2, -0.1)}) {
    const cv::Mat half = halved(wave(size, fx, fy), 2);
    ASSERT_EQ(half.size(), cv::Size(100, 80));
    const double left = 30000 * lowpass_response(fx) * lowpass_response(fy);
    for (int y = 3; y < half.rows - 3; ++y) {
      for (int x = 3; x < half.cols - 3; ++x) {
        const double expected = 32768 + left * std::cos(2 * CV_PI * (fx * (2 * x + 0.5) + fy * (2 * y + 0.5)));
        ASSERT_NEAR(half.at<float>(y, x), expected, 2) << fx << ", " << fy << " at " << x << ", " << y;
      }
    }
  }
}

// Of fine detail hardly anything comes back as coarse.
TEST(HalfSize, KeepsOutWhatItCannotShow) {
  for (const double f : {0.3, 0.35, 0.4, 0.5}) {
    EXPECT_LT(std::abs(lowpass_response(f)), 0.09 * lowpass_response(0.5 - f)) << f;
  }
  EXPECT_NEAR(lowpass_response(0), 1, 1e-6);
}

// A slow wave comes back with what is left of it twice, in any piece.
TEST_P(HalfSizeTest, ComesBack) {
  const cv::Size size(121, 90);
  const double fx = 0.05, fy = 0.04;
  const cv::Mat image = wave(size, fx, fy);
  const cv::Mat half = halved(image);
  ASSERT_EQ(half.size(), cv::Size(61, 45));
  const double left = std::pow(lowpass_response(fx) * lowpass_response(fy), 2);
  for (const cv::Rect& rect : {cv::Rect(20, 20, 70, 50), cv::Rect(21, 31, 1, 1), cv::Rect(33, 40, 8, 3)}) {
    const cv::Mat result = doubled(half, rect, *simd_);
    for (int y = 0; y < rect.height; ++y) {
      for (int x = 0; x < rect.width; ++x) {
        const double wave_here = image.at<std::uint16_t>(rect.y + y, rect.x + x) - 32768.0;
        // What is mirrored at 0.25 cycles/px adds up to 2 % along each axis.
        ASSERT_NEAR(result.at<float>(y, x), 32768 + left * wave_here, 0.04 * 30000) << rect << " at " << x << ", " << y;
      }
    }
  }
}

TEST_P(HalfSizeTest, KeepsAConstantImageUpToItsEdges) {
  for (const cv::Size& size : {cv::Size(1, 1), cv::Size(2, 1), cv::Size(1, 5), cv::Size(7, 4), cv::Size(64, 33)}) {
    const cv::Mat image(size, CV_8UC1, cv::Scalar(201));
    const cv::Mat half = halved(image);
    const cv::Mat result = doubled(half, cv::Rect({}, size), *simd_);
    EXPECT_LT(cv::norm(result, cv::Mat(size, CV_32F, cv::Scalar(201)), cv::NORM_INF), 1e-3) << size;
  }
}

TEST_P(HalfSizeTest, ComesBackInPiecesAsItDoesWhole) {
  for (const cv::Size& size : {cv::Size(37, 23), cv::Size(24, 9), cv::Size(3, 1)}) {
    const cv::Mat half = halved(test::textured_image(size.width, size.height, 4));
    const cv::Mat whole = doubled(half, cv::Rect({}, size), *simd_);
    for (int y = 0; y < size.height; y += 5) {
      for (int x = 0; x < size.width; x += 7) {
        const cv::Rect piece = cv::Rect(x, y, 7, 5) & cv::Rect({}, size);
        EXPECT_TRUE(test::equal(doubled(half, piece, *simd_), whole(piece).clone())) << size << ", " << piece;
      }
    }
  }
}

TEST_P(HalfSizeTest, DoesNotDependOnThreads) {
  const cv::Mat image = test::textured_image(301, 203, 4);
  EXPECT_TRUE(test::equal(halved(image, 1), halved(image, 4)));
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, HalfSizeTest, testing::ValuesIn(test::kInstructionSets));

}  // namespace
}  // namespace gyro_deblur::half_size_test
