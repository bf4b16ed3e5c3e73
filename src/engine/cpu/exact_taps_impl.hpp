// Inner loops of exact taps, once per instruction set (see base/vectors_impl.hpp).
#pragma once

#include "base/vectors_impl.hpp"
#include "engine/cpu/block_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

// Outputs that are summed together: enough independent sums to hide the latency of a multiply-add.
constexpr int kExactRows = kRegisters == 32 ? 4 : 2;
#if defined(GYRO_DEBLUR_HAS_BYTE_PAIRS)
constexpr int kExactVectors = 4;  // lanes of a vector of bytes
#else
constexpr int kExactVectors = kRegisters == 32 ? 3 : 2;
#endif

struct ExactLayout {
  int rows, width, first_m, first_n;
  ExactLayout(const TileGeometry& tile, const ExactFilter& filter)
      : rows(round_up(tile.m_count, kExactRows) + 2 * filter.radius_m),
        // Whole vectors are read for the last outputs.
        width(round_up(round_up(tile.n_count, kLanes) + filter.n_max - filter.n_min, kLanes) + kLanes),
        first_m(tile.m_begin - filter.radius_m),
        first_n(tile.n_begin + filter.n_min) {}
};

/// Lets `sum` fill the sums for kExactRows by kVectors outputs from (m, n) on, and stores those inside the tile.
template <int kVectors, typename Sum>
inline void store_exact_outputs(const TileGeometry& tile, const ExactFilter& filter, std::uint8_t* out, int stride,
                                int m, int n, Sum sum) {
  IntVector sums[kExactRows][kVectors];
  sum((m + filter.radius_m) * stride + n - filter.n_min, sums);
  for (int row = 0; row < kExactRows && m + row < tile.m_count; ++row) {
    for (int v = 0; v < kVectors; ++v) {
      store_pixels(out + (m + row) * kTileStride + n + v * kLanes,
                   __builtin_convertvector(sums[row][v], Vector) * filter.scale);
    }
  }
}

/// Walks over the tile's outputs, kExactRows by at most kExactVectors, and lets sum(at, sums) set the sums for the
/// outputs whose first one is at offset `at` of the neighbourhood, whose rows are `stride` apart.
template <typename Sum>
inline void for_exact_outputs(const TileGeometry& tile, const ExactFilter& filter, std::uint8_t* out, int stride,
                              Sum sum) {
  static_assert(kExactVectors >= 2 && kExactVectors <= 4, "");
  for (int m = 0; m < tile.m_count; m += kExactRows) {
    int n = 0;
    for (; n + (kExactVectors - 1) * kLanes < tile.n_count; n += kExactVectors * kLanes) {
      store_exact_outputs<kExactVectors>(tile, filter, out, stride, m, n, sum);
    }
    if (n + kLanes < tile.n_count) {
      store_exact_outputs<kExactVectors - 1>(tile, filter, out, stride, m, n, sum);
    } else if (n < tile.n_count) {
      store_exact_outputs<1>(tile, filter, out, stride, m, n, sum);
    }
  }
}

/// Columns of a neighbourhood: a pair begins in the last one.
inline int pair_columns(const ExactLayout& layout) { return round_up(layout.width + 1, kCacheLineBytes); }

/// Room for pixels in pairs, of 32 bits at most, and in bytes. Quads, of which there are fewer than rows, take less.
TileNeeds exact_needs(const TileGeometry& tile, const ExactFilter& filter) {
  const ExactLayout layout(tile, filter);
  const std::size_t pixels = static_cast<std::size_t>(layout.rows) * pair_columns(layout);
  return {pixels * (sizeof(std::int32_t) + 1) / sizeof(float), 0};
}

void exact_pairs_u8(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const ExactFilter& filter,
                    float* scratch, std::uint8_t* out) {
  const ExactLayout layout(tile, filter);
  const int columns = pair_columns(layout);
  Pair* pairs = reinterpret_cast<Pair*>(scratch);
  std::uint8_t* bytes = reinterpret_cast<std::uint8_t*>(pairs + layout.rows * layout.width);
  copy_extended(source, layout, columns, bytes, columns);
  for (int r = 0; r < layout.rows; ++r) {
    const std::uint8_t* from = bytes + r * columns;
    Pair* to = pairs + r * layout.width;
    for (int i = 0; i < layout.width; ++i) to[i] = pair_at(from + i);
  }
  for_exact_outputs(tile, filter, out, layout.width, [&](int at, auto& sums) {
    constexpr int kVectors = sizeof sums[0] / sizeof(IntVector);
    IntVector acc[kExactRows][kVectors] = {};  // local, so that it stays in registers
    for (int t = 0; t < filter.count; ++t) {
      const PairTap& tap = filter.taps[t];
      const Pair* from = pairs + at + tap.m * layout.width + tap.n;
      for (int row = 0; row < kExactRows; ++row, from += layout.width) {
        for (int v = 0; v < kVectors; ++v) {
          acc[row][v] = add_pairs(acc[row][v], from + v * kLanes, tap.weights);
        }
      }
    }
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kVectors; ++v) sums[row][v] = acc[row][v];
    }
  });
}

#if defined(GYRO_DEBLUR_HAS_BYTE_PRODUCTS) || defined(GYRO_DEBLUR_HAS_BYTE_PAIRS)

constexpr bool kHasByteWeights = true;

/// Columns of a neighbourhood, and the stride with space for a vector that begins in the last one.
inline int byte_columns(const ExactLayout& layout) { return round_up(layout.width, kCacheLineBytes); }
inline int byte_stride(const ExactLayout& layout) { return byte_columns(layout) + 64; }

