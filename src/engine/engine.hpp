// Engines: they filter every block of an image with its own 1-D filter along its own line (paper section IV-B), or with
// its own 2-D filter.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "inverse/filter_bank.hpp"
#include "inverse/wiener_inverse_2d.hpp"

namespace gyro_deblur {

/// Filter of one block. At most one of `kernel` and `inverse` is set; neither is owned. Without both the block is
/// copied bit for bit.
struct BlockFilter {
  double angle_rad = 0;                      ///< direction of the kernel's line [rad], x right, y down
  const LineKernel* kernel = nullptr;        ///< convolved with along the line
  const WienerInverse2d* inverse = nullptr;  ///< for the 2-D filter

  bool copies() const { return kernel == nullptr && inverse == nullptr; }
};

/// A grid of blocks that covers an image, each with its own filter.
struct FilterGrid {
  std::vector<int> x, y;            ///< borders between columns and rows [px], rising from 0 to the image's size
  std::vector<BlockFilter> blocks;  ///< row by row
  /// Kernels and inverses that `blocks` point to and that have no other owner.
  std::vector<std::shared_ptr<const void>> owned = {};

  int cols() const { return x.empty() ? 0 : static_cast<int>(x.size()) - 1; }
  int rows() const { return y.empty() ? 0 : static_cast<int>(y.size()) - 1; }
  /// Precondition: 0 <= index < cols() * rows().
  cv::Rect rect(int index) const {
    const int col = index % cols(), row = index / cols();
    return {x[col], y[row], x[col + 1] - x[col], y[row + 1] - y[row]};
  }
};

/// Number of blocks that an engine filtered with a slower method than most, by reason.
using FallbackCounts = std::map<std::string, std::size_t>;

/// Convolves every block of an image along its own line with its own kernel, or filters it with its 2-D
/// inverse. So that the borders of blocks do not show, 2-D inverses fade into each other over the whole of their
/// blocks, other neighbours with different filters over up to 4 px on either side, and a filtered block fades into the
/// input within as much of a copied one (the rules: src/engine/fourier_filter.hpp, src/engine/seam_blender.hpp).
class Engine {
 public:
  virtual ~Engine() = default;

  /// @param src    CV_8U or CV_16U, 1 to 4 channels, at least 1x1; every channel is filtered
  /// @param grid   covers src exactly
  /// @param dst    (re)allocated to src's size and type when needed; must not share memory with src
  /// Neighbours are taken across block borders; outside the image kernels see the edge pixel, inverses what fits best.
  /// Results are rounded and clipped to the pixel type. Throws std::invalid_argument for what does not fit.
  virtual void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) = 0;

  /// Computes ahead what filter() needs for new kernels, and drops the same of other kernels. Not during filter().
  virtual void prepare(const std::vector<const LineKernel*>& kernels) { static_cast<void>(kernels); }

  /// Whether all blocks get a 2-D inverse, also where a 1-D kernel would serve.
  virtual bool prefers_2d() const { return false; }

  /// Short name for diagnostics, e.g. "float". Any thread may ask, also during filter().
  virtual std::string name() const = 0;

  /// Counts of the latest image; empty if the engine has one method for all. Not during filter().
  virtual FallbackCounts fallback_counts() const { return {}; }

  /// Something the user should know, such as a device that failed; each warning is returned once, empty: none.
  virtual std::string take_warning() { return {}; }
};

/// Engine by name, on at most `threads` threads (0: one for each core to run on):
/// - "float": non-zero taps of the rotated kernel, float;
/// - "cpu": the fast one for processors;
/// - "opencl", "opencl:INDEX" or "opencl:NAME": the first GPU (else the first device), or a device by its index or a
///   part of its platform's or its own name in any case. When it is absent or fails, also in mid-run, the "cpu" engine
///   takes over with that very frame, and take_warning() says why;
/// - "fourier": the inverse of the whole path for all blocks, a half to a quarter as fast as "cpu";
/// - "auto": "cpu", also where there is a GPU.
/// Throws OptionError that lists the names.
std::unique_ptr<Engine> make_engine(const std::string& engine, int threads = 0);

}  // namespace gyro_deblur
