// Blocks filtered with the inverse of their whole path in the plane.
#pragma once

#include <map>
#include <vector>

#include <opencv2/core.hpp>

#include "base/fourier.hpp"
#include "base/fourier_loops.hpp"
#include "engine/seam_blender.hpp"
#include "gyro_deblur/engine.hpp"
#include "inverse/plane_gain.hpp"

namespace gyro_deblur {

/// Filters blocks in the frequency domain. Blocks are cut into cells, and every cell has a window, whose weight rises
/// and falls as the square of a sine between the middles of its neighbours. A tile holds the window and, beside it,
/// what is behind it in the image fading into what is before it, so that its period shows no edge. A pixel is the
/// weighted mean over the windows that cover it, the same function of the place for all blocks: between these there are
/// no seams. What lies outside of the image is unknown: where a window ends with the image, it is replaced by what the
/// result would look like there, blurred again. Keeps its memory.
class PlaneFilter {
 public:
  explicit PlaneFilter(const FourierLoops& loops = best_fourier_loops());

  /// Filters `blocks` (indices into the grid, each with an `inverse`) on at most `threads` threads (>= 1) and leaves
  /// the results with `seams`, which has planned for the grid. src, grid and dst are as Engine::filter says, and dst
  /// has src's size and type. The result does not depend on `threads`.
  void filter(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
              SeamBlender& seams, cv::Mat& dst);

 private:
  /// Columns, or rows, of cells.
  struct Axis {
    std::vector<int> borders;                 ///< of cells [px]
    std::vector<int> first_of_block;          ///< cells; behind the last block's, their number
    std::vector<int> window_begins;           ///< of cells [px]
    std::vector<std::vector<float>> weights;  ///< in the windows of cells
  };
  struct Cell {
    int col, row, block;
    cv::Rect window;
    int size;         ///< of its tile, which begins with the window
    bool at_the_end;  ///< of the image
  };
  struct alignas(64) CacheLine {
    float floats[16];
  };
  /// Of one thread.
  struct Scratch {
    explicit Scratch(const PlaneGainLoops& gain_loops) : gain(gain_loops) {}
    PlaneGain gain;
    std::vector<CacheLine> tiles, continued, gain_rows, transform;
    std::vector<float> fade_x, fade_y, row, inside_x, inside_y;
  };

  static float* floats_in(std::vector<CacheLine>& lines, int count);
  static void cut(const std::vector<int>& borders, Axis& axis);
  /// Cells of `blocks`; makes the padding as wide as they look beyond the image.
  void cut_cells(const FilterGrid& grid, const std::vector<int>& blocks, cv::Size size);
  template <typename Pixel>
  void load_tile(const cv::Mat& padded, const Cell& cell, Scratch& scratch, float* tile) const;
  /// Replaces what a tile has from outside of the image.
  void continue_tile(const Cell& cell, const FourierStages& plan, Scratch& scratch, float* tile) const;
  template <typename Pixel>
  void filter_cell(const Cell& cell, const PlaneInverse& inverse, Scratch& scratch);
  template <typename Pixel>
  void filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                 SeamBlender& seams, cv::Mat& dst);
  /// Rounds what is computed of a block.
  template <typename Pixel>
  void deliver(int block, SeamBlender& seams, cv::Mat& dst) const;

  const FourierLoops& loops_;
  std::map<int, FourierPlan> plans_;  // by size
  Axis across_, down_;
  std::vector<Cell> cells_[2];  // in even and in odd rows: windows of a list overlap beside each other alone
  int pad_before_ = 0, pad_behind_ = 0;
  std::vector<cv::Mat> channels_, padded_;  // of the image
  // Over the windows in even and in odd columns, which threads fill at the same time: weight times result, by channel,
  // and the weights, unless they sum up to 1 everywhere.
  std::vector<cv::Mat> sums_[2];
  cv::Mat weights_[2];
  bool are_ones_ = true;
  std::vector<Scratch> scratch_;  // by thread
};

}  // namespace gyro_deblur
