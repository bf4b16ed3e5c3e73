// Inner loops of two scales, once per instruction set (see base/vectors_impl.hpp).
#pragma once

#include "base/vectors_impl.hpp"
#include "engine/cpu/block_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

constexpr int floor_to_int(double x) {
  const int i = static_cast<int>(x);
  return x < i ? i - 1 : i;
}

/// Where row m has `count` pixels from column n on, count <= source.pad.
template <typename Pixel>
inline const Pixel* read_row(const SourcePlane<Pixel>& source, int m, int n, int count) {
  m = clamp_to(m, source.rows);
  if (n < 0) return source.left + m * source.edge_stride + (n < -source.pad ? -source.pad : n);
  if (n + count > source.cols) {
    const int last = source.cols + source.pad - count;
    return source.right + m * source.edge_stride + (n > last ? last : n);
  }
  return source.origin + m * source.stride + n;
}

/// Catmull-Rom weights of the four samples around a position `t` past the second.
struct CubicWeights {
  float w[4];
  constexpr explicit CubicWeights(double t) : w{} {
    w[0] = static_cast<float>((-t + 2 * t * t - t * t * t) / 2);
    w[1] = static_cast<float>((2 - 5 * t * t + 3 * t * t * t) / 2);
    w[2] = static_cast<float>((t + 4 * t * t - 3 * t * t * t) / 2);
    w[3] = static_cast<float>((-t * t + t * t * t) / 2);
  }
};

// Vectors of columns and coarse outputs that are summed together: 8 independent sums hide the latency of an FMA.
constexpr int kColumnVectors = 2;
constexpr int kCoarseOutputs = kCoarseGuard + 1;

/// How samples on the columns and results on the columns are kept. Samples come in groups of kGroup columns; vector p
/// (of 2) of part h of a group is at h * kLanes + p * kGroup / 2.
template <typename Pixel>
struct ColumnFormat {
  using Sample = float;
  using Result = float;
  static constexpr int kGroup = 2 * kLanes;
  static constexpr float kSampleScale = 1, kResultScale = 1;  // units in one grey level
  static Vector load_sample(const float* from) { return load(from); }
  static Vector sum_samples(const float* from, int rows, int stride) {
    Vector sum = {};
    for (int i = 0; i < rows; ++i, from += stride) sum += load(from);
    return sum;
  }
  static void store_results(float* group, int part, const Vector values[2]) {
    store(group + part * kLanes, values[0]);
    store(group + part * kLanes + kGroup / 2, values[1]);
  }
};

struct Range {
  int begin, end;
};

/// Where things are in scratch. Column v of row m holds the image at n = first_column + v + slope (m - center).
struct TwoScaleLayout {
  // m at which columns are at integer n: an integer, so that a slope of 1 needs no interpolation anywhere.
  int center;
  int first_column, columns;  // columns: whole groups
  int coarse_outputs;         // nodes at which the smooth part is evaluated, from node -1
  int first_node;             // node j sums m_begin + [j d, (j + 1) d)
  int nodes;
  int kept_first, kept_rows;                                     // samples kept, relative to m_begin
  int parts_at, kept_at, nodes_at, coarse_at, result_at, total;  // in floats; pixels of SampleRows are at 0

  TwoScaleLayout(const TileGeometry& tile, const TwoScaleFilter& filter, int group, int sample_bytes) {
    const int d = filter.decimation;
    center = tile.m_begin + tile.m_count / 2;
    const double lean = (tile.slope < 0 ? -tile.slope : tile.slope) * (tile.m_count / 2);
    first_column = floor_to_int(tile.n_begin - lean) - 2;  // one for the cubic, one for rounding
    const int last_column = floor_to_int(tile.n_begin + tile.n_count - 1 + lean) + 3;
    columns = round_up(last_column - first_column + 1, group);
    coarse_outputs = round_up((tile.m_count - 1) / d + 3, kCoarseOutputs);
    first_node = -1 - filter.coarse_radius;
    nodes = coarse_outputs + 2 * filter.coarse_radius;
    kept_first = -filter.box_half - 1;
    kept_rows = tile.m_count + 2 * (filter.box_half + 1);
    const int floats_of_kept = round_up(kept_rows * columns * sample_bytes, kCacheLineBytes) / 4;
    parts_at = nodes * d * static_cast<int>(sizeof(void*) / sizeof(float));
    kept_at = round_up(parts_at + nodes * d, kCacheLineBytes / 4);
    nodes_at = kept_at + floats_of_kept;
    coarse_at = nodes_at + nodes * columns;
    result_at = coarse_at + coarse_outputs * columns;
    // Whole vectors are read past the last result.
    total = result_at + tile.m_count * columns + 4 * kLanes;
  }
  /// Pixels read of a row: each column lies between two.
  int pixels_of_row() const { return columns + 1; }

