// The loops that validation by likelihood spends its time in, for every instruction set that this processor runs.
#include "blur/spectrum_simd.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "blur/blur_likelihood.hpp"

namespace gyro_deblur::spectrum_simd_test {
namespace {

class SpectrumSimdTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<SpectrumSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }
  const SpectrumSimd* simd_ = nullptr;
  std::mt19937 random_{5};
};

TEST_P(SpectrumSimdTest, ClipOutliers) {
  std::uniform_int_distribution<int> grey(0, 255);
  for (const int width : {1, 2, 3, 16, 63, 64, 65, 66, 67, 200}) {
    for (const int margin : {0, 7, 255}) {
      std::vector<std::vector<std::uint8_t>> rows(3, std::vector<std::uint8_t>(width));
      for (auto& row : rows) std::generate(row.begin(), row.end(), [&] { return grey(random_); });
      std::vector<std::uint8_t> out(width);
      simd_->clip_outliers(rows[0].data(), rows[1].data(), rows[2].data(), width, margin, out.data());
      for (int x = 0; x < width; ++x) {
        std::vector<int> around;
        for (int y = 0; y < 3; ++y) {
          for (int dx = -1; dx <= 1; ++dx) {
            if (y != 1 || dx != 0) around.push_back(rows[y][std::clamp(x + dx, 0, width - 1)]);
          }
        }
        std::sort(around.begin(), around.end());
        const int top = std::min(around[6] + margin, 255), bottom = std::max(around[1] - margin, 0);
        ASSERT_EQ(out[x], std::max(std::min<int>(rows[1][x], top), bottom)) << x << " of " << width;
      }
    }
  }
}

TEST_P(SpectrumSimdTest, PowerSpectrum) {
  constexpr int kStride = kSpectrumWindow + 3;
  std::vector<std::uint8_t> window(kStride * kSpectrumWindow);
  std::uniform_int_distribution<int> grey(0, 255);
  std::generate(window.begin(), window.end(), [&] { return grey(random_); });
  std::vector<float> power(kSpectrumSize);
  simd_->power_spectrum(spectrum_tables(), window.data(), kStride, power.data());

  const auto hann = [](int i) { return std::pow(std::sin(CV_PI * (i + 0.5) / kSpectrumWindow), 2); };
  const double mean_square = std::pow(3.0 / 8, 2) * kSpectrumWindow * kSpectrumWindow;
  for (const auto& [x, y] : {std::pair(0, 3), {1, 0}, {1, 1}, {5, 2}, {15, 15}, {7, -1}, {15, -15}, {4, -9}}) {
    std::complex<double> sum = 0;
    for (int row = 0; row < kSpectrumWindow; ++row) {
      for (int col = 0; col < kSpectrumWindow; ++col) {
        sum += std::polar(hann(row) * hann(col) * (window[row * kStride + col] - 128),
                          -2 * CV_PI * (x * col + y * row) / kSpectrumWindow);
      }
    }
    const int at = (y < 0 ? kSpectrumSize / 2 : 0) + std::abs(y) * kSpectrumWaves + x;
    const double expected = std::norm(sum) / mean_square;
    EXPECT_NEAR(power[at], expected, 1e-4 * expected + 0.01) << x << ", " << y;
  }
}

TEST_P(SpectrumSimdTest, MultiplyGain) {
  std::vector<float> texture(kSpectrumSize), gain(100), model(kSpectrumSize);
  for (int i = 0; i < kSpectrumSize; ++i) texture[i] = static_cast<float>(i + 1);
  for (int i = 0; i < 100; ++i) gain[i] = static_cast<float>(i * i);
  constexpr float kX = -3.01f, kY = 2.02f;
  simd_->multiply_gain(texture.data(), gain.data(), kX, kY, model.data());
  for (int i = 0; i < kSpectrumSize; ++i) {
    const int x = i % kSpectrumWaves, row = i / kSpectrumWaves;
    const int y = row < kSpectrumWaves ? row : kSpectrumWaves - row;
    const auto bin = static_cast<int>(std::lround(std::abs(x * kX + y * kY)));
    ASSERT_EQ(model[i], texture[i] * static_cast<float>(bin * bin)) << x << ", " << y;
  }
}

