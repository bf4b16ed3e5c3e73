// The 2-D filter: blocks filtered with the inverse of their whole path, in the frequency domain.
#pragma once

#include <map>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "base/fourier.hpp"
#include "base/fourier_simd.hpp"
#include "engine/engine.hpp"
#include "engine/half_size_simd.hpp"
#include "engine/seam_blender.hpp"
#include "engine/tile_simd.hpp"
#include "inverse/wiener_gain_2d.hpp"

namespace gyro_deblur {

/// Filters blocks in the frequency domain, cell by cell, in tiles with overlapping windows: there are no seams between
/// its blocks. Where noise hides fine detail a cell is filtered at half the image's size. See
/// doc/design/fourier_filter.md. Keeps its memory.
class FourierFilter {
 public:
  explicit FourierFilter(const FourierSimd& simd = select_for_cpu<FourierSimd>());

  /// Filters `blocks` (indices into the grid, each with an `inverse`) on at most `threads` threads (>= 1) and hands
  /// the results to `seams`, which has planned for the grid. src, grid and dst are as Engine::filter says, and dst
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

    int cells() const { return first_of_block.back(); }
    int window_end(int cell) const { return window_begins[cell] + static_cast<int>(weights[cell].size()); }
  };
  struct Cell {
    int col, row, block;
    cv::Rect window;
    cv::Size tile;       ///< begins with the window
    bool at_the_end;     ///< of the image
    std::size_t result;  ///< in results_: the window's pixels times their weights, channel by channel
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
    std::vector<Cell> cells;
    std::vector<int> cell_at;     ///< by row and column of cells; -1 where none is filtered
    std::map<int, Plan> plans;    ///< by length
    std::vector<cv::Mat> images;  ///< by channel
  };
  enum { WHOLE, HALF, LEVELS };
  /// What a level has for what is computed of a block.
  struct Part {
    cv::Rect pixels;         ///< of its image
    std::vector<int> cells;  ///< whose windows reach into these
    bool has_all = false;    ///< all that are in the grid there
  };
  /// Of one thread.
  struct Scratch {
    explicit Scratch(const WienerGain2dSimd& gain_simd) : gain(gain_simd) {}
    WienerGain2d gain;
    std::vector<CacheLine> tiles, continued, gains, again, transform, row;
    std::vector<float> fade_x, fade_y, inside_x, inside_y;
    std::vector<float> values[LEVELS], weights[LEVELS], halves, of_doubling;
    Part parts[LEVELS];
  };

  static float* floats_in(std::vector<CacheLine>& lines, int count);
  static void cut(const std::vector<int>& borders, Axis& axis);
  /// The same windows at half the size.
  static void downsample2x_axis(const Axis& whole, Axis& half);
  void make_tiles(const FilterGrid& grid, const std::vector<int>& blocks, int channels);
  void add_cell(int col, int row, int block, const Eigen::Vector2f& extent_px, int channels, int level);
  static Plan make_plan(int size, int largest_radix, int level);
  void prepare_images(const cv::Mat& src, int threads);
  void load_tile(const cv::Mat& image, const Cell& cell, Scratch& scratch, float* tile) const;
  /// Replaces what a tile has from outside of the image.
  void continue_tile(const Level& level, const Cell& cell, const FourierTile& plan, Scratch& scratch,
                     float* tile) const;
  void filter_cell(const Cell& cell, const WienerInverse2d& inverse, const Level& level, Scratch& scratch);
  template <typename Pixel>
  void filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                 SeamBlender& seams, cv::Mat& dst);
  void find_part(int level, const FilterGrid& grid, int block, const cv::Rect& rect, Part& part) const;
  /// Sums of what a part's cells have in `rect`, what is computed of a block: results, or, without a channel, weights.
  void overlap_add(int level, const Part& part, const cv::Rect& rect, std::optional<int> channel, Scratch& scratch,
                   std::vector<float>& sums) const;
  /// Rounds what is computed of a block.
  template <typename Pixel>
  void write_block(int block, const FilterGrid& grid, SeamBlender& seams, Scratch& scratch, cv::Mat& dst) const;

  const FourierSimd& simd_;
  const WienerGain2dSimd& gain_simd_;
  const TileSimd& tile_simd_;
  const HalfSizeSimd& half_size_simd_;
  Level levels_[LEVELS];
  std::vector<cv::Mat> planes_;  // of an image with several channels
  std::vector<float> results_;   // 16 bytes a pixel and channel where all blocks are filtered at the whole size
  std::size_t result_count_ = 0;
  std::vector<Scratch> scratch_;  // by thread
};

}  // namespace gyro_deblur
