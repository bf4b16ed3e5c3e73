#include "gyro_deblur/kernel_bank.hpp"

#include <algorithm>
#include <cmath>

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

std::vector<double> box_blur_kernel(double extent_px, int length) {
  std::vector<double> box(length);
  const int radius = length / 2;
  const double half = extent_px / 2;
  for (int i = 0; i < length; ++i) {
    const double position = i - radius;
    const double covered = std::min(position + 0.5, half) - std::max(position - 0.5, -half);
    box[i] = std::max(covered, 0.0) / extent_px;
  }
  return box;
}

double extent_of(const LinePath& path_px) {
  const auto [lowest, highest] = std::minmax_element(path_px.begin(), path_px.end());
  return static_cast<double>(*highest) - *lowest;
}

double share_within(const LinePath& path_px, double begin_px, double end_px) {
  double intervals = 0;
  for (int k = 0; k + 1 < kPathInstants; ++k) {
    const double from = std::min(path_px[k], path_px[k + 1]), to = std::max(path_px[k], path_px[k + 1]);
    if (from == to) {
      intervals += begin_px <= from && from < end_px ? 1 : 0;
    } else {
      intervals += std::max(0.0, std::min(to, end_px) - std::max(from, begin_px)) / (to - from);
    }
  }
  return intervals / (kPathInstants - 1);
}

std::vector<double> path_blur_kernel(const LinePath& path_px, int length) {
  std::vector<double> taps(length);
  for (int i = 0; i < length; ++i) taps[i] = share_within(path_px, i - length / 2 - 0.5, i - length / 2 + 0.5);
  return taps;
}

LineKernel wiener_kernel(double extent_px, const KernelOptions& options) {
  options.validate();
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  const int length = next_odd(needed_length(extent_px, options));
  const int radius = length / 2;
  const std::vector<double> box = box_blur_kernel(extent_px, length);

  // The DFT's origin is element 0, so the centre of the box goes there; H is then real and so is W.
  cv::Mat h(1, length, CV_64F);
  for (int i = 0; i < length; ++i) h.at<double>((i + length - radius) % length) = box[i];
  cv::Mat spectrum;
  cv::dft(h, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int k = 0; k < length; ++k) {
    const double H = spectrum.at<cv::Vec2d>(k)[0];
    spectrum.at<cv::Vec2d>(k) = {smoothing(k, length, options) * H / (H * H + options.gamma), 0.0};
  }
  cv::Mat w;
  cv::dft(spectrum, w, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);

  const double sum = cv::sum(w)[0];
  LineKernel kernel;
  kernel.taps.resize(length);
  for (int i = 0; i < length; ++i) {
    kernel.taps[i] = static_cast<float>(w.at<double>((i + length - radius) % length) / sum);
  }
  if (options.smoothing_px > 0) return kernel;
  // W = H* / gamma - H* |H|^2 / (gamma (|H|^2 + gamma)): the first term is the box again, the second falls as |H|^3.
  kernel.box_extent_px = extent_px;
  kernel.box_height = 1 / (options.gamma * extent_px * sum);
  return kernel;
}

LineKernel wiener_kernel(const LinePath& path_px, const KernelOptions& options) {
  options.validate();
  const double extent_px = extent_of(path_px);
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  double reach_px = 0;
  for (const float place_px : path_px) reach_px = std::max<double>(reach_px, std::abs(place_px));
  const double needed = std::max(needed_length(extent_px, options), 2 * reach_px + 3);
  const int size = cv::getOptimalDFTSize(next_odd(needed) + 1);
  const int length = size % 2 == 0 ? size - 1 : size, radius = length / 2;
  const std::vector<double> blur = path_blur_kernel(path_px, length);

  cv::Mat h(1, size, CV_64F, cv::Scalar(0));
  for (int i = 0; i < length; ++i) h.at<double>((i + size - radius) % size) = blur[i];
  cv::Mat spectrum, w;
  cv::dft(h, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int k = 0; k < size; ++k) {
    const cv::Vec2d H = spectrum.at<cv::Vec2d>(k);
    const double scale = smoothing(k, size, options) / (H.dot(H) + options.gamma);
    spectrum.at<cv::Vec2d>(k) = {H[0] * scale, -H[1] * scale};
  }
  cv::dft(spectrum, w, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);

  LineKernel kernel;
  kernel.taps.resize(length);
  double sum = 0;
  for (int i = 0; i < length; ++i) sum += w.at<double>((i + size - radius) % size);
  for (int i = 0; i < length; ++i) {
    kernel.taps[i] = static_cast<float>(w.at<double>((i + size - radius) % size) / sum);
  }
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
