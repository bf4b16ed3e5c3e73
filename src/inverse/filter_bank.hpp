// Wiener inverses of blur along a line (paper section IV-A); those of the box, one per extent.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <utility>
#include <vector>

#include "base/once_map.hpp"
#include "blur/path_1d.hpp"
#include "gyro_deblur/options.hpp"
#include "inverse/expected_errors.hpp"

namespace gyro_deblur {

/// Taps of a 1-D filter: the inverse of a straight path, at steps of 1 px along its line.
struct LineKernel {
  std::vector<float> taps;  ///< an odd number; tap i acts at position i - taps.size() / 2 [px]

  /// For engines that use the shape of a box's inverse: symmetric taps, box_height inside a centred box of
  /// box_extent_px (its edges weighted by coverage) plus a smooth rest. Below kConstantRatioExtentPx the jump is spread
  /// over some pixels. 0: not known to have this shape.
  double box_extent_px = 0;
  double box_height = 0;

  int radius() const { return static_cast<int>(taps.size() / 2); }
};

/// Extents [px] for which there are Wiener kernels: a box below one pixel is no blur.
constexpr double kMinKernelExtentPx = 1.0;
constexpr double kMaxKernelExtentPx = 500.0;

/// From this extent [px] on Regularization::FIXED takes the noise-to-signal ratio for constant, as the paper does: at
/// low frequencies a smaller ratio would amplify errors of the blur's estimate (doc/design/two_scale_filter.md).
constexpr double kConstantRatioExtentPx = 36.0;

/// s of Regularization::FIXED: from 1 without blur down to 0 at kConstantRatioExtentPx.
inline double spectral_share(double extent_px) { return std::max(0.0, 1 - extent_px / kConstantRatioExtentPx); }

/// Spatial Wiener inverse of the box blur on length_factor * extent_px taps (next odd), by options.regularization,
/// scaled to unit sum because the filter's gain is less than that. Throws OptionError for bad options or extent_px
/// outside [kMinKernelExtentPx, kMaxKernelExtentPx].
LineKernel wiener_kernel(double extent_px, const FilterOptions& options);

/// The same for a point that runs along its line at non-uniform speed; on more taps where the path reaches farther from
/// its middle in time. Throws OptionError as above.
LineKernel wiener_kernel(const Path1d& path_px, const FilterOptions& options);

/// The options with noise_to_signal_ratio doubled `doublings` (>= 0) times, at most 1.
FilterOptions with_doubled_ratio(FilterOptions options, int doublings);

/// Kernels by extent in steps of kExtentStepPx, and by noise-to-signal ratio, computed on first use and kept.
/// Thread-safe.
class FilterBank {
 public:
  /// A quarter pixel: the extent is then wrong by at most 1/8 px.
  static constexpr double kExtentStepPx = 0.25;

  /// Throws OptionError for bad options.
  explicit FilterBank(const FilterOptions& options);

  /// The kernel for the nearest multiple of kExtentStepPx. Valid as long as the bank.
  /// @param ratio_doublings  how often options().noise_to_signal_ratio is to be doubled, >= 0; it ends at 1
  const LineKernel& kernel(double extent_px, int ratio_doublings = 0) const;

  /// The least expected error of a block whose texture has the power c / f^2 at f cycles/px along the line (D. J.
  /// Field, J. Opt. Soc. Am. A 4 (12), 1987), and white noise of the variance v: with H the box's transform and W the
  /// filter's, the integral over f of c |1 - W H|^2 / f^2 + v |W|^2, for each doubling of the noise-to-signal ratio.
  /// @param noise_to_texture  v / c [cycles^2/px^2], >= 0
  FilterChoice choose(double extent_px, double noise_to_texture) const {
    return errors_.least(extent_px, noise_to_texture);
  }

  /// The most doublings that choose() gives.
  int max_doublings() const { return errors_.doublings(); }

  std::size_t size() const { return kernels_.size(); }  ///< kernels made so far

  const FilterOptions& options() const { return options_; }

 private:
  FilterOptions options_;
  // By extent / kExtentStepPx, and how often the noise-to-signal ratio is doubled.
  mutable OnceMap<std::pair<int, int>, LineKernel> kernels_;
  ExpectedErrors errors_;
  // Those of kernels_ by extent, for each number of doublings up to max_doublings(), once they were asked for: every
  // block of every frame asks, and need not search or lock for it.
  mutable std::vector<std::atomic<const LineKernel*>> made_;
};

}  // namespace gyro_deblur
