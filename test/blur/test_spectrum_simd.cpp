// The loops that validation by likelihood spends its time in, for every instruction set that this processor runs.
#include "blur/spectrum_simd.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "blur/blur_likelihood.hpp"
#include "compiled_sets.hpp"

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

TEST_P(SpectrumSimdTest, HalvesRows) {
  std::mt19937 random(9);
  for (const int count : {1, 15, 16, 67, 200}) {
    std::vector<std::uint8_t> upper(2 * count), lower(2 * count), half(count);
    for (auto* row : {&upper, &lower}) {
      std::generate(row->begin(), row->end(), [&random] { return static_cast<std::uint8_t>(random() % 256); });
    }
    simd_->halve(upper.data(), lower.data(), count, half.data());
    for (int x = 0; x < count; ++x) {
      const int sum = upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1];
      EXPECT_EQ(half[x], (sum + 2) / 4) << x << " of " << count;
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
  const SpectrumOrder& order = spectrum_order();
  std::vector<float> gain(100), model(kSpectrumPlaces);
  for (int i = 0; i < 100; ++i) gain[i] = static_cast<float>(i * i);
  constexpr float kX = -3.01f, kY = 2.02f;
  simd_->multiply_gain(order, gain.data(), kX, kY, model.data());
  for (int i = 0; i < kSpectrumPlaces; ++i) {
    const auto bin = static_cast<int>(std::lround(std::abs(order.across[i] * kX + order.down[i] * kY)));
    ASSERT_EQ(model[i], order.texture[i] * static_cast<float>(bin * bin)) << order.across[i] << ", " << order.down[i];
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
  const SpectrumOrder& order = spectrum_order();
  std::vector<float> model(kSpectrumPlaces);
  simd_->multiply_path_gain(order, phases_of(path_px, kScale), kLeft, model.data());
  for (int i = 0; i < kSpectrumPlaces; ++i) {
    if (order.texture[i] == 0) {
      ASSERT_EQ(model[i], 0);
      continue;
    }
    const auto x = static_cast<int>(order.across[i]), y = static_cast<int>(order.down[i]);
    const double expected = smeared_at(x, y) + kLeft;
    ASSERT_NEAR(model[i] / order.texture[i], expected, 1e-3 * expected + 1e-4) << x << ", " << y;
  }
}

/// The cost from its definition, in double precision.
double expected_cost(const std::vector<float>& power, const std::vector<float>& model, const TextureFit& fit) {
  constexpr double kSectorStddev = 1, kExponentStddev = 0.5;
  double cost = 0.5 * std::pow(fit.exponent / kExponentStddev, 2);
  for (const double log_of_sector : fit.log_of_sector) cost += 0.5 * std::pow(log_of_sector / kSectorStddev, 2);
  for (int i = 0; i < kSpectrumPlaces; ++i) {
    const double log_texture = fit.log_power + fit.log_of_sector[i % kSpectrumSectors] +
                               fit.exponent * static_cast<double>(spectrum_order().log_frequency[i]);
    const double spectrum = std::exp(log_texture) * model[i] + 1;
    cost += 2 * std::log(spectrum + power[i]) - std::log(spectrum);
  }
  return cost;
}

// Of a texture with more power in some directions than in others, seen through noise.
TEST_P(SpectrumSimdTest, LeastCost) {
  const SpectrumOrder& order = spectrum_order();
  std::vector<float> model(order.texture, order.texture + kSpectrumPlaces), power(kSpectrumPlaces);
  std::uniform_real_distribution<double> uniform(0.01, 0.99);
  for (int i = 0; i < kSpectrumPlaces; ++i) {
    const double log_texture = 9 + 1.5 * std::cos(i % kSpectrumSectors) - 0.4 * order.log_frequency[i],
                 u = uniform(random_);
    if (order.texture[i] > 0) power[i] = static_cast<float>((std::exp(log_texture) * model[i] + 1) * u / (1 - u));
  }
  for (const double start : {6.0, 9.0, 12.0}) {
    TextureFit fit;
    fit.log_power = start;
    const double cost = simd_->least_cost(order, power.data(), model.data(), 12, &fit);
    EXPECT_NEAR(cost, expected_cost(power, model, fit), 0.01);
    EXPECT_NEAR(fit.exponent, -0.4, 0.2);
    for (int k = 0; k < kSpectrumSectors; ++k) {
      EXPECT_NEAR(fit.log_power + fit.log_of_sector[k], 9 + 1.5 * std::cos(k), 0.6) << "sector " << k;
    }
    // It is a minimum: along no parameter is there a lower cost.
    for (const double step : {-0.05, 0.05}) {
      TextureFit other = fit;
      other.log_power += step;
      EXPECT_GT(expected_cost(power, model, other), cost);
      other = fit;
      other.exponent += step;
      EXPECT_GT(expected_cost(power, model, other), cost);
      for (int k = 0; k < kSpectrumSectors; ++k) {
        other = fit;
        other.log_of_sector[k] += step;
        EXPECT_GT(expected_cost(power, model, other), cost) << "sector " << k;
      }
    }
  }
}

TEST(SpectrumOrder, HasEachFrequencyOfAHalfPlaneOnce) {
  const SpectrumOrder& order = spectrum_order();
  std::set<std::pair<int, int>> seen;
  std::array<double, kSpectrumSectors> least, most;
  least.fill(10);
  most.fill(-10);
  double sum_of_logs = 0;
  for (int i = 0; i < kSpectrumPlaces; ++i) {
    sum_of_logs += order.log_frequency[i];
    if (order.texture[i] == 0) continue;
    const auto x = static_cast<int>(order.across[i]), y = static_cast<int>(order.down[i]);
    EXPECT_TRUE(seen.insert({x, y}).second) << x << ", " << y;
    EXPECT_EQ(seen.count({-x, -y}), x == 0 && y == 0 ? 1u : 0u) << x << ", " << y;
    EXPECT_EQ(order.at[i], (y < 0 ? kSpectrumSize / 2 : 0) + std::abs(y) * kSpectrumWaves + x);
    EXPECT_NEAR(order.texture[i], std::pow(std::hypot(x, y), -2.5), 1e-6);
    const double angle_rad = std::atan2(y, x);
    const int sector = i % kSpectrumSectors;
    const double turned_rad = angle_rad < -CV_PI / 16 ? angle_rad + CV_PI : angle_rad;
    least[sector] = std::min(least[sector], turned_rad);
    most[sector] = std::max(most[sector], turned_rad);
  }
  EXPECT_EQ(seen.size(), 476u);  // of 31 x 15 + 15, less (1, -1), (1, 0), (1, 1) and (0, 1)
  EXPECT_NEAR(sum_of_logs, 0, 1e-3);
  for (int k = 1; k < kSpectrumSectors; ++k) EXPECT_LE(most[k - 1], least[k]);
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, SpectrumSimdTest, testing::ValuesIn(test::kInstructionSets));

}  // namespace
}  // namespace gyro_deblur::spectrum_simd_test
