// Transforms of tiles, for every instruction set that this processor runs.
#include "base/fourier_simd.hpp"

#include <cmath>
#include <complex>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "compiled_sets.hpp"

namespace gyro_deblur::fourier_test {
namespace {

using Gain = cv::Mat_<std::complex<double>>;  // frequencies v down, u across, as cv::dft has them

TEST(FourierSize, HasNoFactorsButTwoThreeAndFive) {
  for (const auto& [length, size] : {std::pair(1, 32), std::pair(32, 32), std::pair(33, 64), std::pair(178, 192),
                                     std::pair(193, 256), std::pair(257, 288), std::pair(1000, 1024)}) {
    EXPECT_EQ(fourier_size(length), size) << length;
  }
  EXPECT_EQ(fourier_size(kMaxFourierSize), kMaxFourierSize);
}

TEST(FourierPlan, HasAPlaceForEveryFrequency) {
  for (int size = kFourierStep; size <= kMaxFourierSize; size = fourier_size(size + 1)) {
    for (const int largest_radix : {4, 8}) {
      const FourierPlan plan(size, largest_radix);
      std::vector<int> taken(size);
      for (int k = 0; k < size; ++k) ++taken.at(plan.stages().places[k]);
      EXPECT_EQ(taken, std::vector<int>(size, 1)) << size;
    }
  }
}

class FourierTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<FourierSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }

  /// `image` times `gain` in the frequency domain, columns first_col to end_col of it.
  cv::Mat filtered(const cv::Mat& image, const Gain& gain, int first_col, int end_col) const {
    const int cols = image.cols, rows = image.rows, lanes = simd_->lanes;
    const FourierPlan across(cols, simd_->largest_radix), down(rows, simd_->largest_radix);
    const FourierTile plan{across.stages(), down.stages()};
    // OpenCV's matrices begin on a cache line.
    cv::Mat tile(rows, fourier_stride(cols), CV_32F), scratch(1, fourier_scratch(std::max(cols, rows)), CV_32F);
    cv::Mat in_places(cols, 2 * lanes, CV_32F);
    image.convertTo(tile(cv::Rect(0, 0, cols, rows)), CV_32F);
    simd_->transform_columns(plan, tile.ptr<float>(), scratch.ptr<float>());
    for (int row = 0; row < rows / 2; row += lanes) {
      for (int u = 0; u < cols; ++u) {
        float* to = in_places.ptr<float>(plan.across.places[u]);
        for (int i = 0; i < lanes; ++i) {
          to[i] = static_cast<float>(gain(row + i, u).real());
          to[lanes + i] = static_cast<float>(gain(row + i, u).imag());
        }
      }
      simd_->filter_rows(plan, row, in_places.ptr<float>(), first_col, end_col, tile.ptr<float>(),
                         scratch.ptr<float>());
    }
    simd_->restore_columns(plan, first_col, end_col, tile.ptr<float>(), scratch.ptr<float>());
    return tile(cv::Rect(first_col, 0, end_col - first_col, rows)).clone();
  }

  const FourierSimd* simd_ = nullptr;
};

/// A gain without half a cycle a pixel for tiles of real numbers.
Gain random_gain(cv::Size size, cv::RNG& random) {
  const int cols = size.width, rows = size.height;
  Gain gain(rows, cols, std::complex<double>(0));
  for (int v = 0; v < rows / 2; ++v) {
    for (int u = v == 0 ? 0 : 1 - cols / 2; u < cols / 2; ++u) {
      const bool is_real = u == 0 && v == 0;
      const std::complex<double> value(random.uniform(-1.0, 1.0), is_real ? 0 : random.uniform(-1.0, 1.0));
      gain(v, (u + cols) % cols) = value;
      gain((rows - v) % rows, (cols - u) % cols) = std::conj(value);
    }
  }
  return gain;
}

