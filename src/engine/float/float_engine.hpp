// The engine in float, which others are tested against and the cpu engine falls back on.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "engine/block_engine.hpp"
#include "engine/engine.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur {

/// Sums the non-zero taps of each block's rotated kernel in float, block by block on all threads.
class FloatEngine : public BlockEngine {
 public:
  using BlockEngine::BlockEngine;

  /// Public for engines that leave some blocks to this one.
  void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                     cv::Mat& dst) override;

  std::string name() const override { return "float"; }

 private:
  template <typename Pixel>
  void filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                 cv::Mat& dst);
  /// Makes room for a channel of `size` and the border that taps_ reach.
  void lay_out(cv::Size size, int count);
  template <typename Pixel>
  void load_channel(const cv::Mat& src, int channel);

  // Kept between frames: their allocation would cost more than their use.
  std::vector<std::vector<KernelTap>> taps_;  // of the blocks that are filtered
  std::vector<float> padded_;                 // one channel with its replicated border
  std::ptrdiff_t stride_ = 0;                 // of padded_, in floats
  int pad_x_ = 0, pad_y_ = 0;                 // border of padded_
};

}  // namespace gyro_deblur
