// What all engines have in common, so that an engine only filters.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "engine/engine.hpp"
#include "engine/fourier_filter.hpp"
#include "engine/seam_blender.hpp"

namespace gyro_deblur {

/// Checks image and grid, copies blocks that have no filter, filters those with a 2-D inverse, has those with
/// a kernel filtered, and blends where blocks meet. Keeps its memory between frames.
class BlockEngine : public Engine {
 public:
  /// @param threads  at most, >= 0; 0: one for each core, see parallel_for_ranges
  explicit BlockEngine(int threads) : threads_(threads) {}

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) final;

 protected:
  /// Filters `blocks` (indices into the grid, rising; each has a kernel) and hands the results to `seams`, which has
  /// planned for the grid. Called for every frame, also when there are none. src, grid and dst are as Engine::filter
  /// says, and dst has src's size and type.
  virtual void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks,
                             SeamBlender& seams, cv::Mat& dst) = 0;

  /// Copies the blocks without a filter, once a frame. An engine that waits for a device calls it while the device
  /// works; for the others it is called after filter_blocks().
  void copy_untouched(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst);

  /// Threads at most, >= 1.
  int threads() const;

 private:
  int threads_;
  SeamBlender seams_;
  FourierFilter fourier_filter_;
  std::vector<int> with_kernel_, with_inverse_;  // blocks
  bool is_copied_ = false;                       // the blocks without a filter, of the frame at hand
};

}  // namespace gyro_deblur
