#include "cpu/reference_convolver.hpp"

#include <omp.h>

#include <algorithm>
#include <limits>

// One binary for every x86-64: the compiler makes a copy of the inner loop per instruction set and the loader picks
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
// latency of an addition, few enough to stay in registers while the taps go by.
constexpr int kTileRows = 4;
constexpr int kTileCols = 32;
constexpr int kFloatsPerCacheLine = 16;

/// A tap as an offset in the padded channel.
struct OffsetTap {
  std::ptrdiff_t offset;
  float weight;
};

/// Sums `count` taps for the tile whose first pixel is src[0]. Reads a whole tile whatever part of it is wanted.
GYRO_DEBLUR_TARGET_CLONES
void sum_tile(const float* src, std::ptrdiff_t stride, const OffsetTap* taps, std::size_t count, float* out) {
  float sum[kTileRows][kTileCols] = {};
  for (std::size_t i = 0; i < count; ++i) {
    const float* from = src + taps[i].offset;
    const float weight = taps[i].weight;
    for (int row = 0; row < kTileRows; ++row) {
      for (int col = 0; col < kTileCols; ++col) sum[row][col] += weight * from[row * stride + col];
    }
  }
  for (int row = 0; row < kTileRows; ++row) {
    for (int col = 0; col < kTileCols; ++col) out[row * kTileCols + col] = sum[row][col];
  }
}

/// Rounds, clips and stores the wanted part of a tile.
template <typename Pixel>
void store_tile(const float* tile, int rows, int cols, int channel, int x, int y, cv::Mat& dst) {
  constexpr float kMax = std::numeric_limits<Pixel>::max();
  const int channels = dst.channels();
  for (int row = 0; row < rows; ++row) {
    Pixel rounded[kTileCols];
    for (int col = 0; col < kTileCols; ++col) {
      const float clipped = std::min(std::max(tile[row * kTileCols + col], 0.0f), kMax);
      rounded[col] = static_cast<Pixel>(static_cast<int>(clipped + 0.5f));
    }
    Pixel* to = dst.ptr<Pixel>(y + row) + static_cast<std::ptrdiff_t>(x) * channels + channel;
    if (channels == 1) {
      std::copy_n(rounded, cols, to);
    } else {
      for (int col = 0; col < cols; ++col) to[col * channels] = rounded[col];
    }
  }
}

}  // namespace

ReferenceConvolver::ReferenceConvolver(int threads) : threads_(threads) {}

template <typename Pixel>
void ReferenceConvolver::load_channel(const cv::Mat& src, int channel) {
  const int channels = src.channels();
  const int rows = src.rows + 2 * pad_y_;
#pragma omp parallel for num_threads(threads_ > 0 ? threads_ : omp_get_max_threads()) schedule(static)
  for (int y = 0; y < rows; ++y) {
    const Pixel* from = src.ptr<Pixel>(std::clamp(y - pad_y_, 0, src.rows - 1)) + channel;
    float* to = padded_.data() + y * stride_;
    std::fill_n(to, pad_x_, static_cast<float>(from[0]));
    for (int x = 0; x < src.cols; ++x) to[pad_x_ + x] = from[x * channels];
    std::fill_n(to + pad_x_ + src.cols, pad_x_, static_cast<float>(from[(src.cols - 1) * channels]));
  }
}

template <typename Pixel>
void ReferenceConvolver::convolve_as(const cv::Mat& src, const std::vector<BlockFilter>& blocks, cv::Mat& dst) {
  const int threads = threads_ > 0 ? threads_ : omp_get_max_threads();
  const int count = static_cast<int>(blocks.size());
  taps_.resize(std::max(taps_.size(), blocks.size()));
  int pad_x = 0, pad_y = 0;
#pragma omp parallel for num_threads(threads) schedule(dynamic) reduction(max : pad_x, pad_y)
  for (int i = 0; i < count; ++i) {
    const BlockFilter& block = blocks[i];
    if (block.kernel == nullptr) {
      src(block.rect).copyTo(dst(block.rect));
      continue;
    }
    taps_[i] = rotate_kernel(*block.kernel, block.angle_rad);
    for (const KernelTap& tap : taps_[i]) {
      pad_x = std::max(pad_x, std::abs(tap.dx));
      pad_y = std::max(pad_y, std::abs(tap.dy));
    }
  }
  if (std::all_of(blocks.begin(), blocks.end(), [](const BlockFilter& b) { return b.kernel == nullptr; })) return;

  pad_x_ = pad_x;
  pad_y_ = pad_y;
  // An odd number of cache lines a row, so that pixels above each other do not compete for the same cache set. Tiles at
  // the right and lower end of a block read on past it, hence the slack; what they read there is not stored.
  const std::ptrdiff_t lines = (src.cols + 2 * pad_x_ + kTileCols) / kFloatsPerCacheLine + 1;
  stride_ = (lines | 1) * kFloatsPerCacheLine;
  padded_.resize(stride_ * (src.rows + 2 * pad_y_ + kTileRows));

  for (int channel = 0; channel < src.channels(); ++channel) {
    load_channel<Pixel>(src, channel);
#pragma omp parallel num_threads(threads)
    {
      std::vector<OffsetTap> offsets;
      float tile[kTileRows * kTileCols];
#pragma omp for schedule(dynamic)
      for (int i = 0; i < count; ++i) {
        if (blocks[i].kernel == nullptr) continue;
        offsets.clear();
        for (const KernelTap& tap : taps_[i]) {
          // Convolution: output at p takes input at p - tap.
          offsets.push_back({-(tap.dy * stride_ + tap.dx), tap.weight});
        }
        const cv::Rect& rect = blocks[i].rect;
        for (int y = rect.y; y < rect.br().y; y += kTileRows) {
          for (int x = rect.x; x < rect.br().x; x += kTileCols) {
            sum_tile(padded_.data() + (y + pad_y_) * stride_ + x + pad_x_, stride_, offsets.data(), offsets.size(),
                     tile);
            store_tile<Pixel>(tile, std::min(kTileRows, rect.br().y - y), std::min(kTileCols, rect.br().x - x), channel,
                              x, y, dst);
          }
        }
      }
    }
  }
}

void ReferenceConvolver::convolve(const cv::Mat& src, const std::vector<BlockFilter>& blocks, cv::Mat& dst) {
  require_convolvable(src);
  dst.create(src.size(), src.type());
  if (src.depth() == CV_8U) {
    convolve_as<std::uint8_t>(src, blocks, dst);
  } else {
    convolve_as<std::uint16_t>(src, blocks, dst);
  }
}

}  // namespace gyro_deblur
