#include "inverse/filter_bank.hpp"

#include <cmath>
#include <complex>
#include <limits>
#include <numeric>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <Eigen/Dense>
#include <opencv2/core.hpp>

#include "blur/path_1d.hpp"

namespace gyro_deblur::filter_bank_test {
namespace {

double sum(const std::vector<double>& v) { return std::accumulate(v.begin(), v.end(), 0.0); }
double sum(const std::vector<float>& v) { return std::accumulate(v.begin(), v.end(), 0.0); }

/// Real part of the transform of a centred symmetric kernel at k cycles over n samples, term by term.
template <typename T>
double transform(const std::vector<T>& taps, int k) {
  const int n = static_cast<int>(taps.size());
  double value = 0;
  for (int i = 0; i < n; ++i) value += taps[i] * std::cos(2 * CV_PI * k * (i - n / 2) / n);
  return value;
}

TEST(BoxBlurKernel, IsTheBoxOfTheExactExtent) {
  for (const double extent : {0.7, 1.0, 2.0, 3.0, 4.5, 10.25, 27.0, 130.75}) {
    const int length = 2 * static_cast<int>(std::ceil(extent)) + 1;
    const std::vector<double> box = box_blur_kernel(extent, length);
    EXPECT_NEAR(sum(box), 1.0, 1e-12) << extent;
    for (int i = 0; i < length; ++i) EXPECT_EQ(box[i], box[length - 1 - i]) << "centred, extent " << extent;
    // Full pixels weigh 1 / extent.
    if (extent > 1) {
      EXPECT_NEAR(box[length / 2], 1 / extent, 1e-12);
    }
  }
}

TEST(BoxBlurKernel, WeighsEdgesByCoverage) {
  const std::vector<double> even = box_blur_kernel(4.0, 7);  // covers [-2, 2]: two half pixels, three full ones
  const std::vector<double> expected = {0, 0.125, 0.25, 0.25, 0.25, 0.125, 0};
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(even[i], expected[i], 1e-15);
}

constexpr Path1d kSpeedsUp{-5, -4, -3, -2, 0, 3, 6, 10, 14};

TEST(PathBlurKernel, OfAUniformPathIsTheBox) {
  for (const double extent : {3.0, 10.25, 27.0}) {
    Path1d path_px;
    for (int k = 0; k < kPathInstants; ++k) {
      path_px[k] = static_cast<float>((k / (kPathInstants - 1.0) - 0.5) * extent);
    }
    EXPECT_NEAR(extent_of(path_px), extent, 1e-6);
    const std::vector<double> expected = box_blur_kernel(extent, 41), kernel = path_blur_kernel(path_px, 41);
    for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(kernel[i], expected[i], 1e-6) << extent << ' ' << i;
  }
}

TEST(PathBlurKernel, IsTheTimeInEachPixel) {
  const std::vector<double> kernel = path_blur_kernel(kSpeedsUp, 41);
  EXPECT_NEAR(sum(kernel), 1, 1e-12);
  // Tap 20 is the middle of the exposure. In eighths: 1 px before an eighth covers 1, then 2, 3 and 4.
  EXPECT_NEAR(kernel[20 - 4], 1.0 / 8, 1e-9);
  EXPECT_NEAR(kernel[20 - 1], 0.5 / 8, 1e-9);
  EXPECT_NEAR(kernel[20 + 1], 1.0 / 3 / 8, 1e-9);
  EXPECT_NEAR(kernel[20 + 8], 0.25 / 8, 1e-9);
  EXPECT_NEAR(kernel[20 + 14], 0.125 / 8, 1e-9);
  EXPECT_EQ(kernel[20 + 15], 0);
  // There and back counts twice; at rest all the time is in one pixel.
  const std::vector<double> back = path_blur_kernel({-8, -6, -4, -2, 0, -2, -4, -6, -8}, 41);
  EXPECT_NEAR(back[20 - 5], 2 * 0.5 / 8, 1e-9);
  EXPECT_EQ(back[21], 0);
  EXPECT_NEAR(path_blur_kernel({0, 0, 0, 0, 0, 2, 4, 6, 8}, 41)[20], 4.25 / 8, 1e-9);
  EXPECT_NEAR(share_within(kSpeedsUp, -5, 14), 1, 1e-12);
  EXPECT_NEAR(share_within(kSpeedsUp, -5, 0), 0.5, 1e-12);
}

/// Taps, as many as the kernel's, that minimise |h * w - g|^2 + gamma (share |w'|^2 + (1 - share) |w|^2) while their
/// sum is 1 / (1 + gamma (1 - share)), gamma being noise_to_signal_ratio, by elimination; scaled to unit sum.
Eigen::VectorXd best_taps(const std::vector<double>& blur, double share, const FilterOptions& options) {
  const int n = static_cast<int>(blur.size());
  Eigen::MatrixXd h = Eigen::MatrixXd::Zero(2 * n - 1, n);  // h * w = h w, its middle element at n - 1
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < n; ++k) h(i + k, i) = blur[k];
  }
  Eigen::VectorXd g = Eigen::VectorXd::Zero(2 * n - 1);
  g[n - 1] = 1;
  Eigen::MatrixXd differences = Eigen::MatrixXd::Zero(n + 1, n);  // the kernel is 0 before and after its taps
  for (int i = 0; i < n; ++i) {
    differences(i, i) = 1;
    differences(i + 1, i) = -1;
  }
  const Eigen::MatrixXd noise =
      share * differences.transpose() * differences + (1 - share) * Eigen::MatrixXd::Identity(n, n);
  const double gain = 1 / (1 + options.noise_to_signal_ratio * (1 - share));
  // The last unknown is the multiplier of the condition.
  Eigen::MatrixXd system = Eigen::MatrixXd::Zero(n + 1, n + 1);
  system.topLeftCorner(n, n) = h.transpose() * h + options.noise_to_signal_ratio * noise;
  system.rightCols(1).topRows(n).setOnes();
  system.bottomRows(1).leftCols(n).setOnes();
  Eigen::VectorXd side(n + 1);
  side << h.transpose() * g, gain;
  return system.partialPivLu().solve(side).head(n) / gain;
}

