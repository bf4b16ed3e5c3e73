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

LineKernel wiener_kernel(double extent_px, const KernelOptions& options) {
  options.validate();
  require_range("extent", extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");

  const int length = next_odd(options.length_factor * extent_px);
  const int radius = length / 2;
  const std::vector<double> box = box_blur_kernel(extent_px, length);

  // The DFT's origin is element 0, so the centre of the box goes there; H is then real and so is W.
  cv::Mat h(1, length, CV_64F);
  for (int i = 0; i < length; ++i) h.at<double>((i + length - radius) % length) = box[i];
  cv::Mat spectrum;
  cv::dft(h, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int k = 0; k < length; ++k) {
    const double H = spectrum.at<cv::Vec2d>(k)[0];
    spectrum.at<cv::Vec2d>(k) = {H / (H * H + options.gamma), 0.0};
  }
  cv::Mat w;
  cv::dft(spectrum, w, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);

  const double sum = cv::sum(w)[0];
  LineKernel kernel;
  kernel.taps.resize(length);
  for (int i = 0; i < length; ++i) {
    kernel.taps[i] = static_cast<float>(w.at<double>((i + length - radius) % length) / sum);
  }
  // W = H* / gamma - H* |H|^2 / (gamma (|H|^2 + gamma)): the first term is the box again, the second falls as |H|^3.
  kernel.box_extent_px = extent_px;
  kernel.box_height = 1 / (options.gamma * extent_px * sum);
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