  /// Output rows that need some of the columns [column, column + count): those outside only fill the columns up to
  /// whole vectors, or cross the tile in other rows.
  Range rows_of_columns(const TileGeometry& tile, int column, int count) const {
    // The line through column 0 is at `above` or more, and the one through the last at `below` or less, when a row
    // needs them; two columns more for the cubic, and one for rounding.
    const double above = tile.n_begin - first_column - (column + count - 1) - 3;
    const double below = tile.n_begin - first_column + tile.n_count - 1 - column + 3;
    constexpr double kLevel = 1e-3;  // hardly moves within a tile
    Range rows{0, tile.m_count};
    if (tile.slope > -kLevel && tile.slope < kLevel) return rows;
    const double a = above / tile.slope, b = below / tile.slope;
    const int first = floor_to_int(tile.slope > 0 ? a : b) + center - tile.m_begin;
    const int last = floor_to_int(tile.slope > 0 ? b : a) + 1 + center - tile.m_begin;
    if (first > rows.begin) rows.begin = first;
    if (last + 1 < rows.end) rows.end = last + 1;
    return rows;
  }

  /// Coarse outputs, in whole groups of kCoarseOutputs, for output rows.
  static Range coarse_of_rows(Range rows, int decimation) {
    if (rows.begin >= rows.end) return {0, 0};
    return {rows.begin / decimation / kCoarseOutputs * kCoarseOutputs,
            round_up((rows.end - 1) / decimation + 3, kCoarseOutputs)};
  }
  template <typename Pixel>
  static TwoScaleLayout of(const TileGeometry& tile, const TwoScaleFilter& filter) {
    return TwoScaleLayout(tile, filter, ColumnFormat<Pixel>::kGroup, sizeof(typename ColumnFormat<Pixel>::Sample));
  }
};

template <typename Pixel>
TileNeeds two_scale_needs(const TileGeometry& tile, const TwoScaleFilter& filter) {
  const TwoScaleLayout layout = TwoScaleLayout::of<Pixel>(tile, filter);
  return {static_cast<std::size_t>(layout.total), layout.pixels_of_row()};
}

/// Where a tile's samples come from: for sample row i, the pixel at or below column 0, and how far the columns are
/// between pixels.
template <typename Pixel>
struct SampleRows {
  static constexpr int kPartBits = 32;
  static constexpr double kOnePixel = 4294967296.0;

  const Pixel** pixels;
  std::uint32_t* parts;  // of 2^kPartBits
  int keep_begin, keep_end;

  SampleRows(const SourcePlane<Pixel>& source, const TileGeometry& tile, const TwoScaleFilter& filter,
             const TwoScaleLayout& layout, float* scratch)
      : pixels(reinterpret_cast<const Pixel**>(scratch)),
        parts(reinterpret_cast<std::uint32_t*>(scratch + layout.parts_at)),
        keep_begin(layout.kept_first - layout.first_node * filter.decimation),
        keep_end(keep_begin + layout.kept_rows) {
    const int samples = layout.nodes * filter.decimation;
    const int first_m = tile.m_begin + layout.first_node * filter.decimation;
    // In fixed point: exact to 2^-32 px a row, and without a call to floor() for each.
    const std::int64_t step = static_cast<std::int64_t>(tile.slope * kOnePixel);
    std::int64_t across = step * (first_m - layout.center);
    for (int i = 0; i < samples; ++i, across += step) {
      parts[i] = static_cast<std::uint32_t>(across);
      const int first = layout.first_column + static_cast<int>(across >> kPartBits);
      pixels[i] = read_row(source, first_m + i, first, layout.pixels_of_row());
    }
  }