/// The neighbourhood, pixels less kByteOffset.
inline void copy_bytes(const SourcePlane<std::uint8_t>& source, const ExactLayout& layout, std::uint8_t* bytes) {
  const int columns = byte_columns(layout), stride = byte_stride(layout);
  copy_extended(source, layout, columns, bytes, stride);
  for (int r = 0; kByteOffset != 0 && r < layout.rows; ++r) {
    for (int i = 0; i < columns; ++i) bytes[r * stride + i] ^= kByteOffset;
  }
}

/// What kByteOffset of all pixels has of a sum.
inline std::int32_t sum_of_offset(const ExactFilter& filter) {
  std::int32_t sum = 0;
  for (int t = 0; t < filter.count; ++t) {
    sum += kByteOffset * (static_cast<std::int16_t>(filter.taps[t].weights) + (filter.taps[t].weights >> 16));
  }
  return sum;
}

#endif

#if defined(GYRO_DEBLUR_HAS_BYTE_PRODUCTS)

// Two steps of the line at once: bytes (m, n), (m, n + 1) of one and (m', n'), (m', n' + 1) of the next are put side by
// side for kLanes outputs by one permutation, and multiplied by one dot product with weights in bytes.
struct Quad {
  int lower, upper;      // places of the first byte of either step in the neighbourhood, relative to the output
  std::int32_t weights;  // a byte each
};

inline std::int32_t pack_bytes(std::int32_t a, std::int32_t b, std::int32_t c, std::int32_t d) {
  return (a & 0xff) | (b & 0xff) << 8 | (c & 0xff) << 16 | static_cast<std::int32_t>((d & 0xffu) << 24);
}

void exact_bytes_u8(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const ExactFilter& filter,
                    float* scratch, std::uint8_t* out) {
  const ExactLayout layout(tile, filter);
  const int stride = byte_stride(layout);
  std::uint8_t* bytes = reinterpret_cast<std::uint8_t*>(scratch);
  copy_bytes(source, layout, bytes);

  Quad* list = reinterpret_cast<Quad*>(bytes + layout.rows * stride);
  int count = 0;
  for (int t = 0; t < filter.count; t += 2) {
    const PairTap& lower = filter.taps[t];
    const int at = lower.m * stride + lower.n;
    Quad quad{at, at, pack_bytes(lower.weights, lower.weights >> 16, 0, 0)};
    if (t + 1 < filter.count) {
      const PairTap& upper = filter.taps[t + 1];
      quad.upper = upper.m * stride + upper.n;
      quad.weights |= pack_bytes(0, 0, upper.weights, upper.weights >> 16);
    }
    list[count++] = quad;
  }

  static_assert(kExactVectors * kLanes < static_cast<int>(sizeof(Bytes)), "a vector reaches them and the byte after");
  Bytes order[kExactVectors];
  for (int v = 0; v < kExactVectors; ++v) order[v] = side_by_side(v * kLanes);

  const std::int32_t of_offset = sum_of_offset(filter);
  for_exact_outputs(tile, filter, out, stride, [&](int at, auto& sums) {
    constexpr int kVectors = sizeof sums[0] / sizeof(IntVector);
    IntVector acc[kExactRows][kVectors];  // local, so that it stays in registers
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kVectors; ++v) acc[row][v] = IntVector{} + of_offset;
    }
    for (int q = 0; q < count; ++q) {
      const std::uint8_t *lower = bytes + at + list[q].lower, *upper = bytes + at + list[q].upper;
      for (int row = 0; row < kExactRows; ++row, lower += stride, upper += stride) {
        const Bytes first = load_bytes(lower), second = load_bytes(upper);
        for (int v = 0; v < kVectors; ++v) {
          acc[row][v] = add_byte_products(acc[row][v], first, second, order[v], list[q].weights);
        }
      }
    }
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kVectors; ++v) sums[row][v] = acc[row][v];
    }
  });
}

#elif defined(GYRO_DEBLUR_HAS_BYTE_PAIRS)

void exact_bytes_u8(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const ExactFilter& filter,
                    float* scratch, std::uint8_t* out) {
  const ExactLayout layout(tile, filter);
  const int stride = byte_stride(layout);
  std::uint8_t* bytes = reinterpret_cast<std::uint8_t*>(scratch);
  copy_bytes(source, layout, bytes);
  const std::int32_t of_offset = sum_of_offset(filter);
  for_exact_outputs(tile, filter, out, stride, [&](int at, auto& sums) {
    constexpr int kVectors = sizeof sums[0] / sizeof(IntVector);
    IntVector acc[kExactRows][kVectors];  // local, so that it stays in registers
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kVectors; ++v) acc[row][v] = IntVector{} + of_offset;
    }
    for (int t = 0; t < filter.count; ++t) {
      const PairTap& tap = filter.taps[t];
      const std::uint8_t* from = bytes + at + tap.m * stride + tap.n;
      for (int row = 0; row < kExactRows; ++row, from += stride) add_byte_pairs(acc[row], from, tap.weights);
    }
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kVectors; ++v) sums[row][v] = acc[row][v];
    }
  });
}

#else

constexpr bool kHasByteWeights = false;
constexpr auto exact_bytes_u8 = exact_pairs_u8;

#endif

void exact_u8(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const ExactFilter& filter,
              float* scratch, std::uint8_t* out) {
  (filter.weights_are_bytes ? exact_bytes_u8 : exact_pairs_u8)(source, tile, filter, scratch, out);
}

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
