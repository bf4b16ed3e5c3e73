// The fast CPU engine.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "engine/cpu/block_kernels.hpp"
#include "engine/float/float_engine.hpp"
#include "engine/seam_blender.hpp"
#include "gyro_deblur/engine.hpp"
#include "inverse/two_scale_design.hpp"

namespace gyro_deblur {

/// Chooses a method for every block: exact taps for short kernels, two scales along sheared lanes for long
/// ones whose shape is known, and the reference engine for whatever is left. Keeps its buffers between frames.
class CpuEngine : public Engine {
 public:
  /// @param threads  OpenMP threads, >= 0; 0: OpenMP's default
  /// @param kernels  inner loops of one instruction set
  explicit CpuEngine(int threads, const BlockKernels& kernels = best_block_kernels());

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) override;
  /// Whether a kernel whose shape is known is filtered on two scales rather than with exact taps.
  /// @param slope  of the line along its major axis, [-1, 1]
  /// @param depth  CV_8U or CV_16U
  static bool takes_two_scales(const LineKernel& kernel, double slope, int depth);
  /// Rows along the major axis that one tile may have where it does, at most kMaxTileSide.
  static int max_two_scale_rows(const LineKernel& kernel, double slope);

  std::string name() const override { return std::string("cpu-") + kernels_.name; }

 private:
  enum class Method { COPY, EXACT, TWO_SCALE, FLOAT };

  /// One tile (at most kMaxTileSide square) of what is computed of a block.
  struct Tile {
    TileGeometry geometry;
    cv::Rect rect;
    int block;
  };

  /// What is the same for all tiles of a block.
  struct Plan {
    Method method = Method::COPY;
    bool major_is_y = true;
    double slope = 0;
    int max_rows = 0;  // of a tile, along the major axis
    ExactFilter exact{};
    std::vector<PairTap> pair_taps;
    TwoScaleFilter two_scale{};
    std::vector<float> on_axis, coarse;
    std::vector<KernelTap> taps;
    std::vector<std::int32_t> fixed_weights, coarse_pairs;
    TwoScaleWeights weights;
  };

  /// What is kept of a channel beside the channel itself (see SourcePlane).
  template <typename Pixel>
  struct Buffers {
    std::vector<Pixel> edges, transposed;
  };

  void plan_block(const BlockFilter& block, int depth, Plan& plan);
  void plan_exact(const LineKernel& kernel, double angle_rad, Plan& plan) const;
  void plan_two_scale(const LineKernel& kernel, double major, int depth, Plan& plan);
  static void fix_coarse_weights(Plan& plan);
  template <typename Pixel>
  void filter_as(const cv::Mat& src, const FilterGrid& grid, Buffers<Pixel>& buffers, cv::Mat& dst);
  template <typename Pixel>
  void run_tile(const SourcePlane<Pixel>& source, const Tile& tile, const Plan& plan, float* scratch,
                Pixel* line_order) const;

  int threads_;
  const BlockKernels& kernels_;
  FloatEngine float_;
  TwoScaleDesigns designs_;
  std::vector<Plan> plans_;
  std::vector<Tile> tiles_;
  SeamBlender seams_;
  std::vector<int> left_to_float_;  // blocks
  Buffers<std::uint8_t> buffers8_;
  Buffers<std::uint16_t> buffers16_;
  cv::Mat channel_;
  std::vector<std::vector<float>> scratch_;  // by thread
};

}  // namespace gyro_deblur