// A path that reverses, from its definition: the mean of exp(-2 pi i f p) over many instants.
TEST_P(SpectrumSimdTest, MultiplyPathGain) {
  constexpr int kSegments = kPathInstants - 1, kInstants = 400;
  constexpr float kLeft = 0.01f;
  constexpr double kScale = 0.5;
  Path2d path_px;
  std::array<Eigen::Vector2d, kPathInstants> places;  // in windows
  for (int k = 0; k < kPathInstants; ++k) {
    const float angle_rad = 0.3f * static_cast<float>(k);
    path_px[k] = 18 * Eigen::Vector2f(std::cos(angle_rad), 0.4f - std::sin(angle_rad));
    places[k] = kScale / kSpectrumWindow * path_px[k].cast<double>();
  }
  const auto power_at = [&](int x, int y) {
    std::complex<double> sum = 0;
    for (int k = 0; k < kSegments; ++k) {
      for (int i = 0; i < kInstants; ++i) {
        const Eigen::Vector2d place = places[k] + (i + 0.5) / kInstants * (places[k + 1] - places[k]);
        sum += std::polar(1.0, -2 * CV_PI * (x * place.x() + y * place.y()));
      }
    }
    return std::norm(sum / static_cast<double>(kSegments * kInstants));
  };
  const auto smeared_at = [&](int x, int y) {
    double sum = 0;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) sum += (dx == 0 ? 4 : 1) * (dy == 0 ? 4 : 1) * power_at(x + dx, y + dy);
    }
    return sum / 36;
  };
  std::vector<float> texture(kSpectrumSize), model(kSpectrumSize);
  for (int i = 0; i < kSpectrumSize; ++i) texture[i] = static_cast<float>(i + 1);
  simd_->multiply_path_gain(texture.data(), phases_of(path_px, kScale), kLeft, model.data());
  for (const auto& [x, y] : {std::pair(0, 3), {1, 0}, {1, 1}, {5, 2}, {15, 15}, {7, -1}, {15, -15}, {0, -9}, {4, -9}}) {
    const int at = (y < 0 ? kSpectrumSize / 2 : 0) + std::abs(y) * kSpectrumWaves + x;
    const double expected = smeared_at(x, y) + kLeft;
    EXPECT_NEAR(model[at] / texture[at], expected, 1e-3 * expected + 1e-4) << x << ", " << y;
  }
}

TEST_P(SpectrumSimdTest, LeastCost) {
  // Where the power is what a factor makes of the model, that factor is found, and the cost is that of P = S.
  std::vector<float> model(kSpectrumSize), power(kSpectrumSize);
  constexpr double kFactor = 250;
  double expected = 0;
  for (int i = 0; i < kSpectrumSize; ++i) {
    model[i] = i % 7 == 0 ? 0 : static_cast<float>(1.0 / (1 + i));
    const double spectrum = kFactor * model[i] + 1;
    power[i] = static_cast<float>(spectrum);
    expected += 2 * std::log(2 * spectrum) - std::log(spectrum);
  }
  for (const double start : {0.1, 1.0, 30.0}) {
    double log_factor = std::log(kFactor * start);
    double cost = 0;
    for (int i = 0; i < 3; ++i) cost = simd_->least_cost(power.data(), model.data(), &log_factor);
    EXPECT_NEAR(std::exp(log_factor), kFactor, 0.01 * kFactor);
    EXPECT_NEAR(cost, expected, 0.01);
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, SpectrumSimdTest, testing::Values("baseline", "avx2", "avx512"));

}  // namespace
}  // namespace gyro_deblur::spectrum_simd_test
