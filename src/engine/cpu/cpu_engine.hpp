// The fast CPU engine.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "engine/block_engine.hpp"
#include "engine/cpu/block_method.hpp"
#include "engine/cpu/block_simd.hpp"
#include "engine/cpu/line_order.hpp"
#include "engine/engine.hpp"
#include "engine/float/float_engine.hpp"
#include "inverse/exact_taps.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/tap_simd.hpp"
#include "inverse/two_scale_taps.hpp"

namespace gyro_deblur {

/// Filters every block with the method that block_method.hpp chooses for it. Keeps its buffers between frames.
class CpuEngine : public BlockEngine {
 public:
  /// @param threads  at most, >= 0; 0: one for each core, see parallel_for_ranges
  /// @param kernels  inner loops of one instruction set
  explicit CpuEngine(int threads, const BlockSimd& kernels = select_for_cpu<BlockSimd>());

  /// "cpu-" and the instruction set.
  std::string name() const override;

  /// The designs of two scales.
  void prepare(const std::vector<const LineKernel*>& kernels) override;
  std::size_t prepared_designs() const { return designs_.size(); }

  /// Blocks that were left to the float engine.
  FallbackCounts fallback_counts() const override { return fallback_counts_; }

 protected:
  void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                     cv::Mat& dst) override;

 private:
  /// What is the same for all tiles of a block.
  struct Plan {
    std::string fallback;  // not empty: the float engine's, and what follows does not matter
    bool sheared = false;  // two_scale rather than exact
    bool major_is_y = true;
    double slope = 0;
    int max_rows = 0;  // of a tile, along the major axis
    ExactTaps exact;
    TwoScaleTaps two_scale;
  };

  /// One tile (at most kMaxTileSide square) of what is computed of a block.
  struct Tile {
    TileGeometry geometry;
    cv::Rect rect;
    int block;
    const Plan* plan;
  };

  void plan_block(const BlockFilter& block, int depth, Plan& plan);
  /// Plans of `blocks`, in their order; which are left to the float engine, and why.
  void plan_blocks(const FilterGrid& grid, const std::vector<int>& blocks, int depth);
  /// Tiles of all blocks that are not left to the float engine. Returns the largest needs.
  TileNeeds cut_tiles(const std::vector<int>& blocks, int depth, const SeamBlender& seams);
  template <typename Pixel>
  void run_tile(const SourcePlane<Pixel>& source, const Tile& tile, float* scratch, Pixel* line_order) const;
  template <typename Pixel>
  void run_tiles(const cv::Mat& plane, int pad, int channel, PlaneBuffers<Pixel>& buffers, SeamBlender& seams,
                 cv::Mat& dst);

  const BlockSimd& kernels_;
  const TapSimd& tap_simd_;
  FloatEngine float_;
  TwoScaleDesigns designs_;
  std::vector<Plan> plans_;
  std::vector<Tile> tiles_;
  FallbackCounts fallback_counts_;
  std::vector<int> left_to_float_;  // blocks
  PlaneBuffers<std::uint8_t> buffers8_;
  PlaneBuffers<std::uint16_t> buffers16_;
  cv::Mat channel_;
  std::vector<std::vector<float>> scratch_;  // by thread
};

}  // namespace gyro_deblur