void expect_taps(const LineKernel& kernel, const Eigen::VectorXd& expected, const std::string& what) {
  ASSERT_EQ(static_cast<Eigen::Index>(kernel.taps.size()), expected.size()) << what;
  const Eigen::Map<const Eigen::VectorXf> taps(kernel.taps.data(), expected.size());
  EXPECT_LT((taps.cast<double>() - expected).cwiseAbs().maxCoeff(), 1e-5 * expected.cwiseAbs().maxCoeff()) << what;
}

TEST(WienerKernel, IsTheBestOfItsLength) {
  for (const double ratio : {0.001, 0.01, 0.2}) {
    for (const double length_factor : {2.0, 4.0, 8.0}) {
      FilterOptions options;
      options.noise_to_signal_ratio = ratio;
      options.length_factor = length_factor;
      const std::string what = std::to_string(ratio) + ' ' + std::to_string(length_factor) + ' ';
      for (const double extent_px : {1.0, 2.0, 5.4, 27.0, 60.0}) {
        const LineKernel kernel = wiener_kernel(extent_px, options);
        const std::vector<double> box = box_blur_kernel(extent_px, static_cast<int>(kernel.taps.size()));
        expect_taps(kernel, best_taps(box, spectral_share(extent_px), options), what + std::to_string(extent_px));
      }
      const LineKernel kernel = wiener_kernel(kSpeedsUp, options);
      const std::vector<double> blur = path_blur_kernel(kSpeedsUp, static_cast<int>(kernel.taps.size()));
      expect_taps(kernel, best_taps(blur, spectral_share(extent_of(kSpeedsUp)), options), what + "nonuniform");
    }
  }
}

// Two ways to the same taps: a system in the box's steps, and Levinson's recursion. Places are exact as floats.
TEST(WienerKernel, OfAUniformPathIsThatOfItsBox) {
  for (const double extent_px : {2.0, 5.25, 24.0, 96.25, 250.0}) {
    for (const double length_factor : {2.0, 4.0, 8.0}) {
      FilterOptions options;
      options.length_factor = length_factor;
      Path1d path_px;
      for (int k = 0; k < kPathInstants; ++k) path_px[k] = static_cast<float>((k / 8.0 - 0.5) * extent_px);
      const LineKernel of_box = wiener_kernel(extent_px, options);
      std::vector<float> of_path = wiener_kernel(path_px, options).taps;
      // At its shortest a path's kernel has room for the path, and 3 px.
      const auto more = static_cast<std::ptrdiff_t>(of_path.size() - of_box.taps.size());
      if (more > 0) continue;
      ASSERT_EQ(more, 0);
      const Eigen::VectorXd expected =
          Eigen::Map<const Eigen::VectorXf>(of_path.data(), static_cast<Eigen::Index>(of_path.size())).cast<double>();
      expect_taps(of_box, expected, std::to_string(extent_px) + ' ' + std::to_string(length_factor));
    }
  }
}

