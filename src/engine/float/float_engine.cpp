// Filters each pixel with all taps, in float.
#include "engine/float/float_engine.hpp"

#include <algorithm>
#include <limits>

#include "base/parallel.hpp"
#include "engine/engine.hpp"

// One binary for every x86-64: the compiler makes a variant of the inner loop per instruction set and the loader picks
// one. It does so before ThreadSanitizer has started, which ends the process.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__) && \
    !defined(__SANITIZE_THREAD__)
#define GYRO_DEBLUR_TARGET_CLONES __attribute__((target_clones("avx512f", "fma", "default")))
#else
#define GYRO_DEBLUR_TARGET_CLONES
#endif

namespace gyro_deblur {
namespace {

// Outputs that are summed at a time. Sixteen 8-float or eight 16-float registers: enough independent sums to hide the
// latency of an addition, few enough to stay in registers while the taps go by. The narrow shape is for what is left of
// a row: the margins of a block are 8 px.
constexpr int kTileRows = 4;
constexpr int kTileCols = 32;
constexpr int kNarrowTileRows = 16;
constexpr int kNarrowTileCols = 8;
constexpr int kFloatsPerCacheLine = 16;

/// A tap as an offset in the padded channel.
struct OffsetTap {
  std::ptrdiff_t offset;
  float weight;
};

/// Of one thread.
struct FloatScratch {
  std::vector<OffsetTap> offsets;
  cv::Mat result;
};

template <int kRows, int kCols>
inline __attribute__((always_inline)) void sum_outputs(const float* src, std::ptrdiff_t stride, const OffsetTap* taps,
                                                       std::size_t count, float* out) {
  float sum[kRows][kCols] = {};
  for (std::size_t i = 0; i < count; ++i) {
    const float* from = src + taps[i].offset;
    const float weight = taps[i].weight;
    for (int row = 0; row < kRows; ++row) {
      for (int col = 0; col < kCols; ++col) sum[row][col] += weight * from[row * stride + col];
    }
  }
  for (int row = 0; row < kRows; ++row) {
    for (int col = 0; col < kCols; ++col) out[row * kCols + col] = sum[row][col];
  }
}

/// Sums `count` taps for the tile whose first pixel is src[0]. Reads a whole tile whatever part of it is wanted.
GYRO_DEBLUR_TARGET_CLONES
void sum_tile(const float* src, std::ptrdiff_t stride, const OffsetTap* taps, std::size_t count, float* out) {
  sum_outputs<kTileRows, kTileCols>(src, stride, taps, count, out);
}

GYRO_DEBLUR_TARGET_CLONES
void sum_narrow_tile(const float* src, std::ptrdiff_t stride, const OffsetTap* taps, std::size_t count, float* out) {
  sum_outputs<kNarrowTileRows, kNarrowTileCols>(src, stride, taps, count, out);
}

/// Rounds, clips and stores the wanted part of a tile of kCols columns.
template <int kCols, typename Pixel>
void store_tile(const float* tile, int rows, int cols, Pixel* to, std::ptrdiff_t stride) {
  constexpr float kMax = std::numeric_limits<Pixel>::max();
  for (int row = 0; row < rows; ++row) {
    Pixel rounded[kCols];
    for (int col = 0; col < kCols; ++col) {
      const float clipped = std::min(std::max(tile[row * kCols + col], 0.0f), kMax);
      rounded[col] = static_cast<Pixel>(static_cast<int>(clipped + 0.5f));
    }
    std::copy_n(rounded, cols, to + row * stride);
  }
}

/// Filters `size` pixels, the first of which is src[0].
template <typename Pixel>
void filter_block(const float* src, std::ptrdiff_t stride, const std::vector<OffsetTap>& taps, cv::Size size,
                  Pixel* result) {
  static_assert(kTileRows * kTileCols == kNarrowTileRows * kNarrowTileCols, "`tile` holds either kind");
  float tile[kTileRows * kTileCols];
  for (int x = 0; x < size.width;) {
    const bool narrow = size.width - x <= kNarrowTileCols;
    const int tile_cols = narrow ? kNarrowTileCols : kTileCols, tile_rows = narrow ? kNarrowTileRows : kTileRows;
    const int cols = std::min(tile_cols, size.width - x);
    for (int y = 0; y < size.height; y += tile_rows) {
      const float* from = src + y * stride + x;
      Pixel* to = result + static_cast<std::ptrdiff_t>(y) * size.width + x;
      const int rows = std::min(tile_rows, size.height - y);
      if (narrow) {
        sum_narrow_tile(from, stride, taps.data(), taps.size(), tile);
        store_tile<kNarrowTileCols>(tile, rows, cols, to, size.width);
      } else {
        sum_tile(from, stride, taps.data(), taps.size(), tile);
        store_tile<kTileCols>(tile, rows, cols, to, size.width);
      }
    }
    x += tile_cols;
  }
}

}  // namespace

template <typename Pixel>
void FloatEngine::load_channel(const cv::Mat& src, int channel) {
  const int channels = src.channels();
  const int rows = src.rows + 2 * pad_y_;
  constexpr int kRowsAtATime = 16;
  parallel_for(rows, threads(), kRowsAtATime, [&](int y) {
    const Pixel* from = src.ptr<Pixel>(std::clamp(y - pad_y_, 0, src.rows - 1)) + channel;
    float* to = padded_.data() + y * stride_;
    std::fill_n(to, pad_x_, static_cast<float>(from[0]));
    for (int x = 0; x < src.cols; ++x) to[pad_x_ + x] = from[x * channels];
    std::fill_n(to + pad_x_ + src.cols, pad_x_, static_cast<float>(from[(src.cols - 1) * channels]));
  });
}

void FloatEngine::lay_out(cv::Size size, int count) {
  pad_x_ = pad_y_ = 0;
  for (int i = 0; i < count; ++i) {
    for (const KernelTap& tap : taps_[i]) {
      pad_x_ = std::max(pad_x_, std::abs(tap.dx));
      pad_y_ = std::max(pad_y_, std::abs(tap.dy));
    }
  }
  // An odd number of cache lines a row, so that pixels above each other do not compete for the same cache set. Tiles at
  // the right and lower end of a block read on past it, hence the slack; what they read there is not stored.
  const std::ptrdiff_t lines = (size.width + 2 * pad_x_ + kTileCols) / kFloatsPerCacheLine + 1;
  stride_ = (lines | 1) * kFloatsPerCacheLine;
  padded_.resize(stride_ * (size.height + 2 * pad_y_ + kNarrowTileRows));
}

template <typename Pixel>
void FloatEngine::filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks,
                            SeamBlender& seams, cv::Mat& dst) {
  const int count = static_cast<int>(blocks.size());
  taps_.resize(std::max(taps_.size(), blocks.size()));
  parallel_for(count, threads(), 1, [&](int i) {
    const BlockFilter& block = grid.blocks[blocks[i]];
    taps_[i] = rotate_kernel(*block.kernel, block.angle_rad);
  });
  lay_out(src.size(), count);

  const int most_threads = threads();
  std::vector<FloatScratch> scratch(most_threads);
  for (int channel = 0; channel < src.channels(); ++channel) {
    load_channel<Pixel>(src, channel);
    parallel_for(count, most_threads, 1, [&](int i, int thread) {
      auto& [offsets, result] = scratch[thread];
      offsets.clear();
      for (const KernelTap& tap : taps_[i]) {
        // Convolution: output at p takes input at p - tap.
        offsets.push_back({-(tap.dy * stride_ + tap.dx), tap.weight});
      }
      const cv::Rect rect = seams.reach(blocks[i]);
      result.create(rect.size(), src.depth());
      filter_block(padded_.data() + (rect.y + pad_y_) * stride_ + rect.x + pad_x_, stride_, offsets, rect.size(),
                   result.ptr<Pixel>());
      seams.store(blocks[i], result, dst, channel);
    });
  }
}

void FloatEngine::filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks,
                                SeamBlender& seams, cv::Mat& dst) {
  if (blocks.empty()) return;
  if (src.depth() == CV_8U) {
    filter_as<std::uint8_t>(src, grid, blocks, seams, dst);
  } else {
    filter_as<std::uint16_t>(src, grid, blocks, seams, dst);
  }
}

}  // namespace gyro_deblur
