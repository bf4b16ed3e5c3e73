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
/// result would look like there, blurred again. Where noise covers what blur has left of fine
/// detail, a cell is filtered in the image at half its size. Keeps its memory.
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
    int length;                               ///< of the image [px]
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
  struct Plan {
    FourierPlan transform;
    PlaneBand band;
  };
  /// The image at one size, and what is filtered at that.
  struct Level {
    Axis across, down;
    std::vector<Cell> cells[2];  ///< in even and in odd rows: windows of a list overlap beside each other alone
    std::map<int, Plan> plans;   ///< by size
    int pad_before = 0, pad_behind = 0;
    std::vector<cv::Mat> padded;  ///< image, by channel
    /// Over the windows in even and in odd columns, which threads fill at the same time: weight times result, by
    /// channel, and the weights, unless they sum up to 1 everywhere.
    std::vector<cv::Mat> sums[2];
    cv::Mat weights[2];
    std::vector<int> around;  ///< by block, how many of it and its neighbours have their cells here

    bool is_used() const { return !cells[0].empty() || !cells[1].empty(); }
  };
  enum { WHOLE, HALF, LEVELS };
  /// Of one thread.
  struct Scratch {
    explicit Scratch(const PlaneGainLoops& gain_loops) : gain(gain_loops) {}
    PlaneGain gain;
    std::vector<CacheLine> tiles, continued, gain_rows, transform;
    std::vector<float> fade_x, fade_y, row, inside_x, inside_y;
    std::vector<float> values, weights, doubled, of_doubling;
    std::vector<int> whole_numbers;
  };

  static float* floats_in(std::vector<CacheLine>& lines, int count);
  static void cut(const std::vector<int>& borders, Axis& axis);
  /// The same windows at half the size.
  static void halve_axis(const Axis& whole, Axis& half);
  /// Cells of `blocks`; makes the padding as wide as they look beyond the image.
  void cut_cells(const FilterGrid& grid, const std::vector<int>& blocks);
  void add_cell(int col, int row, int block, float extent_px, int level);
  static Plan make_plan(int size, int largest_radix, int level);
  /// Where something is filtered, or looked at.
  void clear_sums(const FilterGrid& grid, int threads, Level& level);
  void prepare_levels(const cv::Mat& src, const FilterGrid& grid, int threads);
  template <typename Pixel>
  static void load_tile(const cv::Mat& padded, const Level& level, const Cell& cell, Scratch& scratch, float* tile);
  /// Replaces what a tile has from outside of the image.
  void continue_tile(const Level& level, const Cell& cell, const FourierStages& plan, Scratch& scratch,
                     float* tile) const;
  template <typename Pixel>
  void filter_cell(const Cell& cell, const PlaneInverse& inverse, Level& level, Scratch& scratch) const;
  template <typename Pixel>
  void filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                 SeamBlender& seams, cv::Mat& dst);
  /// Whether the weights sum up to 1 on a block and the margins around it.
  bool are_ones_on(int block, const FilterGrid& grid) const;
  /// Values of a piece of a block, and their weights unless these are ones.
  void gather(int block, const cv::Rect& rect, int channel, bool are_ones, Scratch& scratch) const;
  /// Rounds what is computed of a block.
  template <typename Pixel>
  void deliver(int block, const FilterGrid& grid, SeamBlender& seams, Scratch& scratch, cv::Mat& dst) const;

  const FourierLoops& loops_;
  Level levels_[LEVELS];
  std::vector<cv::Mat> channels_;  // of the image
  cv::Mat half_;
  bool are_ones_ = true;          // the sums of weights
  std::vector<Scratch> scratch_;  // by thread
};

}  // namespace gyro_deblur