// H* / (|H|^2 + noise_to_signal_ratio (share |1 - exp(-iw)|^2 + 1 - share)), summed over all frequencies.
TEST(WienerKernel, IsTheFilterOfItsNoiseWhereThatIsShort) {
  FilterOptions options;
  options.noise_to_signal_ratio = 0.5;
  options.length_factor = 8;
  const LineKernel kernel = wiener_kernel(13, options);
  const int radius = kernel.radius(), size = 4096;
  const double share = spectral_share(13);
  const std::vector<double> box = box_blur_kernel(13, 15);
  std::vector<double> filter(size);
  for (int k = 0; k < size; ++k) {
    const double w = 2 * CV_PI * k / size;
    double H = 0;
    for (int i = 0; i < 15; ++i) H += box[i] * std::cos(w * (i - 7));
    filter[k] = H / (H * H + options.noise_to_signal_ratio * (share * (2 - 2 * std::cos(w)) + 1 - share));
  }
  for (int i = -radius; i <= radius; ++i) {
    double tap = 0;
    for (int k = 0; k < size; ++k) tap += filter[k] * std::cos(2 * CV_PI * k * i / size) / size;
    EXPECT_NEAR(kernel.taps[radius + i], tap / filter[0], 1e-4) << i;
  }
}

TEST(FourierKernel, InvertsAnNonuniformPath) {
  FilterOptions options;
  options.regularization = Regularization::PAPER;
  const LineKernel kernel = wiener_kernel(kSpeedsUp, options);
  EXPECT_EQ(kernel.taps.size() % 2, 1u);
  EXPECT_GE(kernel.taps.size(), options.length_factor * 19);
  EXPECT_NEAR(sum(kernel.taps), 1, 1e-4);
  EXPECT_EQ(kernel.box_extent_px, 0);
  const int radius = kernel.radius();
  const std::vector<double> blur = path_blur_kernel(kSpeedsUp, 2 * radius + 1);
  const int size = cv::getOptimalDFTSize(2 * radius + 1);
  for (int k = 0; k <= size / 2; ++k) {
    const double f = static_cast<double>(k) / size;
    std::complex<double> H = 0, W = 0;
    for (int i = -radius; i <= radius; ++i) {
      const std::complex<double> wave = std::polar(1.0, -2 * CV_PI * f * i);
      H += blur[i + radius] * wave;
      W += static_cast<double>(kernel.taps[i + radius]) * wave;
    }
    const std::complex<double> expected =
        (1 + options.noise_to_signal_ratio) * std::conj(H) / (std::norm(H) + options.noise_to_signal_ratio);
    EXPECT_LT(std::abs(W - expected), 0.05 * std::abs(expected) + 0.05) << f;
  }
  EXPECT_THROW(wiener_kernel(Path1d{}, options), OptionError);
}

TEST(WienerKernel, HasTheLengthAndUnitGain) {
  FilterOptions options;
  for (const Regularization rule : {Regularization::FIXED, Regularization::PAPER}) {
    options.regularization = rule;
    for (const double extent : {1.0, 2.0, 7.3, 27.0, 90.0, 500.0}) {
      for (const double factor : {2.0, 4.0, 6.0}) {
        options.length_factor = factor;
        const LineKernel kernel = wiener_kernel(extent, options);
        EXPECT_EQ(kernel.taps.size() % 2, 1u);
        EXPECT_GE(kernel.taps.size(), factor * extent);
        EXPECT_LE(kernel.taps.size(), factor * extent + 2);
        EXPECT_NEAR(sum(kernel.taps), 1.0, 1e-4);
      }
    }
  }
}

TEST(WienerKernel, TakesTheRatioForConstantFromALongBlurOn) {
  EXPECT_EQ(spectral_share(0), 1);
  EXPECT_EQ(spectral_share(kConstantRatioExtentPx / 2), 0.5);
  EXPECT_EQ(spectral_share(kConstantRatioExtentPx), 0);
  EXPECT_EQ(spectral_share(kMaxKernelExtentPx), 0);
}