  /// Samples of [begin, end) that are kept; where there are none, an empty range inside of it.
  Range kept_within(int begin, int end) const {
    const int count = end - begin + 1;
    return {begin + clamp_to(keep_begin - begin, count), begin + clamp_to(keep_end - begin, count)};
  }
};

/// Sums samples [begin, end) of two vectors of columns, and keeps them at `kept` when kKeep.
template <typename Pixel, bool kKeep>
inline void sum_samples(const SampleRows<Pixel>& rows, int begin, int end, int column, int columns, Vector* sum,
                        float* kept) {
  for (int i = begin; i < end; ++i) {
    const Pixel* from = rows.pixels[i] + column;
    const float part = static_cast<float>(rows.parts[i]) * static_cast<float>(1 / SampleRows<Pixel>::kOnePixel);
    for (int v = 0; v < 2; ++v) {
      const Vector below = load_pixels(from + v * kLanes);
      const Vector above = load_pixels(from + v * kLanes + 1);
      const Vector sample = below + part * (above - below);
      sum[v] += sample;
      if (kKeep) store(kept + (i - rows.keep_begin) * columns + column + v * kLanes, sample);
    }
  }
}

/// Resamples the neighbourhood into columns (linear across the line), sums nodes, and keeps the samples that boxes
/// need.
template <typename Pixel>
inline void shear(const SourcePlane<Pixel>& source, const TileGeometry& tile, const TwoScaleFilter& filter,
                  const TwoScaleLayout& layout, float* scratch, float* kept) {
  const SampleRows<Pixel> rows(source, tile, filter, layout, scratch);
  const int d = filter.decimation, columns = layout.columns;
  for (int column = 0; column < columns; column += 2 * kLanes) {
    const Range outputs = layout.coarse_of_rows(layout.rows_of_columns(tile, column, 2 * kLanes), d);
    for (int j = outputs.begin; j < outputs.end + 2 * filter.coarse_radius; ++j) {
      const int begin = j * d, end = begin + d;
      const Range kept_part = rows.kept_within(begin, end);
      Vector sum[2] = {};
      sum_samples<Pixel, false>(rows, begin, kept_part.begin, column, columns, sum, kept);
      sum_samples<Pixel, true>(rows, kept_part.begin, kept_part.end, column, columns, sum, kept);
      sum_samples<Pixel, false>(rows, kept_part.end, end, column, columns, sum, kept);
      for (int v = 0; v < 2; ++v) store(scratch + layout.nodes_at + j * columns + column + v * kLanes, sum[v]);
    }
  }
}

/// Calls filter_at(j, column) for all coarse outputs that are needed: kCoarseOutputs from j on, kColumnVectors vectors
/// from `column` on.
template <typename Format, typename FilterAt>
inline void for_coarse_outputs(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                               FilterAt filter_at) {
  static_assert(Format::kGroup % (kColumnVectors * kLanes) == 0, "vectors are of one group, whose columns are mixed");
  for (int column = 0; column < layout.columns; column += kColumnVectors * kLanes) {
    const Range rows = layout.rows_of_columns(tile, column / Format::kGroup * Format::kGroup, Format::kGroup);
    const Range outputs = layout.coarse_of_rows(rows, filter.decimation);
    for (int j = outputs.begin; j < outputs.end; j += kCoarseOutputs) filter_at(j, column);
  }
}

