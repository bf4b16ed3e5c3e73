// Wiener inverses of the box blur (paper section IV-A), one per extent.
#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

/// A symmetric or general 1-D kernel, sampled at unit steps along a line: tap i acts at position i - taps.size() / 2.
/// taps.size() is odd.
struct LineKernel {
  std::vector<float> taps;

  /// Where the kernel jumps, for engines that make use of it: taps are symmetric, box_height inside a centred box of
  /// box_extent_px (its edges weighted by coverage) plus a smooth rest. 0: not known to have this shape.
  double box_extent_px = 0;
  double box_height = 0;

  int radius() const { return static_cast<int>(taps.size() / 2); }
};

/// Box of `extent_px` as `length` taps (odd): centred, unit sum, edges weighted by coverage. Preconditions:
/// extent_px > 0, length odd and >= extent_px.
std::vector<double> box_blur_kernel(double extent_px, int length);

/// Extents [px] for which there are Wiener kernels: a box below one pixel is no blur.
constexpr double kMinKernelExtentPx = 1.0;
constexpr double kMaxKernelExtentPx = 500.0;

/// Spatial Wiener inverse w = F^-1{H* / (|H|^2 + gamma)} of the box blur, on length_factor * extent_px taps (next odd),
/// scaled to unit sum because W alone has a gain of 1 / (1 + gamma). Throws OptionError for bad options or
/// extent_px outside [kMinKernelExtentPx, kMaxKernelExtentPx].
LineKernel wiener_kernel(double extent_px, const KernelOptions& options);

/// Kernels by extent in steps of kExtentStepPx, computed on first use and kept. Thread-safe.
class KernelBank {
 public:
  /// A quarter pixel: the extent is then wrong by at most 1/8 px.
  static constexpr double kExtentStepPx = 0.25;

  /// Throws OptionError for bad options.
  explicit KernelBank(const KernelOptions& options);

  /// The kernel for the nearest multiple of kExtentStepPx. Valid as long as the bank.
  const LineKernel& kernel(double extent_px) const;

  const KernelOptions& options() const { return options_; }

 private:
  KernelOptions options_;
  mutable std::mutex mutex_;
  mutable std::map<int, std::unique_ptr<LineKernel>> kernels_;  // by extent / kExtentStepPx
};

}  // namespace gyro_deblur
