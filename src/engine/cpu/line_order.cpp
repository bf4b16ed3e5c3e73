// Copies pixels between an image and line order.
#include "engine/cpu/line_order.hpp"

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "base/parallel.hpp"

// The operations of the baseline: this file is compiled once.
#define GYRO_DEBLUR_ISA baseline
#define GYRO_DEBLUR_VECTOR_BYTES 16
#include "base/vectors_impl.hpp"

namespace gyro_deblur {
namespace {

/// to(x, y) = from(y, x) for rows x cols pixels of `from`.
template <typename Pixel>
void transpose(const Pixel* from, std::ptrdiff_t from_stride, int rows, int cols, Pixel* to, std::ptrdiff_t to_stride) {
  const bool bytes = sizeof(Pixel) == 1;
  const int whole_rows = bytes ? rows / 8 * 8 : 0, whole_cols = bytes ? cols / 8 * 8 : 0;
  for (int y = 0; y < whole_rows; y += 8) {
    // Rows are too far apart for the processor to foresee.
    constexpr int kRowsAhead = 32;
    for (int i = y + kRowsAhead; i < std::min(y + kRowsAhead + 8, rows); ++i) {
      __builtin_prefetch(from + i * from_stride);
      __builtin_prefetch(from + i * from_stride + cols - 1);
    }
    for (int x = 0; x < whole_cols; x += 8) {
      baseline::transpose_bytes(reinterpret_cast<const std::uint8_t*>(from + y * from_stride + x), from_stride,
                                reinterpret_cast<std::uint8_t*>(to + x * to_stride + y), to_stride);
    }
  }
  for (int y = 0; y < rows; ++y) {
    for (int x = y < whole_rows ? whole_cols : 0; x < cols; ++x) to[x * to_stride + y] = from[y * from_stride + x];
  }
}

/// Makes room for `rows` rows of `cols` pixels. Returns the distance between rows: an odd number of cache lines, so
/// that rows do not compete for the same cache set.
template <typename Pixel>
std::ptrdiff_t reserve_rows(int rows, int cols, std::vector<Pixel>& storage) {
  constexpr int kPixelsPerLine = 64 / sizeof(Pixel);
  const std::ptrdiff_t stride = ((cols / kPixelsPerLine + 1) | 1) * kPixelsPerLine;
  const std::size_t needed = stride * rows;
  if (storage.size() < needed) storage.resize(needed);
  return stride;
}

/// Copies fewer than a hundred pixels without a call: in pieces, the last of which may overlap the one before.
template <typename Pixel>
void copy_pixels(const Pixel* from, int count, Pixel* to) {
  constexpr int kPiece = 16 / sizeof(Pixel);
  if (count < kPiece) {
    std::copy_n(from, count, to);
    return;
  }
  for (int i = 0; i + kPiece < count; i += kPiece) std::memcpy(to + i, from + i, 16);
  std::memcpy(to + count - kPiece, from + count - kPiece, 16);
}

/// Stores one channel of the part of a tile, given in line order, that lies in `part`.
template <typename Pixel>
void store_in_part(const Pixel* line_order, const cv::Rect& tile, bool major_is_y, int channel, int channels,
                   const SeamBlender::Part<Pixel>& part) {
  const cv::Rect rect = tile & part.rect;
  if (rect.empty()) return;
  const cv::Point at = rect.tl() - tile.tl(), in_part = rect.tl() - part.rect.tl();
  Pixel* to = part.to + in_part.y * part.stride + static_cast<std::ptrdiff_t>(in_part.x) * channels + channel;
  const Pixel* from = line_order + (major_is_y ? at.y * kTileStride + at.x : at.x * kTileStride + at.y);
  if (channels == 1 && major_is_y) {
    for (int y = 0; y < rect.height; ++y) copy_pixels(from + y * kTileStride, rect.width, to + y * part.stride);
    return;
  }
  if (channels == 1) {
    transpose(from, kTileStride, rect.width, rect.height, to, part.stride);
    return;
  }
  for (int y = 0; y < rect.height; ++y) {
    for (int x = 0; x < rect.width; ++x) {
      to[y * part.stride + x * channels] = major_is_y ? from[y * kTileStride + x] : from[x * kTileStride + y];
    }
  }
}

}  // namespace

template <typename Pixel>
SourcePlane<Pixel> upright_plane(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& edges) {
  const Pixel* origin = channel.ptr<Pixel>();
  const auto origin_stride = static_cast<std::ptrdiff_t>(channel.step1());
  if (pad == 0) return {origin, origin_stride, channel.rows, channel.cols, origin, origin, origin_stride, 0};
  const std::ptrdiff_t stride = reserve_rows(channel.rows, 4 * pad, edges);
  const int cols = channel.cols, copied = std::min(pad, cols);
  constexpr int kRowsAtATime = 32;
  parallel_for(channel.rows, threads, kRowsAtATime, [&](int y) {
    const Pixel *from = channel.ptr<Pixel>(y), first = from[0], last = from[cols - 1];
    Pixel* to = std::fill_n(edges.data() + y * stride, pad, first);
    to = std::fill_n(std::copy_n(from, copied, to), pad - copied, last);
    to = std::copy_n(from + cols - copied, copied, std::fill_n(to, pad - copied, first));
    std::fill_n(to, pad, last);
  });
  return {origin, origin_stride, channel.rows, cols, edges.data() + pad, edges.data() + 3 * pad - cols, stride, pad};
}

template <typename Pixel>
SourcePlane<Pixel> transposed_plane(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& storage) {
  const std::ptrdiff_t stride = reserve_rows(channel.cols, channel.rows + 2 * pad, storage);
  constexpr int kBand = 64;  // columns of the channel that one thread transposes at a time
  parallel_for((channel.cols + kBand - 1) / kBand, threads, 1, [&](int i_band) {
    const int x = i_band * kBand;
    const int band = std::min(kBand, channel.cols - x);
    transpose(channel.ptr<Pixel>(0) + x, channel.step1(), channel.rows, band, storage.data() + x * stride + pad,
              stride);
    for (int i = x; i < x + band; ++i) {
      Pixel* row = storage.data() + i * stride;
      std::fill_n(row, pad, row[pad]);
      std::fill_n(row + pad + channel.rows, pad, row[pad + channel.rows - 1]);
    }
  });
  const Pixel* origin = storage.data() + pad;
  return {origin, stride, channel.cols, channel.rows, origin, origin, stride, pad};
}

template <typename Pixel>
void store_tile(const Pixel* line_order, const cv::Rect& tile, bool major_is_y, int block, int channel,
                SeamBlender& seams, cv::Mat& dst) {
  for (const SeamBlender::Part<Pixel>& part : seams.parts<Pixel>(block, dst)) {
    store_in_part(line_order, tile, major_is_y, channel, dst.channels(), part);
  }
}

template SourcePlane<std::uint8_t> upright_plane(const cv::Mat&, int, int, std::vector<std::uint8_t>&);
template SourcePlane<std::uint16_t> upright_plane(const cv::Mat&, int, int, std::vector<std::uint16_t>&);
template SourcePlane<std::uint8_t> transposed_plane(const cv::Mat&, int, int, std::vector<std::uint8_t>&);
template SourcePlane<std::uint16_t> transposed_plane(const cv::Mat&, int, int, std::vector<std::uint16_t>&);
template void store_tile(const std::uint8_t*, const cv::Rect&, bool, int, int, SeamBlender&, cv::Mat&);
template void store_tile(const std::uint16_t*, const cv::Rect&, bool, int, int, SeamBlender&, cv::Mat&);

}  // namespace gyro_deblur
