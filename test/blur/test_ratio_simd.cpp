// The loops that the estimate of the exposure spends its time in, for every instruction set that this processor runs.
#include "blur/ratio_simd.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "compiled_sets.hpp"

namespace gyro_deblur::ratio_simd_test {
namespace {

constexpr int kPoints = 43;
constexpr float kCommon[kFitCommon] = {0.4F, -0.3F, 0.1F, 0.9F};

/// Spectra of noise, with the transfer function 1 / (1 + f), and the offset of each.
struct Spectra {
  Spectra() : transfer(500), points(kPoints) {
    for (std::size_t i = 0; i < transfer.size(); ++i) transfer[i] = 1 / (1 + static_cast<float>(i) / 10);
    std::mt19937 random(8);
    const auto uniform = [&random](float low, float high) {
      return std::uniform_real_distribution<float>(low, high)(random);
    };
    spectra.points = kPoints;
    for (int lane = 0; lane < kFitLanes; ++lane) {
      spectra.transfer[lane] = transfer.data();
      spectra.entries_per_wave[lane] = 10;
      spectra.last_place[lane] = static_cast<float>(transfer.size()) - 1.5F;
      spectra.offset[lane] = uniform(-1, 1);
      spectra.shift[lane] = uniform(-0.2F, 0.2F);
    }
    for (int i = 0; i < kPoints; ++i) {
      for (int lane = 0; lane < kFitLanes; ++lane) {
        FitPoint& p = points[i];
        p.frequency[lane] = static_cast<float>(i + 2) + uniform(-0.3F, 0.3F);
        p.x[lane] = std::log(p.frequency[lane] / 12);
        p.before[lane] = uniform(0.1F, 0.3F);
        p.behind[lane] = uniform(0.1F, 0.3F);
        p.reach[lane] = uniform(1, 2);
        p.log_power[lane] = uniform(-3, 3);
        p.noise[lane] = uniform(0, 0.5F);
        p.weight[lane] = i + lane < kPoints ? uniform(0.5F, 20) : 0;
        p.root_weight[lane] = std::sqrt(p.weight[lane]);
      }
    }
  }

  std::vector<float> transfer;
  std::vector<FitPoint> points;
  FitSpectra spectra{};
};

double model(const float* common, double x, double gain) {
  return common[0] * x + common[1] * x * x + common[2] * x * x * x + common[3] * gain;
}

/// Sums over the points of one lane as evaluate() makes them: of weight x^k g^m and of weighted errors.
struct Reference {
  double weights[7][3] = {}, errors[4][2] = {};

  Reference(const Spectra& of, int lane) {
    for (const FitPoint& p : of.points) {
      const double x = p.x[lane], gain = p.gain[lane];
      const double signal = std::exp(of.spectra.offset[lane] + model(kCommon, x, gain)), both = signal + p.noise[lane];
      const double share = signal / both, error = p.log_power[lane] - std::log(both);
      const double stddevs = std::abs(error) * p.root_weight[lane];
      const double robust = p.weight[lane] * share * (stddevs > 2.5 ? 2.5 / stddevs : 1);
      for (int k = 0; k < 7; ++k) {
        for (int m = 0; m < 3; ++m) weights[k][m] += robust * share * std::pow(x, k) * std::pow(gain, m);
      }
      for (int k = 0; k < 4; ++k) {
        for (int m = 0; m < 2; ++m) errors[k][m] += robust * error * std::pow(x, k) * std::pow(gain, m);
      }
    }
  }
};

class RatioSimdTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }
  const RatioSimd* simd_ = find_for_cpu<RatioSimd>(GetParam());
};

TEST_P(RatioSimdTest, AppliesARatio) {
  Spectra of;
  const auto transfer_at = [&of](double frequency) {
    const double place = std::min(std::abs(frequency) * 10, static_cast<double>(of.spectra.last_place[0]));
    const auto i = static_cast<std::size_t>(place);
    return of.transfer[i] + (place - static_cast<double>(i)) * (of.transfer[i + 1] - of.transfer[i]);
  };
  for (const float ratio : {0.0F, 0.3F, 1.0F, 1.4F}) {
    simd_->apply(of.spectra, ratio, of.points.data());
    for (const FitPoint& p : of.points) {
      for (int lane = 0; lane < kFitLanes; ++lane) {
        const double f = ratio * p.frequency[lane], reach = ratio * p.reach[lane];
        const double gain = (1 - p.before[lane] - p.behind[lane]) * transfer_at(f) +
                            p.before[lane] * transfer_at(f - reach) + p.behind[lane] * transfer_at(f + reach);
        EXPECT_NEAR(p.gain[lane], std::log(gain + 0.003), 5e-5);
      }
    }
  }
}

TEST_P(RatioSimdTest, SumsForAStep) {
  Spectra of;
  simd_->apply(of.spectra, 1, of.points.data());
  FitSums sums;
  simd_->evaluate(of.spectra, kCommon, of.points.data(), &sums);
  for (int lane = 0; lane < kFitLanes; ++lane) {
    const Reference reference(of, lane);
    const double most = 5e-4 * reference.weights[0][0];  // powers of x and gains reach some tens
    for (int k = 0; k < 7; ++k) EXPECT_NEAR(sums.x[k][lane], reference.weights[k][0], most) << k;
    for (int k = 0; k < 4; ++k) {
      EXPECT_NEAR(sums.x_gain[k][lane], reference.weights[k][1], most) << k;
      EXPECT_NEAR(sums.x_error[k][lane], reference.errors[k][0], most) << k;
    }
    EXPECT_NEAR(sums.gain2[lane], reference.weights[0][2], most);
    EXPECT_NEAR(sums.gain_error[lane], reference.errors[0][1], most);
  }
}

TEST_P(RatioSimdTest, SumsCosts) {
  Spectra of;
  simd_->apply(of.spectra, 1, of.points.data());
  FitSums sums;
  simd_->evaluate(of.spectra, kCommon, of.points.data(), &sums);
  const float change[kFitCommon] = {0.1F, 0.05F, -0.02F, 0.1F};
  FitLanes costs;
  simd_->costs(of.spectra, of.points.data(), change, costs);
  for (int lane = 0; lane < kFitLanes; ++lane) {
    double cost = 0;
    for (const FitPoint& p : of.points) {
      const double changed = of.spectra.shift[lane] + model(change, p.x[lane], p.gain[lane]);
      const double stddevs = std::abs(p.error[lane] - p.share[lane] * changed) * p.root_weight[lane];
      cost += stddevs > 2.5 ? 2.5 * (stddevs - 1.25) : 0.5 * stddevs * stddevs;
    }
    EXPECT_NEAR(costs[lane], cost, 1e-5 * cost);
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, RatioSimdTest, testing::ValuesIn(test::kInstructionSets));

}  // namespace
}  // namespace gyro_deblur::ratio_simd_test
