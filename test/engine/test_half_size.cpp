// Images at half their size, and back.
#include "engine/half_size.hpp"

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "images.hpp"
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

cv::Mat doubled(const cv::Mat& half, const cv::Rect& rect) {
  cv::Mat result(rect.size(), CV_32F);
  std::vector<float> scratch;
  const cv::Rect part = needed_of_half(rect, half.size());
  double_size(part, half(part).clone().ptr<float>(), rect, scratch, result.ptr<float>());
  return result;
}

TEST(HalfSize, LeavesOfAWaveWhatIsSaid) {
  const cv::Size size(200, 160);
  for (const auto& [fx, fy] :
       {std::pair(0.03, 0.0), std::pair(0.0, 0.12), std::pair(0.15, 0.2), std::pair(0.2, -0.1)}) {
    cv::Mat half;
    downsample2x(wave(size, fx, fy), 2, half);
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
TEST(HalfSize, ComesBack) {
  const cv::Size size(121, 90);
  const double fx = 0.05, fy = 0.04;
  const cv::Mat image = wave(size, fx, fy);
  cv::Mat half;
  downsample2x(image, 1, half);
  ASSERT_EQ(half.size(), cv::Size(61, 45));
  const double left = std::pow(lowpass_response(fx) * lowpass_response(fy), 2);
  for (const cv::Rect& rect : {cv::Rect(20, 20, 70, 50), cv::Rect(21, 31, 1, 1), cv::Rect(33, 40, 8, 3)}) {
    const cv::Mat result = doubled(half, rect);
    for (int y = 0; y < rect.height; ++y) {
      for (int x = 0; x < rect.width; ++x) {
        const double wave_here = image.at<std::uint16_t>(rect.y + y, rect.x + x) - 32768.0;
        // What is mirrored at 0.25 cycles/px adds up to 2 % along each axis.
        ASSERT_NEAR(result.at<float>(y, x), 32768 + left * wave_here, 0.04 * 30000) << rect << " at " << x << ", " << y;
      }
    }
  }
}

TEST(HalfSize, KeepsAConstantImageUpToItsEdges) {
  for (const cv::Size& size : {cv::Size(1, 1), cv::Size(2, 1), cv::Size(1, 5), cv::Size(7, 4), cv::Size(64, 33)}) {
    const cv::Mat image(size, CV_8UC1, cv::Scalar(201));
    cv::Mat half;
    downsample2x(image, 1, half);
    const cv::Mat result = doubled(half, cv::Rect({}, size));
    EXPECT_LT(cv::norm(result, cv::Mat(size, CV_32F, cv::Scalar(201)), cv::NORM_INF), 1e-3) << size;
  }
}

TEST(HalfSize, ComesBackInPiecesAsItDoesWhole) {
  for (const cv::Size& size : {cv::Size(37, 23), cv::Size(24, 9), cv::Size(3, 1)}) {
    cv::Mat half;
    downsample2x(test::textured_image(size.width, size.height, 4), 1, half);
    const cv::Mat whole = doubled(half, cv::Rect({}, size));
    for (int y = 0; y < size.height; y += 5) {
      for (int x = 0; x < size.width; x += 7) {
        const cv::Rect piece = cv::Rect(x, y, 7, 5) & cv::Rect({}, size);
        EXPECT_TRUE(test::equal(doubled(half, piece), whole(piece).clone())) << size << ", " << piece;
      }
    }
  }
}

TEST(HalfSize, DoesNotDependOnThreads) {
  const cv::Mat image = test::textured_image(301, 203, 4);
  cv::Mat alone, together;
  downsample2x(image, 1, alone);
  downsample2x(image, 4, together);
  EXPECT_TRUE(test::equal(alone, together));
}

}  // namespace
}  // namespace gyro_deblur::half_size_test