/// Filters the sums over nodes with the coarse weights.
template <typename Pixel>
inline void filter_coarse(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                          float* scratch) {
  const int taps = 2 * filter.coarse_radius + 1, columns = layout.columns;
  // Weights have kCoarseGuard zeros on either side, so that every output sees every node of the span.
  const float* weights = filter.coarse;
  for_coarse_outputs<ColumnFormat<Pixel>>(tile, filter, layout, [&](int j, int column) {
    Vector acc[kCoarseOutputs][kColumnVectors] = {};
    const float* from = scratch + layout.nodes_at + j * columns + column;
    for (int k = 0; k < taps + kCoarseOutputs - 1; ++k, from += columns) {
      for (int v = 0; v < kColumnVectors; ++v) {
        const Vector node = load(from + v * kLanes);
        for (int o = 0; o < kCoarseOutputs; ++o) acc[o][v] += weights[k - o] * node;
      }
    }
    float* to = scratch + layout.coarse_at + j * columns + column;
    for (int o = 0; o < kCoarseOutputs; ++o) {
      for (int v = 0; v < kColumnVectors; ++v) store(to + o * columns + v * kLanes, acc[o][v]);
    }
  });
}

/// Adds boxes and smooth part up for every output row, on the columns.
template <typename Format>
inline void add_scales(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                       const float* coarse, const typename Format::Sample* kept, typename Format::Result* result) {
  const int d = filter.decimation, columns = layout.columns;
  const float unit = Format::kResultScale / Format::kSampleScale;
  const float both = unit * (filter.inner_box + filter.outer_box), outer = unit * filter.outer_box;
  // The spline over one node is a parabola, which is followed by its differences.
  const float step = 1.0f / static_cast<float>(d), first_u = -0.5f * static_cast<float>(d - 1) * step;
  for (int group = 0; group < columns; group += Format::kGroup) {
    const Range rows = layout.rows_of_columns(tile, group, Format::kGroup);
    const int first_node = rows.begin / d, first_m = first_node * d;
    for (int part = 0; part < Format::kGroup / (2 * kLanes); ++part) {
      const int at[2] = {group + part * kLanes, group + part * kLanes + Format::kGroup / 2};
      Vector box[2], leaving[2];  // samples of the inner box, and the one before it
      for (int p = 0; p < 2; ++p) {
        const typename Format::Sample* from = kept + first_m * columns + at[p];
        box[p] = Format::sum_samples(from + columns, 2 * filter.box_half + 1, columns);
        leaving[p] = Format::load_sample(from);
      }
      for (int node = first_node, m = first_m; m < rows.end; ++node) {
        Vector value[2], slope[2], slope_step[2];
        for (int p = 0; p < 2; ++p) {
          const float* from = coarse + node * columns + at[p];  // of the node before
          const Vector before = load(from), here = load(from + columns), after = load(from + 2 * columns);
          const Vector linear = 0.5f * (after - before), square = 0.5f * (before + after) - here;
          value[p] = here + 0.25f * square + first_u * (linear + first_u * square);
          slope[p] = step * (linear + (2 * first_u + step) * square);
          slope_step[p] = (2 * step * step) * square;
        }
        const int last = m + d < rows.end ? m + d : rows.end;
        for (; m < last; ++m) {
          const typename Format::Sample* entering_row = kept + (m + 2 * filter.box_half + 2) * columns;
          const typename Format::Sample* leaving_row = kept + (m + 1) * columns;
          Vector sum[2];
          for (int p = 0; p < 2; ++p) {
            const Vector entering = Format::load_sample(entering_row + at[p]);
            sum[p] = value[p] + both * box[p] + outer * (entering + leaving[p]);
            leaving[p] = Format::load_sample(leaving_row + at[p]);
            box[p] += entering - leaving[p];
            value[p] += slope[p];
            slope[p] += slope_step[p];
          }
          Format::store_results(result + m * columns + group, part, sum);
        }
      }
    }
  }
}

/// Resamples the columns to pixels (Catmull-Rom).
template <typename Pixel>
inline void unshear(const TileGeometry& tile, const TwoScaleLayout& layout, const float* result, Pixel* out) {
  for (int m = 0; m < tile.m_count; ++m) {
    const double column = tile.n_begin - tile.slope * (tile.m_begin + m - layout.center) - layout.first_column;
    const int below = floor_to_int(column);
    const CubicWeights across(column - below);
    const float* row = result + m * layout.columns + below - 1;
    for (int n = 0; n < tile.n_count; n += kLanes) {
      Vector sum = across.w[0] * load(row + n);
      for (int q = 1; q < 4; ++q) sum += across.w[q] * load(row + n + q);
      store_pixels(out + m * kTileStride + n, sum);
    }
  }
}

