// Cross-fade between the results of neighbouring blocks, so that no border shows.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "engine/engine.hpp"

namespace gyro_deblur {

/// The rule by which all engines blend; Engine says what comes out.
///
/// - A border between two columns (rows) of blocks has a margin m, the largest of 4, 2, 1 and 0 px that is at most half
///   of either; 0 at the edge of the image, and where the filters on either side of the whole line are the same,
///   or both have 2-D filters, which are one function of the place.
/// - A filtered block is computed on its rectangle and the margins around it. A copied block is the input everywhere.
/// - Over the m px on either side of a border, the weight of the block behind it rises in 2 m + 1 equal steps, in x and
///   y independently. The weighted mean of the blocks' rounded results is rounded.
/// - Where a copied block is among the eight neighbours, the filtered block then fades into the input: over the m px
///   next to it (by Chebyshev distance), in m + 1 equal steps.
///
/// Weights are whole 256ths and arithmetic is exact, so that the result does not depend on who computes it. How to use:
/// plan(), put the results of all filtered blocks where parts() says (or store() them), copy the others, blend(). Keeps
/// its memory.
class SeamBlender {
 public:
  /// Margins for images of `type`. Preconditions: type and grid are as Engine::filter asks; the grid lives until after
  /// blend().
  void plan(const FilterGrid& grid, int type);

  /// What has to be computed of a block: its rectangle and the margins around it, inside the image.
  cv::Rect reach(int block) const;

  /// A piece of a block's reach, and where its pixels go: channel c of (x, y) to
  /// to[(y - rect.y) * stride + (x - rect.x) * channels + c].
  template <typename Pixel>
  struct Part {
    cv::Rect rect;  ///< may be empty
    Pixel* to;
    std::ptrdiff_t stride;
  };

  /// The pieces that cover the reach of a filtered block: one that is final, and four that wait for their neighbours.
  /// Blocks may be stored from several threads.
  template <typename Pixel>
  std::array<Part<Pixel>, 5> parts(int block, cv::Mat& dst);

  /// Stores a filtered block at once. `result`: the pixels of its reach, or one channel of them, which is `channel`.
  void store(int block, const cv::Mat& result, cv::Mat& dst, int channel = 0);

  /// Blends what is stored into `dst`, in which copied blocks hold the input. `src` is the input.
  void blend(const cv::Mat& src, int threads, cv::Mat& dst) const;

 private:
  enum Strip { TOP, BOTTOM, LEFT, RIGHT };

  /// Results of a block, from some pixel on.
  template <typename Pixel>
  struct View {
    const Pixel* at;
    std::ptrdiff_t stride;
  };

  struct Margins {
    int left, top, right, bottom;
  };

  /// Where a block is; worked out once a plan.
  struct Place {
    cv::Rect rect;
    Margins margins;
    std::array<std::size_t, 4> offsets;  ///< of its strips in results_ [bytes]
  };

  bool is_copied(int block) const { return grid_->blocks[block].copies(); }
  /// Pixels of a block that are computed for a border, from margin to margin.
  cv::Rect strip_rect(int block, Strip strip) const;
  template <typename Pixel>
  View<Pixel> view(int block, Strip strip, int x, int y, const cv::Mat& src) const;

  template <typename Pixel>
  void blend_as(const cv::Mat& src, int threads, cv::Mat& dst) const;
  template <typename Pixel>
  void blend_right(int block, const cv::Mat& src, cv::Mat& dst) const;
  template <typename Pixel>
  void blend_below(int block, const cv::Mat& src, cv::Mat& dst) const;
  template <typename Pixel>
  void blend_corner(int block, const cv::Mat& src, cv::Mat& dst) const;
  template <typename Pixel>
  void fade(int block, const cv::Mat& src, cv::Mat& dst) const;

  const FilterGrid* grid_ = nullptr;
  int channels_ = 1;
  std::vector<int> margin_x_, margin_y_;  // by border of the grid, the edges of the image included
  std::vector<Place> places_;             // of the blocks
  std::vector<std::uint8_t> results_;     // strips of all filtered blocks
  bool blends_ = false, fades_ = false;
};

}  // namespace gyro_deblur
