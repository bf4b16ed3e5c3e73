// Computes Wiener inverses by least squares or Fourier transform, and keeps them.
#include "inverse/filter_bank.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "base/require_range.hpp"
#include "inverse/tap_simd.hpp"

namespace gyro_deblur {
namespace {

// Of FilterBank's extents, from 0 on.
constexpr int kExtentSteps = static_cast<int>(kMaxKernelExtentPx / FilterBank::kExtentStepPx) + 1;

/// The least odd number of taps that is not below `value`, rounded up.
int next_odd(double value) { return static_cast<int>(std::ceil(value)) | 1; }

/// See Regularization::FIXED; on as many taps as `blur` (centred, odd).
std::vector<double> least_squares_inverse(const std::vector<double>& blur, double extent_px,
                                          const FilterOptions& options) {
  const auto n = static_cast<int>(blur.size());
  // What is not 0 of the blur, which is a fraction of the taps.
  const auto is_blurred = [](double tap) { return tap != 0; };
  const auto begin = std::find_if(blur.begin(), blur.end(), is_blurred);
  const auto end = std::find_if(blur.rbegin(), blur.rend(), is_blurred).base();
  const auto reach = static_cast<int>(end - begin);
  const Eigen::Map<const Eigen::VectorXd> h(&*begin, reach);
  const int band = std::min(n, std::max(reach, 2));
  std::vector<double> lags(band);  // the last is of lag 0
  for (int lag = 0; lag < reach; ++lag) lags[band - 1 - lag] = h.head(reach - lag).dot(h.tail(reach - lag));
  const double share = spectral_share(extent_px);
  lags[band - 1] += options.noise_to_signal_ratio * (1 + share);
  lags[band - 2] -= options.noise_to_signal_ratio * share;
  // Lagrange: T w = what the blur matches + multiplier * 1, so that the sum is the filter's own gain at frequency 0.
  std::vector<double> sides(2 * n, 1.0), work(5 * (n + kToeplitzRoom) + band), solved(2 * n);
  std::reverse_copy(blur.begin(), blur.end(), sides.begin());
  select_for_cpu<TapSimd>().solve_toeplitz(lags.data(), band, n, sides.data(), work.data(), solved.data());
  const Eigen::Map<const Eigen::VectorXd> of_blur(solved.data(), n), of_ones(solved.data() + n, n);
  const double multiplier = (1 / (1 + options.noise_to_signal_ratio * (1 - share)) - of_blur.sum()) / of_ones.sum();
  const Eigen::VectorXd w = of_blur + multiplier * of_ones;
  return {w.data(), w.data() + n};
}

/// Replaces the right side of symmetric positive definite equations by the solution, by Cholesky factorisation in
/// place.
/// @param lower  element (i, j) of the matrix at (i - j, j), where 0 <= i - j < lower.rows(); it is 0 farther down
void solve_banded(Eigen::MatrixXd& lower, std::vector<double>& side) {
  const int size = static_cast<int>(lower.cols()), width = static_cast<int>(lower.rows()) - 1;
  for (int j = 0; j < size; ++j) {
    const double* column = lower.col(j).data();
    const int below = std::min(width, size - 1 - j);
    for (int k = 1; k <= below; ++k) {
      const double share = column[k] / column[0];
      double* other = lower.col(j + k).data();
      for (int i = k; i <= below; ++i) other[i - k] -= share * column[i];
      side[j + k] -= share * side[j];
    }
  }
  for (int j = size - 1; j >= 0; --j) {
    const double* column = lower.col(j).data();
    const int below = std::min(width, size - 1 - j);
    for (int k = 1; k <= below; ++k) side[j] -= column[k] * side[j + k];
    side[j] /= column[0];
  }
}

/// Coefficients of box_inverse()'s equations by lag, >= 0.
/// @param share  spectral_share() of the box
std::vector<std::pair<int, double>> couplings_of(const std::vector<double>& box, double ratio, double share) {
  const int n = static_cast<int>(box.size());
  std::map<int, double> coupling = {
      {0, 2 * ratio * (1 + 2 * share)}, {1, -ratio * (1 + 3 * share)}, {2, ratio * share}};
  std::vector<std::pair<int, double>> steps;
  for (int i = 0; i <= n; ++i) {
    const double step = (i < n ? box[i] : 0) - (i > 0 ? box[i - 1] : 0);
    if (step != 0) steps.emplace_back(i, step);
  }
  for (std::size_t a = 0; a < steps.size(); ++a) {
    for (std::size_t b = 0; b <= a; ++b) coupling[steps[a].first - steps[b].first] += steps[a].second * steps[b].second;
  }
  return {coupling.begin(), coupling.end()};
}

/// What least_squares_inverse() gives for a centred box, in O(n) of time.
///
/// The unknowns are the running sums of the taps, u(i) = w(-radius) + .. + w(i), less half of the whole sum. They are
/// odd, u(-1 - i) = -u(i), and beyond the taps they are half of the sum, which is given: the condition is gone. In them
/// the equations' autocorrelation is that of the box's steps, which is 0 but at lags near 0 and near the box's length.
/// Numbered by their place within such a length, folded at its middle since both halves are one, all unknowns of an
/// equation are close to each other.
std::vector<double> box_inverse(const std::vector<double>& box, double extent_px, const FilterOptions& options) {
  const int n = static_cast<int>(box.size()), radius = n / 2;
  const double share = spectral_share(extent_px), ratio = options.noise_to_signal_ratio;
  const std::vector<std::pair<int, double>> couplings = couplings_of(box, ratio, share);

  const int period = std::max(2, static_cast<int>(std::lround(extent_px / 2)) * 2);
  const auto group_of = [period](int i) { return std::min(i % period, period - 1 - i % period); };
  std::vector<int> first(period / 2 + 1, 0), number(radius);
  for (int i = 0; i < radius; ++i) ++first[group_of(i) + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  for (int i = 0; i < radius; ++i) number[i] = first[group_of(i)]++;

  // Calls add(j, weight) for each unknown in equation i, and known(weight) for what is beyond the taps.
  const auto for_each_term = [&](int i, const auto& add, const auto& known) {
    for (const auto& [lag, weight] : couplings) {
      for (const int j : {i + lag, i - lag}) {
        if (j >= radius || j < -radius) {
          known(j >= radius ? weight : -weight);
        } else {
          add(j < 0 ? -1 - j : j, j < 0 ? -weight : weight);
        }
        if (lag == 0) break;
      }
    }
  };
  int width = 0;
  for (int i = 0; i < radius; ++i) {
    for_each_term(
        i, [&](int j, double) { width = std::max(width, number[i] - number[j]); }, [](double) {});
  }
  const double half_sum = 0.5 / (1 + ratio * (1 - share));
  Eigen::MatrixXd lower = Eigen::MatrixXd::Zero(width + 1, radius);
  std::vector<double> sums(radius);
  for (int i = 0; i < radius; ++i) {
    double& side = sums[number[i]];
    side = box[radius - i] - box[radius - i - 1];  // steps of the box read backwards
    for_each_term(
        i,
        [&](int j, double weight) {
          if (number[j] <= number[i]) lower(number[i] - number[j], number[j]) += weight;
        },
        [&](double weight) { side -= weight * half_sum; });
  }
  solve_banded(lower, sums);
  std::vector<double> w(n);
  for (int i = 0; i <= radius; ++i) {
    const double here = i < radius ? sums[number[i]] : half_sum;
    w[radius + i] = w[radius - i] = here - (i > 0 ? sums[number[i - 1]] : -here);
  }
  return w;
}

/// See Regularization::PAPER; `blur` is centred and odd, `size` >= its taps is the transform's.
std::vector<double> fourier_inverse(const std::vector<double>& blur, int size, const FilterOptions& options) {
  const int length = static_cast<int>(blur.size()), radius = length / 2;
  // The transform's origin is element 0, so the centre of the blur goes there.
  cv::Mat h(1, size, CV_64F, cv::Scalar(0)), spectrum, w;
  for (int i = 0; i < length; ++i) h.at<double>((i + size - radius) % size) = blur[i];
  cv::dft(h, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int k = 0; k < size; ++k) {
    const cv::Vec2d H = spectrum.at<cv::Vec2d>(k);
    const double scale = 1 / (H.dot(H) + options.noise_to_signal_ratio);
    spectrum.at<cv::Vec2d>(k) = {H[0] * scale, -H[1] * scale};
  }
  cv::dft(spectrum, w, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  std::vector<double> inverse(length);
  for (int i = 0; i < length; ++i) inverse[i] = w.at<double>((i + size - radius) % size);
  return inverse;
}

const FilterOptions& validated(const FilterOptions& options) {
  options.validate();
  return options;
}

}  // namespace

LineKernel wiener_kernel(double extent_px, const FilterOptions& options) {
  options.validate();
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  const int length = next_odd(options.length_factor * extent_px);
  const std::vector<double> box = box_blur_kernel(extent_px, length);
  const std::vector<double> w = options.regularization == Regularization::PAPER ? fourier_inverse(box, length, options)
                                                                                : box_inverse(box, extent_px, options);
  const double sum = std::accumulate(w.begin(), w.end(), 0.0);
  LineKernel kernel;
  kernel.taps.resize(length);
  // Symmetric but for rounding.
  for (int i = 0; i < length; ++i) kernel.taps[i] = static_cast<float>((w[i] + w[length - 1 - i]) / (2 * sum));
  // With gamma, the noise-to-signal ratio: gamma w = h + a constant - (what h makes of h * w). The first is the box
  // again, the rest is smooth up to the last tap. In the Wiener filter, W = H* / gamma - H* |H|^2 / (gamma (|H|^2 +
  // gamma)), the second term falls as |H|^3. With a ratio that rises with the frequency that holds at the highest one,
  // where it is (1 + 3 s) gamma.
  const double share = options.regularization == Regularization::PAPER ? 0 : spectral_share(extent_px);
  kernel.box_extent_px = extent_px;
  kernel.box_height = 1 / (options.noise_to_signal_ratio * (1 + 3 * share) * extent_px * sum);
  return kernel;
}

LineKernel wiener_kernel(const Path1d& path_px, const FilterOptions& options) {
  options.validate();
  const double extent_px = extent_of(path_px);
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  double reach_px = 0;
  for (const float place_px : path_px) reach_px = std::max<double>(reach_px, std::abs(place_px));
  const int length = next_odd(std::max(options.length_factor * extent_px, 2 * reach_px + 3));
  const std::vector<double> blur = path_blur_kernel(path_px, length);
  const std::vector<double> w = options.regularization == Regularization::PAPER
                                    ? fourier_inverse(blur, cv::getOptimalDFTSize(length), options)
                                    : least_squares_inverse(blur, extent_px, options);
  const double sum = std::accumulate(w.begin(), w.end(), 0.0);
  LineKernel kernel;
  kernel.taps.resize(length);
  for (int i = 0; i < length; ++i) kernel.taps[i] = static_cast<float>(w[i] / sum);
  return kernel;
}

FilterBank::FilterBank(const FilterOptions& options)
    : options_(validated(options)),
      errors_(options_.noise_to_signal_ratio),
      made_(static_cast<std::size_t>(kExtentSteps) * (max_doublings() + 1)) {}

FilterOptions with_doubled_ratio(FilterOptions options, int doublings) {
  options.noise_to_signal_ratio =
      std::min(std::ldexp(options.noise_to_signal_ratio, doublings), kMaxNoiseToSignalRatio);
  return options;
}

const LineKernel& FilterBank::kernel(double extent_px, int ratio_doublings) const {
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");
  const int step = static_cast<int>(std::lround(extent_px / kExtentStepPx));
  const auto find_or_make = [&]() -> const LineKernel& {
    return kernels_.get({step, ratio_doublings}, [&] {
      return wiener_kernel(step * kExtentStepPx, with_doubled_ratio(options_, ratio_doublings));
    });
  };
  // More doublings make the same kernel.
  if (ratio_doublings > max_doublings()) return find_or_make();
  std::atomic<const LineKernel*>& place = made_[static_cast<std::size_t>(ratio_doublings) * kExtentSteps + step];
  const LineKernel* kernel = place.load(std::memory_order_acquire);
  if (kernel == nullptr) {
    kernel = &find_or_make();
    place.store(kernel, std::memory_order_release);
  }
  return *kernel;
}

}  // namespace gyro_deblur