TEST(WienerKernel, JumpsWhereItSaysSo) {
  for (const double extent_px : {36.0, 60.0, 130.0}) {
    const LineKernel kernel = wiener_kernel(extent_px, {});
    ASSERT_EQ(kernel.box_extent_px, extent_px);
    // The box ends on a tap; across it, less what the rest falls by on either side.
    const float* end = kernel.taps.data() + kernel.radius() + static_cast<int>(extent_px / 2);
    const double step = end[-1] - end[1], slope = (end[-3] - end[-1] + end[1] - end[3]) / 2;
    EXPECT_NEAR(step - slope, kernel.box_height, 0.2 * kernel.box_height) << extent_px;
  }
}

TEST(WienerKernel, IsSymmetric) {
  const LineKernel kernel = wiener_kernel(13.6, {});
  const std::size_t n = kernel.taps.size();
  for (std::size_t i = 0; i < n; ++i) EXPECT_FLOAT_EQ(kernel.taps[i], kernel.taps[n - 1 - i]);
}

TEST(FourierKernel, ObeysTheDefinitionAtEveryFrequency) {
  for (const double ratio : {0.001, 0.01, 0.2}) {
    FilterOptions options;
    options.regularization = Regularization::PAPER;
    options.noise_to_signal_ratio = ratio;
    for (const double extent : {2.0, 5.4, 27.0}) {
      const LineKernel kernel = wiener_kernel(extent, options);
      const int n = static_cast<int>(kernel.taps.size());
      const std::vector<double> box = box_blur_kernel(extent, n);
      for (int k = 0; k <= n / 2; ++k) {
        const double H = transform(box, k);
        // Times 1 + ratio: unit gain at k = 0, where H = 1.
        EXPECT_NEAR(transform(kernel.taps, k), (1 + ratio) * H / (H * H + ratio), 2e-5) << extent << " " << k;
      }
    }
  }
}

TEST(WienerKernel, RefusesWhatIsOutOfRange) {
  EXPECT_THROW(wiener_kernel(0.99, {}), OptionError);
  EXPECT_THROW(wiener_kernel(500.5, {}), OptionError);
  EXPECT_THROW(wiener_kernel(std::numeric_limits<double>::quiet_NaN(), {}), OptionError);
  FilterOptions bad;
  bad.noise_to_signal_ratio = 0;
  EXPECT_THROW(wiener_kernel(10, bad), OptionError);
  EXPECT_THROW(FilterBank{bad}, OptionError);
  bad = {};
  bad.length_factor = 1;
  EXPECT_THROW(FilterBank{bad}, OptionError);
  EXPECT_THROW(FilterBank({}).kernel(0.5), OptionError);
}

TEST(FilterBank, GivesTheNearestQuarterPixel) {
  const FilterBank bank({});
  EXPECT_EQ(bank.kernel(10.1).taps, wiener_kernel(10.0, {}).taps);
  EXPECT_EQ(bank.kernel(10.13).taps, wiener_kernel(10.25, {}).taps);
  EXPECT_EQ(&bank.kernel(10.13), &bank.kernel(10.3)) << "computed once";
  EXPECT_EQ(bank.size(), 2u);
  EXPECT_EQ(bank.kernel(kMaxKernelExtentPx).taps, wiener_kernel(kMaxKernelExtentPx, {}).taps);
}

TEST(FilterBank, HasAKernelForEachRatio) {
  const FilterBank bank({});
  const int most = bank.max_doublings();
  for (const double extent_px : {10.0, kMaxKernelExtentPx}) {
    for (const int doublings : {0, 1, most, most + 1}) {
      const LineKernel expected = wiener_kernel(extent_px, with_doubled_ratio({}, doublings));
      for (int time = 0; time < 2; ++time)
        EXPECT_EQ(bank.kernel(extent_px, doublings).taps, expected.taps) << doublings;
    }
    EXPECT_NE(bank.kernel(extent_px, 1).taps, bank.kernel(extent_px).taps);
  }
}

TEST(FilterBank, SharesKernelsAmongThreads) {
  const FilterBank bank({});
  std::vector<const LineKernel*> seen(8 * 40);
  std::vector<std::thread> threads;
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 40; ++i) seen[t * 40 + i] = &bank.kernel(2 + i * 0.5);
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (int t = 1; t < 8; ++t) {
    for (int i = 0; i < 40; ++i) EXPECT_EQ(seen[t * 40 + i], seen[i]);
  }
}

}  // namespace
}  // namespace gyro_deblur::filter_bank_test