#if defined(GYRO_DEBLUR_HAS_WORD_VECTORS)

/// 8-bit pixels: samples in int16, 1 / 32 grey level, so that one instruction interpolates 16 columns. It takes pixels
/// in pairs, n with n + 1, so that a vector has every other column: a group is its 16 even and then its 16 odd columns.
/// Results in order, in 1 / 16 grey level.
template <>
struct ColumnFormat<std::uint8_t> {
  using Sample = std::int16_t;
  using Result = std::int16_t;
  static constexpr int kGroup = 32;
  static constexpr float kSampleScale = 32, kResultScale = 16;
  // Sums of so many samples fit uint16.
  static constexpr int kSummands = 8;

  static Vector load_sample(const std::int16_t* from) {
    return load_pixels(reinterpret_cast<const std::uint16_t*>(from));
  }
  static Vector sum_samples(const std::int16_t* from, int rows, int stride) {
    typedef std::uint16_t Words __attribute__((vector_size(2 * kLanes)));
    Vector sum = {};
    while (rows > 0) {
      Words words = {};
      const int count = rows < kSummands ? rows : kSummands;
      for (int i = 0; i < count; ++i, from += stride) words += load_as<Words>(from);
      std::int16_t stored[kLanes];
      std::memcpy(stored, &words, sizeof words);
      sum += load_sample(stored);
      rows -= count;
    }
    return sum;
  }
  static void store_results(std::int16_t* group, int part, const Vector values[2]) {
    store_interleaved(group + part * 2 * kLanes, values[0], values[1]);
  }
};

/// Adds samples [begin, end) of kGroups groups of columns to `sum`, and keeps them at `kept` when kKeep.
template <int kGroups, bool kKeep>
inline void sum_samples(const SampleRows<std::uint8_t>& rows, const std::int32_t* weights, int begin, int end,
                        int column, int columns, WordVector sum[][2], std::int16_t* kept) {
  for (int i = begin; i < end; ++i) {
    const std::uint8_t* from = rows.pixels[i] + column;
    const WordVector weight = repeat_pair(weights[i]);
    for (int g = 0; g < kGroups; ++g) {
      for (int odd = 0; odd < 2; ++odd) {
        const WordVector sample = multiply_bytes(load_words(from + g * 32 + odd), weight);
        sum[g][odd] = add_words(sum[g][odd], sample);
        if (kKeep) store_words(kept + (i - rows.keep_begin) * columns + column + g * 32 + odd * 16, sample);
      }
    }
  }
}

/// Halvings that make the sum of a node fit 16 bits: one of more samples than fit is summed in parts of as many as do.
inline int node_shift(const TwoScaleFilter& filter) {
  int shift = 0;
  while (filter.decimation > ColumnFormat<std::uint8_t>::kSummands << shift) ++shift;
  return shift;
}

template <int kGroups>
inline void shear_groups(const SampleRows<std::uint8_t>& rows, const std::int32_t* weights, const TileGeometry& tile,
                         const TwoScaleFilter& filter, const TwoScaleLayout& layout, int column, std::int32_t* nodes,
                         std::int16_t* kept) {
  using Format = ColumnFormat<std::uint8_t>;
  const int d = filter.decimation, columns = layout.columns;
  const int shift = node_shift(filter);
  const WordVector half = repeat_word(static_cast<std::int16_t>(shift > 0 ? 1 << (shift - 1) : 0));
  WordVector before[kGroups][2] = {};  // the node before an odd one
  const Range outputs = layout.coarse_of_rows(layout.rows_of_columns(tile, column, kGroups * Format::kGroup), d);
  for (int j = outputs.begin; j < outputs.end + 2 * filter.coarse_radius; ++j) {
    WordVector node[kGroups][2];
    for (int g = 0; g < kGroups; ++g) node[g][0] = node[g][1] = WordVector{};
    for (int begin = j * d; begin < (j + 1) * d; begin += Format::kSummands) {
      const int end = begin + Format::kSummands < (j + 1) * d ? begin + Format::kSummands : (j + 1) * d;
      const Range kept_part = rows.kept_within(begin, end);
      WordVector sum[kGroups][2];
      for (int g = 0; g < kGroups; ++g) sum[g][0] = sum[g][1] = WordVector{};
      sum_samples<kGroups, false>(rows, weights, begin, kept_part.begin, column, columns, sum, kept);
      sum_samples<kGroups, true>(rows, weights, kept_part.begin, kept_part.end, column, columns, sum, kept);
      sum_samples<kGroups, false>(rows, weights, kept_part.end, end, column, columns, sum, kept);
      for (int g = 0; g < kGroups; ++g) {
        for (int odd = 0; odd < 2; ++odd) {
          const WordVector part = shift_words(add_words(sum[g][odd], half), shift);
          node[g][odd] = add_words(node[g][odd], part);
        }
      }
    }
    for (int g = 0; g < kGroups; ++g) {
      for (int odd = 0; odd < 2; ++odd) {
        if (j % 2 == 0) {
          before[g][odd] = node[g][odd];
        } else {
          store_signed_pairs(nodes + j / 2 * columns + column + g * 32 + odd * 16, before[g][odd], node[g][odd]);
        }
      }
    }
  }
}

