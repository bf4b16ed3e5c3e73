// Wiener inverses of blur along a line (paper section IV-A); those of the box, one per extent.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "gyro_deblur/line_path.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

/// A symmetric or general 1-D kernel, sampled at unit steps along a line: tap i acts at position i - taps.size() / 2.
/// taps.size() is odd.
struct LineKernel {
  std::vector<float> taps;

  /// Where the kernel jumps, for engines that make use of it: taps are symmetric, box_height inside a centred box of
  /// box_extent_px (its edges weighted by coverage) plus a rest that is smooth up to the last tap. Below
  /// kConstantRatioExtentPx the jump is spread over some pixels. 0: not known to have this shape.
  double box_extent_px = 0;
  double box_height = 0;

  int radius() const { return static_cast<int>(taps.size() / 2); }
};

/// Extents [px] for which there are Wiener kernels: a box below one pixel is no blur.
constexpr double kMinKernelExtentPx = 1.0;
constexpr double kMaxKernelExtentPx = 500.0;

/// From this extent [px] on KernelDesign::LEAST_SQUARES takes the noise-to-signal ratio for constant, as the paper
/// does. A ratio that falls towards low frequencies restores more of longer blur as well (0.1 to 0.4 dB), but amplifies
/// what is wrong with the estimate there, which is the larger the longer the blur: with 100 px instead keypoints of the
/// real-world table (doc/reports/experiments_real_world.md) repeat 5 % less often.
constexpr double kConstantRatioExtentPx = 36.0;

/// s of KernelDesign::LEAST_SQUARES: from 1 without blur down to 0 at kConstantRatioExtentPx.
double spectral_share(double extent_px);

/// Spatial Wiener inverse of the box blur on length_factor * extent_px + 6 * smoothing_px taps (next odd), by
/// options.design, scaled to unit sum because the filter's gain is less than that. Throws OptionError for bad
/// options or extent_px outside [kMinKernelExtentPx, kMaxKernelExtentPx].
LineKernel wiener_kernel(double extent_px, const KernelOptions& options);

/// The same for a point that runs along its line at uneven speed; on more taps where the path reaches farther from its
/// middle in time. Throws OptionError as above.
LineKernel wiener_kernel(const LinePath& path_px, const KernelOptions& options);

/// Kernels by extent in steps of kExtentStepPx, computed on first use and kept. Thread-safe.
class KernelBank {
 public:
  /// A quarter pixel: the extent is then wrong by at most 1/8 px.
  static constexpr double kExtentStepPx = 0.25;

  /// Throws OptionError for bad options.
  explicit KernelBank(const KernelOptions& options);
  ~KernelBank();

  /// The kernel for the nearest multiple of kExtentStepPx. Valid as long as the bank.
  const LineKernel& kernel(double extent_px) const;

  std::size_t size() const;  ///< kernels made so far

  const KernelOptions& options() const { return options_; }

 private:
  class Kernels;
  KernelOptions options_;
  std::unique_ptr<Kernels> kernels_;
};

}  // namespace gyro_deblur
