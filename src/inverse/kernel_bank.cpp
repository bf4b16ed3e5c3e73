#include "gyro_deblur/kernel_bank.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace gyro_deblur {
namespace {

int next_odd(double value) {
  const int n = static_cast<int>(std::ceil(value));
  return n % 2 == 0 ? n + 1 : n;
}

/// Transform of the Gaussian of options.smoothing_px at element k of `size`.
double smoothing(int k, int size, const KernelOptions& options) {
  const double cycles_per_px = static_cast<double>(std::min(k, size - k)) / size;
  const double x = 2 * CV_PI * options.smoothing_px * cycles_per_px;
  return std::exp(-0.5 * x * x);
}

/// Taps that hold the inverse of a blur of `extent_px` and the Gaussian it is smoothed with, three sigma on either
/// side.
double needed_length(double extent_px, const KernelOptions& options) {
  return options.length_factor * extent_px + 6 * options.smoothing_px;
}

}  // namespace

double spectral_share(double extent_px) { return std::max(0.0, 1 - extent_px / kConstantRatioExtentPx); }

namespace {

/// Solves T x = y for every column of y, T_ij = r(|i - j|) positive definite, by Levinson's recursion: O(n^2) of time,
/// O(n) of memory. r and y have n >= 1 rows; r(i) = 0 from i = `band` on, 1 <= band <= n.
Eigen::MatrixXd solve_toeplitz(const Eigen::VectorXd& r, Eigen::Index band, const Eigen::MatrixXd& y) {
  const Eigen::Index n = r.size();
  // forward solves the leading m equations for an error in the first, backward (the same, turned round) for one in the
  // last. backward begins an element earlier each time, so that all vectors below are contiguous.
  Eigen::MatrixXd x = Eigen::MatrixXd::Zero(n, y.cols());
  Eigen::VectorXd forward = Eigen::VectorXd::Zero(n), backward = forward;
  const Eigen::VectorXd lags = r.reverse();
  double error = r[0];
  forward[0] = backward[n - 1] = 1;
  x.row(0) = y.row(0) / error;
  for (Eigen::Index m = 1; m < n; ++m) {
    // r(k), .., r(1): the last k of the first m unknowns in the next equation; the others are not in it.
    const Eigen::Index k = std::min(m, band - 1);
    const auto to_next = lags.segment(n - 1 - k, k);
    const double reflection = -to_next.dot(forward.segment(m - k, k)) / error;
    forward.head(m + 1) += reflection * backward.tail(m + 1);
    backward.tail(m + 1) = forward.head(m + 1).reverse();
    error *= 1 - reflection * reflection;
    for (Eigen::Index column = 0; column < y.cols(); ++column) {
      const double missing = y(m, column) - to_next.dot(x.col(column).segment(m - k, k));
      x.col(column).head(m + 1) += missing / error * backward.tail(m + 1);
    }
  }
  return x;
}

/// `blur` read backwards and smoothed with the Gaussian of smoothing_px, on as many taps.
Eigen::VectorXd matched_filter(const std::vector<double>& blur, double smoothing_px) {
  const int n = static_cast<int>(blur.size());
  const Eigen::VectorXd matched = Eigen::Map<const Eigen::VectorXd>(blur.data(), n).reverse();
  if (smoothing_px <= 0) return matched;
  // Shares of the Gaussian in pixels: samples would be a pulse long before smoothing_px is 0.
  const auto below = [&](double place_px) { return 0.5 * std::erf(place_px / (std::sqrt(2.0) * smoothing_px)); };
  Eigen::VectorXd gaussian(2 * n - 1);
  for (int i = 0; i < 2 * n - 1; ++i) gaussian[i] = below(i - n + 1.5) - below(i - n + 0.5);
  Eigen::VectorXd smoothed(n);
  for (int i = 0; i < n; ++i) smoothed[i] = matched.dot(gaussian.segment(n - 1 - i, n));
  return smoothed;
}

/// See KernelDesign::LEAST_SQUARES; on as many taps as `blur` (centred, odd).
std::vector<double> least_squares_inverse(const std::vector<double>& blur, double extent_px,
                                          const KernelOptions& options) {
  const auto n = static_cast<Eigen::Index>(blur.size());
  const Eigen::Map<const Eigen::VectorXd> h(blur.data(), n);
  Eigen::VectorXd autocorrelation(n);
  for (Eigen::Index lag = 0; lag < n; ++lag) autocorrelation[lag] = h.head(n - lag).dot(h.tail(n - lag));
  const double share = spectral_share(extent_px);
  autocorrelation[0] += options.gamma * (1 + share);
  autocorrelation[1] -= options.gamma * share;
  Eigen::Index band = n;
  while (band > 1 && autocorrelation[band - 1] == 0) --band;
  // Lagrange: T w = what the blur matches + multiplier * 1, so that the sum is the filter's own gain at frequency 0.
  Eigen::MatrixXd sides(n, 2);
  sides.col(0) = matched_filter(blur, options.smoothing_px);
  sides.col(1).setOnes();
  const Eigen::MatrixXd solved = solve_toeplitz(autocorrelation, band, sides);
  const double multiplier = (1 / (1 + options.gamma * (1 - share)) - solved.col(0).sum()) / solved.col(1).sum();
  const Eigen::VectorXd w = solved.col(0) + multiplier * solved.col(1);
  return {w.data(), w.data() + n};
}

/// See KernelDesign::FOURIER; `blur` is centred and odd, `size` >= its taps is the transform's.
std::vector<double> fourier_inverse(const std::vector<double>& blur, int size, const KernelOptions& options) {
  const int length = static_cast<int>(blur.size()), radius = length / 2;
  // The transform's origin is element 0, so the centre of the blur goes there.
  cv::Mat h(1, size, CV_64F, cv::Scalar(0)), spectrum, w;
  for (int i = 0; i < length; ++i) h.at<double>((i + size - radius) % size) = blur[i];
  cv::dft(h, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int k = 0; k < size; ++k) {
    const cv::Vec2d H = spectrum.at<cv::Vec2d>(k);
    const double scale = smoothing(k, size, options) / (H.dot(H) + options.gamma);
    spectrum.at<cv::Vec2d>(k) = {H[0] * scale, -H[1] * scale};
  }
  cv::dft(spectrum, w, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  std::vector<double> inverse(length);
  for (int i = 0; i < length; ++i) inverse[i] = w.at<double>((i + size - radius) % size);
  return inverse;
}

}  // namespace

LineKernel wiener_kernel(double extent_px, const KernelOptions& options) {
  options.validate();
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  const int length = next_odd(needed_length(extent_px, options));
  const std::vector<double> box = box_blur_kernel(extent_px, length);
  const std::vector<double> w = options.design == KernelDesign::FOURIER
                                    ? fourier_inverse(box, length, options)
                                    : least_squares_inverse(box, extent_px, options);
  const double sum = std::accumulate(w.begin(), w.end(), 0.0);
  LineKernel kernel;
  kernel.taps.resize(length);
  // Symmetric but for rounding.
  for (int i = 0; i < length; ++i) kernel.taps[i] = static_cast<float>((w[i] + w[length - 1 - i]) / (2 * sum));
  if (options.smoothing_px > 0) return kernel;
  // gamma w = h + a constant - (what h makes of h * w): the first is the box again, the rest is smooth up to the last
  // tap. In the Wiener filter, W = H* / gamma - H* |H|^2 / (gamma (|H|^2 + gamma)), the second term falls as |H|^3.
  // With a ratio that rises with the frequency that holds at the highest one, where it is (1 + 3 s) gamma.
  const double share = options.design == KernelDesign::LEAST_SQUARES ? spectral_share(extent_px) : 0;
  kernel.box_extent_px = extent_px;
  kernel.box_height = 1 / (options.gamma * (1 + 3 * share) * extent_px * sum);
  return kernel;
}

LineKernel wiener_kernel(const LinePath& path_px, const KernelOptions& options) {
  options.validate();
  const double extent_px = extent_of(path_px);
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  double reach_px = 0;
  for (const float place_px : path_px) reach_px = std::max<double>(reach_px, std::abs(place_px));
  const int length = next_odd(std::max(needed_length(extent_px, options), 2 * reach_px + 3));
  const std::vector<double> blur = path_blur_kernel(path_px, length);
  const std::vector<double> w = options.design == KernelDesign::FOURIER
                                    ? fourier_inverse(blur, cv::getOptimalDFTSize(length), options)
                                    : least_squares_inverse(blur, extent_px, options);
  const double sum = std::accumulate(w.begin(), w.end(), 0.0);
  LineKernel kernel;
  kernel.taps.resize(length);
  for (int i = 0; i < length; ++i) kernel.taps[i] = static_cast<float>(w[i] / sum);
  return kernel;
}

KernelBank::KernelBank(const KernelOptions& options) : options_(options) { options_.validate(); }

const LineKernel& KernelBank::kernel(double extent_px) const {
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");
  const int key = static_cast<int>(std::lround(extent_px / kExtentStepPx));
  const std::lock_guard<std::mutex> lock(mutex_);
  std::unique_ptr<LineKernel>& slot = kernels_[key];
  if (!slot) slot = std::make_unique<LineKernel>(wiener_kernel(key * kExtentStepPx, options_));
  return *slot;
}

}  // namespace gyro_deblur
