// The gain of a path's inverse, for every instruction set that this processor runs.
#include "inverse/wiener_gain_2d.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "base/fourier_simd.hpp"
#include "blur/path_2d.hpp"
#include "compiled_sets.hpp"
#include "paths_2d.hpp"

namespace gyro_deblur::wiener_gain_2d_test {
namespace {

class WienerGain2dTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<WienerGain2dSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
    lanes_ = find_for_cpu<FourierSimd>(GetParam())->lanes;
  }

  /// Calls check(v, u, gain, gain and blur) for all frequencies of tiles of `size`, u from 0 to its width - 1.
  template <typename Check>
  void for_each_gain(const WienerInverse2d& inverse, cv::Size size, const PlaneBand& band_across,
                     const PlaneBand& band_down, const Check& check) const {
    const FourierPlan plan(size.width, 8), plan_down(size.height, 8);
    WienerGain2d gain(*simd_);
    gain.set(inverse, {plan.stages(), plan_down.stages()}, band_across, band_down);
    std::vector<float> of_rows(2 * lanes_ * size.width), of_reblur(2 * lanes_ * size.width);
    for (int row = 0; row < size.height / 2; row += lanes_) {
      gain.rows(row, of_rows.data(), of_reblur.data());
      for (int u = 0; u < size.width; ++u) {
        const int place = plan.stages().places[u] * 2 * lanes_;
        const auto at = [&](const std::vector<float>& rows, int i) {
          return std::complex<double>(rows[place + i], rows[place + lanes_ + i]);
        };
        for (int i = 0; i < lanes_; ++i) check(row + i, u, at(of_rows, i), at(of_reblur, i));
      }
    }
  }

  static PlaneBand all(int size) { return {std::vector<float>(size / 2, 1), std::vector<float>(size / 2, 1)}; }

  const WienerGain2dSimd* simd_ = nullptr;
  int lanes_ = 0;
};

TEST_P(WienerGain2dTest, IsTheWienerInverseOfThePath) {
  Path2d still, stops = test::arc_path(40, 6, 0.3);
  still.fill(Eigen::Vector2f::Zero());
  for (int k = 5; k < kPathInstants; ++k) stops[k] = stops[4];
  const Path2d paths[] = {still,
                          stops,
                          test::arc_path(25, 0, 0),
                          test::arc_path(25, 0, CV_PI / 2),
                          test::arc_path(25, 5, 2.5),
                          test::arc_path(60, 12, 1),
                          test::arc_path(300, 80, 0.5)};
  for (const Path2d& path_px : paths) {
    for (const float rise_px2 : {0.0f, 5.0f}) {
      const WienerInverse2d inverse{path_px, 0.007f, rise_px2};
      for (const cv::Size& size : {cv::Size(32, 32), cv::Size(192, 192), cv::Size(480, 480), cv::Size(288, 64)}) {
        double worst = 0, worst_again = 0;
        for_each_gain(inverse, size, all(size.width), all(size.height),
                      [&](int v, int u, std::complex<double> gain, std::complex<double> again) {
                        const std::complex<double> expected = test::gain_at(inverse, u, v, size);
                        worst = std::max(worst, std::abs(gain - expected));
                        worst_again =
                            std::max(worst_again, std::abs(again - expected * test::transfer_at(path_px, u, v, size)));
                      });
        // Of gains of up to 1 / (2 sqrt(noise_to_signal)) = 6.
        EXPECT_LT(worst, 0.01) << extent_of(path_px).transpose() << " px, " << rise_px2 << " px^2, tile of " << size;
        EXPECT_LT(worst_again, 0.002) << extent_of(path_px).transpose() << " px, tile of " << size;
      }
    }
  }
}

TEST_P(WienerGain2dTest, KeepsTheMean) {
  for_each_gain({test::arc_path(50, 9, 1), 0.02f, 1}, {96, 64}, all(96), all(64),
                [&](int v, int u, std::complex<double> gain, std::complex<double>) {
                  if (u != 0 || v != 0) return;
                  EXPECT_LT(std::abs(gain - 1.0), 1e-6);
                });
}

TEST_P(WienerGain2dTest, IsTimesItsBand) {
  const cv::Size size(64, 96);
  const WienerInverse2d inverse{test::arc_path(20, 4, 0.7), 0.01f, 1};
  PlaneBand across = all(size.width), down = all(size.height);
  for (int k = 0; k < size.height / 2; ++k) {
    down.gain[k] = 1 + 0.1f * static_cast<float>(k);
    down.again[k] = 1 - 0.02f * static_cast<float>(k);
    if (k >= size.width / 2) continue;
    across.gain[k] = 1 + 0.05f * static_cast<float>(k);
    across.again[k] = 1 - 0.03f * static_cast<float>(k);
  }
  for_each_gain(inverse, size, across, down, [&](int v, int u, std::complex<double> gain, std::complex<double> again) {
    if (u == size.width / 2) return;
    const int of = u < size.width / 2 ? u : size.width - u;
    const std::complex<double> expected = test::gain_at(inverse, u, v, size),
                               transfer = test::transfer_at(inverse.path_px, u, v, size);
    EXPECT_LT(std::abs(gain - expected * static_cast<double>(across.gain[of] * down.gain[v])), 0.05);
    EXPECT_LT(std::abs(again - expected * transfer * static_cast<double>(across.again[of] * down.again[v])), 0.002);
  });
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, WienerGain2dTest, testing::ValuesIn(test::kInstructionSets));

TEST(WienerInverse2d, HasTheRatioAtASixthOfACycleAndRisesWithNoise) {
  const FilterOptions options;
  const auto ratio = [](const WienerInverse2d& inverse, double f) {
    return inverse.noise_to_signal + inverse.noise_rise_px2 * f * f;
  };
  Path2d path_px;
  path_px.fill(Eigen::Vector2f::Zero());
  const WienerInverse2d quiet = wiener_inverse_2d(path_px, options), noisy = wiener_inverse_2d(path_px, options, 2);
  EXPECT_NEAR(ratio(quiet, 1.0 / 6), options.noise_to_signal_ratio, 1e-6);
  EXPECT_EQ(noisy.noise_to_signal, quiet.noise_to_signal) << "noise has no share at frequency 0";
  EXPECT_NEAR(ratio(noisy, 0.5) - ratio(quiet, 0.5), 0.3 * 2 * 0.25, 1e-6);
}

TEST(Path2d, CoversItsPlacesAndTheMiddle) {
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) path_px[k] = {3.0f + k, -2.0f * k};
  EXPECT_EQ(extent_of(path_px), Eigen::Vector2f(11, 16));
}

}  // namespace
}  // namespace gyro_deblur::wiener_gain_2d_test
