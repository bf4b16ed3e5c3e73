// Space-variant deconvolution: a 1-D kernel along a line for every block (paper sections IV-A and IV-B).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/kernel_bank.hpp"

namespace gyro_deblur {

/// What to do with one block of an image.
struct BlockFilter {
  double angle_rad = 0;                ///< direction of the line, x right, y down
  const LineKernel* kernel = nullptr;  ///< not owned; null: copy the block bit for bit
};

/// A grid of blocks that covers an image, each with its own filter.
struct FilterGrid {
  std::vector<int> x, y;            ///< borders between columns and rows [px], rising from 0 to the image's size
  std::vector<BlockFilter> blocks;  ///< row by row
  /// Kernels that `blocks` point to and nobody else keeps.
  std::vector<std::shared_ptr<const LineKernel>> own_kernels = {};

  int cols() const { return x.empty() ? 0 : static_cast<int>(x.size()) - 1; }
  int rows() const { return y.empty() ? 0 : static_cast<int>(y.size()) - 1; }
  /// Precondition: 0 <= index < cols() * rows().
  cv::Rect rect(int index) const;
};

/// Convolves every block of an image along its own line with its own kernel. So that the borders of blocks do not show,
/// neighbours with different filters are cross-faded over up to 4 px on either side, and a filtered block fades into
/// the input within as much of a copied one (the rule: src/core/seam_blender.hpp).
class LineConvolver {
 public:
  virtual ~LineConvolver() = default;

  /// @param src    CV_8U or CV_16U, 1 to 4 channels, at least 1x1; every channel is filtered
  /// @param grid   covers src exactly
  /// @param dst    (re)allocated to src's size and type when needed; must not share memory with src
  /// Neighbours are taken across block borders; outside the image the edge pixel is replicated. Results are rounded and
  /// clipped to the pixel type. Throws std::invalid_argument for unsupported types and grids that do not fit.
  virtual void convolve(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) = 0;

  /// Short name for diagnostics, e.g. "reference". Any thread may ask, also during convolve().
  virtual std::string name() const = 0;

  /// Something the user should know, such as a device that failed; each warning is returned once, empty: none.
  virtual std::string take_warning() { return {}; }
};

/// Engine by name, on `threads` OpenMP threads (0: OpenMP's default):
/// - "reference": non-zero taps of the rotated kernel, float, OpenMP over blocks;
/// - "cpu": the fast one for processors;
/// - "opencl", "opencl:INDEX" or "opencl:NAME": the first GPU (else the first device), or a device by its index or a
///   part of its platform's or its own name in any case. When it is absent or fails, also in mid-run, the "cpu" engine
///   takes over with that very frame, and take_warning() says why;
/// - "auto": "opencl" where there is a GPU, else "cpu".
/// Throws OptionError that lists the names.
std::unique_ptr<LineConvolver> make_line_convolver(const std::string& backend, int threads = 0);

/// A non-zero element of a rotated kernel.
struct KernelTap {
  int dx, dy;
  float weight;
};

/// Non-zero elements of `kernel` rotated to `angle_rad` (paper section IV-B); their weights sum to the kernel's sum.
/// Steps of the major axis in rising order, at each one or two taps, neighbours across. The second form uses the room
/// that `taps` and `on_axis` have.
std::vector<KernelTap> rotate_kernel(const LineKernel& kernel, double angle_rad);
void rotate_kernel(const LineKernel& kernel, double angle_rad, std::vector<KernelTap>& taps,
                   std::vector<float>& on_axis);

/// The kernel on unit steps of a line's major axis: each tap, at position * major, is weighted onto the two nearest
/// steps. major: cosine or sine of the line's angle, whichever is larger in size: 0.7 to 1, or the negative of it.
/// @param on_axis  set to steps -n .. n, n = ceil(radius * |major|)
void kernel_on_major_axis(const LineKernel& kernel, double major, std::vector<float>& on_axis);

/// Throws std::invalid_argument unless `src` is a non-empty CV_8U or CV_16U with 1 to 4 channels, and `grid` covers it.
void require_convolvable(const cv::Mat& src, const FilterGrid& grid);

/// The filters that deblur `field`: for DEBLURRED blocks of at least kMinKernelExtentPx the bank's kernels, or own ones
/// where the path is uneven, made on `threads` OpenMP threads (0: OpenMP's default); none for the others. Lives no
/// longer than the bank.
FilterGrid make_filter_grid(const BlurField& field, const KernelBank& bank, int threads = 0);

/// Deblurs the DEBLURRED blocks of `field` and copies the rest bit for bit; alpha is copied; Bayer mosaics are filtered
/// plane by plane with half the extent.
/// Preconditions: image has the field's size and a type that fits `layout`. `dst` as for LineConvolver::convolve,
/// `threads` as for make_filter_grid.
void deconvolve(const cv::Mat& image, PixelLayout layout, const BlurField& field, const KernelBank& bank,
                LineConvolver& engine, cv::Mat& dst, int threads = 0);

}  // namespace gyro_deblur