inline void shear(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const TwoScaleFilter& filter,
                  const TwoScaleLayout& layout, float* scratch, std::int16_t* kept) {
  const SampleRows<std::uint8_t> rows(source, tile, filter, layout, scratch);
  // Weights of a pixel and the next in the low and high byte of either half, in place of the parts.
  std::int32_t* weights = reinterpret_cast<std::int32_t*>(scratch + layout.parts_at);
  const int samples = layout.nodes * filter.decimation;
  constexpr int kScale = static_cast<int>(ColumnFormat<std::uint8_t>::kSampleScale);
  for (int i = 0; i < samples; ++i) {
    const int above = static_cast<int>((rows.parts[i] * std::uint64_t{kScale} + (std::uint64_t{1} << 31)) >> 32);
    weights[i] = ((kScale - above) | above << 8) * 0x10001;
  }
  std::int32_t* nodes = reinterpret_cast<std::int32_t*>(scratch + layout.nodes_at);
  int column = 0;
  for (; column + 64 <= layout.columns; column += 64) {
    shear_groups<2>(rows, weights, tile, filter, layout, column, nodes, kept);
  }
  for (; column < layout.columns; column += 32)
    shear_groups<1>(rows, weights, tile, filter, layout, column, nodes, kept);
}

template <>
inline void filter_coarse<std::uint8_t>(const TileGeometry& tile, const TwoScaleFilter& filter,
                                        const TwoScaleLayout& layout, float* scratch) {
  using Format = ColumnFormat<std::uint8_t>;
  static_assert(kCoarseOutputs == 4 && kCoarseGuard == 3, "outputs 0 .. 3 take the pairs of weights below");
  const int columns = layout.columns, pairs = filter.coarse_radius + 2;  // of 2 radius + 1 nodes for each of 4 outputs
  const float unit = Format::kResultScale / Format::kSampleScale * static_cast<float>(1 << node_shift(filter)) /
                     static_cast<float>(1 << filter.coarse_shift);
  const float offset = unit * 32768.0f * static_cast<float>(filter.coarse_sum);
  const std::int32_t* nodes = reinterpret_cast<const std::int32_t*>(scratch + layout.nodes_at);
  const std::int32_t *even = filter.coarse_even, *odd = filter.coarse_odd;
  for_coarse_outputs<Format>(tile, filter, layout, [&](int j, int column) {
    IntVector acc[kCoarseOutputs][kColumnVectors] = {};
    const std::int32_t* from = nodes + j / 2 * columns + column;
    for (int p = 0; p < pairs; ++p, from += columns) {
      const std::int32_t weights[kCoarseOutputs] = {even[p], odd[p], even[p - 1], odd[p - 1]};
      for (int v = 0; v < kColumnVectors; ++v) {
        const IntVector node = load(from + v * kLanes);
        for (int o = 0; o < kCoarseOutputs; ++o) acc[o][v] = multiply_pairs(acc[o][v], node, IntVector{} + weights[o]);
      }
    }
    float* to = scratch + layout.coarse_at + j * columns + column;
    for (int o = 0; o < kCoarseOutputs; ++o) {
      for (int v = 0; v < kColumnVectors; ++v) {
        store(to + o * columns + v * kLanes, __builtin_convertvector(acc[o][v], Vector) * unit + offset);
      }
    }
  });
}

