// The straightforward engine, which others are tested against.
#pragma once

#include <string>
#include <vector>

#include "engine/seam_blender.hpp"
#include "gyro_deblur/engine.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur {

/// Sums the non-zero taps of each block's rotated kernel in float, OpenMP over blocks.
class FloatEngine : public Engine {
 public:
  /// @param threads OpenMP threads, >= 0; 0: OpenMP's default
  explicit FloatEngine(int threads);

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) override;

  /// Filters `blocks` of the grid (indices; each has a kernel) and leaves the results with `seams`, which has planned
  /// for the grid. Preconditions as require_filterable(); dst has src's size and type.
  void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                     cv::Mat& dst);

  std::string name() const override { return "float"; }

 private:
  template <typename Pixel>
  void filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                 cv::Mat& dst);
  template <typename Pixel>
  void load_channel(const cv::Mat& src, int channel);

  int threads_;
  // Kept between frames: their allocation would cost more than their use.
  SeamBlender seams_;
  std::vector<int> filtered_;                 // blocks
  std::vector<std::vector<KernelTap>> taps_;  // of the blocks that are filtered
  std::vector<float> padded_;                 // one channel with its replicated border
  std::ptrdiff_t stride_ = 0;                 // of padded_, in floats
  int pad_x_ = 0, pad_y_ = 0;                 // border of padded_
};

}  // namespace gyro_deblur