TEST_P(FourierTest, MultiplyByAGainAsOpenCvDoes) {
  cv::RNG random(7);
  std::vector<cv::Size> sizes = {{32, 160}, {480, 32}, {96, 128}};
  for (const int size : {32, 64, 96, 128, 160, 192, 256, 288, 320, 480, 512, 640}) sizes.emplace_back(size, size);
  for (const cv::Size& size : sizes) {
    cv::Mat image(size, CV_64F), spectrum, expected;
    random.fill(image, cv::RNG::UNIFORM, -128.0, 128.0);
    const Gain gain = random_gain(size, random);
    cv::dft(image, spectrum, cv::DFT_COMPLEX_OUTPUT);
    spectrum.forEach<std::complex<double>>([&](std::complex<double>& z, const int* at) { z *= gain(at[0], at[1]); });
    cv::dft(spectrum, expected, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
    for (const auto& [first, end] : {std::pair(0, size.width), std::pair(7, size.width / 2 + 3)}) {
      cv::Mat difference;
      cv::subtract(filtered(image, gain, first, end), expected.colRange(first, end), difference, cv::noArray(), CV_64F);
      // A float holds 128 to 8e-6; errors grow with the root of the number of stages.
      EXPECT_LT(cv::norm(difference, cv::NORM_INF), 4e-4) << size;
      EXPECT_LT(cv::norm(difference) / std::sqrt(static_cast<double>(difference.total())), 3e-5) << size;
    }
  }
}

TEST_P(FourierTest, HavePowersAsOpenCvHas) {
  cv::RNG random(8);
  for (const cv::Size& size : {cv::Size(32, 32), cv::Size(128, 128), cv::Size(96, 160)}) {
    cv::Mat image(size, CV_64F), expected;
    random.fill(image, cv::RNG::UNIFORM, -128.0, 128.0);
    cv::dft(image, expected, cv::DFT_COMPLEX_OUTPUT);
    const FourierPlan across(size.width, simd_->largest_radix), down(size.height, simd_->largest_radix);
    const FourierTile plan{across.stages(), down.stages()};
    cv::Mat tile(size.height, fourier_stride(size.width), CV_32F), powers(size.width, size.height / 2, CV_32F);
    cv::Mat scratch(1, fourier_scratch(std::max(size.width, size.height)), CV_32F);
    image.convertTo(tile(cv::Rect({}, size)), CV_32F);
    simd_->transform_columns(plan, tile.ptr<float>(), scratch.ptr<float>());
    for (int row = 0; row < size.height / 2; row += simd_->lanes) {
      simd_->row_powers(plan, row, tile.ptr<float>(), powers.ptr<float>(), scratch.ptr<float>());
    }
    // Random pixels have this power on average.
    const double mean = 128.0 * 128.0 / 3 * size.area();
    for (int u = 0; u < size.width; ++u) {
      for (int v = 0; v < size.height / 2; ++v) {
        const double power = std::norm(expected.at<std::complex<double>>(v, u));
        ASSERT_NEAR(powers.at<float>(u, v), power, 1e-5 * (power + mean)) << size << " at " << u << ", " << v;
      }
    }
  }
}

TEST_P(FourierTest, RotateAndScaleAWave) {
  const int size = 96;
  for (const auto& [u, v] : {std::pair(5, 0), std::pair(0, 7), std::pair(-3, 11), std::pair(47, 47)}) {
    const std::complex<double> factor = std::polar(1.5, 0.7);
    cv::Mat wave(size, size, CV_64F), expected(size, size, CV_64F);
    for (int y = 0; y < size; ++y) {
      for (int x = 0; x < size; ++x) {
        const double angle_rad = 2 * CV_PI * (u * x + v * y) / size;
        wave.at<double>(y, x) = std::cos(angle_rad);
        expected.at<double>(y, x) = 1.5 * std::cos(angle_rad + 0.7);
      }
    }
    Gain gain(size, size, std::complex<double>(0));
    gain(v, (u + size) % size) = factor;
    gain((size - v) % size, (size - u) % size) = std::conj(factor);
    cv::Mat difference;
    cv::subtract(filtered(wave, gain, 0, size), expected, difference, cv::noArray(), CV_64F);
    EXPECT_LT(cv::norm(difference, cv::NORM_INF), 3e-6) << u << ", " << v;
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, FourierTest, testing::ValuesIn(test::kInstructionSets));

TEST(Fourier, LoopsOfTheWidestSetAreTheBest) {
  const char* widest = "baseline";
  for (const char* name : test::kInstructionSets) widest = find_for_cpu<FourierSimd>(name) != nullptr ? name : widest;
  EXPECT_STREQ(select_for_cpu<FourierSimd>().name, widest);
}

}  // namespace
}  // namespace gyro_deblur::fourier_test