/// Weights of the cubic in fixed point, two in one int32, for positions in steps of 1 / kPlaces column: the error, of
/// at most half a step, is that of an image 1 / 512 px away.
struct CubicTable {
  static constexpr int kPlaceBits = 8, kPlaces = 1 << kPlaceBits;
  static constexpr int kWeightBits = 14;
  std::int32_t first[kPlaces], second[kPlaces];
  constexpr CubicTable() : first{}, second{} {
    for (int i = 0; i < kPlaces; ++i) {
      const CubicWeights across(i / static_cast<double>(kPlaces));
      std::int32_t w[4] = {};
      std::int32_t rest = 1 << kWeightBits;
      for (int q = 0; q < 4; ++q) {
        w[q] = floor_to_int(across.w[q] * (1 << kWeightBits) + 0.5);
        rest -= w[q];
      }
      w[i < kPlaces / 2 ? 1 : 2] += rest;
      first[i] = w[1] * (1 << 16) | (w[0] & 0xffff);
      second[i] = w[3] * (1 << 16) | (w[2] & 0xffff);
    }
  }
};
constexpr CubicTable kCubicTable;

inline void unshear(const TileGeometry& tile, const TwoScaleLayout& layout, const std::int16_t* result,
                    std::uint8_t* out) {
  constexpr int kShift = CubicTable::kWeightBits + 4;  // results have 4 bits below the grey level
  static_assert(1 << (kShift - CubicTable::kWeightBits) == static_cast<int>(ColumnFormat<std::uint8_t>::kResultScale),
                "");
  const WordVector half = repeat_pair(1 << (kShift - 1));
  constexpr int kOneBits = 32;
  const std::int64_t step = static_cast<std::int64_t>(tile.slope * (std::int64_t{1} << kOneBits));
  std::int64_t column = static_cast<std::int64_t>(tile.n_begin - layout.first_column) * (std::int64_t{1} << kOneBits) -
                        step * (tile.m_begin - layout.center) +
                        (std::int64_t{1} << (kOneBits - CubicTable::kPlaceBits - 1));
  for (int m = 0; m < tile.m_count; ++m, column -= step) {
    const int place = static_cast<int>(column >> (kOneBits - CubicTable::kPlaceBits)) & (CubicTable::kPlaces - 1);
    const WordVector first = repeat_pair(kCubicTable.first[place]);
    const WordVector second = repeat_pair(kCubicTable.second[place]);
    const std::int16_t* row = result + m * layout.columns + static_cast<int>(column >> kOneBits) - 1;
    for (int n = 0; n < tile.n_count; n += 16) {
      const auto at = [&](int i) { return load_words(row + n + i); };
      const WordVector even = add_ints(add_ints(multiply_words(at(0), first), half), multiply_words(at(2), second));
      const WordVector odd = add_ints(add_ints(multiply_words(at(1), first), half), multiply_words(at(3), second));
      store_interleaved<kShift>(out + m * kTileStride + n, even, odd);
    }
  }
}

#endif

template <typename Pixel>
void two_scale(const SourcePlane<Pixel>& source, const TileGeometry& tile, const TwoScaleFilter& filter, float* scratch,
               Pixel* out) {
  using Format = ColumnFormat<Pixel>;
  const TwoScaleLayout layout = TwoScaleLayout::of<Pixel>(tile, filter);
  auto* kept = reinterpret_cast<typename Format::Sample*>(scratch + layout.kept_at);
  auto* result = reinterpret_cast<typename Format::Result*>(scratch + layout.result_at);
  shear(source, tile, filter, layout, scratch, kept);
  filter_coarse<Pixel>(tile, filter, layout, scratch);
  add_scales<Format>(tile, filter, layout, scratch + layout.coarse_at, kept, result);
  unshear(tile, layout, result, out);
}

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
