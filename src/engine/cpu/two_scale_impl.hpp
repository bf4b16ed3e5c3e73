// Inner loops of two scales, once per instruction set (see base/vectors_impl.hpp).
#pragma once

#include "base/vectors_impl.hpp"
#include "engine/cpu/block_simd.hpp"
#include "engine/cpu/two_scale_layout_impl.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

/// Sums samples [begin, end) of two vectors of columns from `column` on, and keeps them from `kept` on when kKeep.
template <typename Pixel, bool kKeep>
inline void sum_samples(const SampleRows<Pixel>& rows, int begin, int end, int column, Vector* sum, float* kept) {
  constexpr int kPanel = ColumnFormat<Pixel>::kPanel;
  for (int i = begin; i < end; ++i) {
    const Pixel* from = rows.pixels[i] + column;
    const float part = static_cast<float>(rows.parts[i]) * static_cast<float>(1 / SampleRows<Pixel>::kOnePixel);
    for (int v = 0; v < 2; ++v) {
      const Vector below = load_pixels(from + v * kLanes);
      const Vector above = load_pixels(from + v * kLanes + 1);
      const Vector sample = below + part * (above - below);
      sum[v] += sample;
      if (kKeep) store(kept + (i - rows.keep_begin) * kPanel + v * kLanes, sample);
    }
  }
}

/// Makes of the rows' parts what shear() takes.
template <typename Pixel>
inline void make_weights(const SampleRows<Pixel>&, int) {}

/// Resamples the neighbourhood into the columns of a panel (linear across the line), sums nodes, and keeps the samples
/// that boxes need.
template <typename Pixel>
inline void shear(const SampleRows<Pixel>& rows, const TileGeometry& tile, const TwoScaleFilter& filter,
                  const TwoScaleLayout& layout, const Range& panel, float* scratch, float* kept) {
  constexpr int kPanel = ColumnFormat<Pixel>::kPanel;
  const int d = filter.decimation;
  for (int column = panel.begin; column < panel.end; column += 2 * kLanes) {
    const Range outputs = layout.coarse_of_rows(layout.rows_of_columns(tile, column, 2 * kLanes), d);
    float *kept_column = kept + column - panel.begin, *nodes = scratch + layout.nodes_at + column - panel.begin;
    for (int j = outputs.begin; j < outputs.end + 2 * filter.coarse_radius; ++j) {
      const int begin = j * d, end = begin + d;
      const Range kept_part = rows.kept_within(begin, end);
      Vector sum[2] = {};
      sum_samples<Pixel, false>(rows, begin, kept_part.begin, column, sum, kept_column);
      sum_samples<Pixel, true>(rows, kept_part.begin, kept_part.end, column, sum, kept_column);
      sum_samples<Pixel, false>(rows, kept_part.end, end, column, sum, kept_column);
      for (int v = 0; v < 2; ++v) store(nodes + j * kPanel + v * kLanes, sum[v]);
    }
  }
}

/// Calls filter_at(j, column) for all coarse outputs of a panel that are needed: kCoarseOutputs from j on,
/// kColumnVectors vectors from `column` of the panel on.
template <typename Format, typename FilterAt>
inline void for_coarse_outputs(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                               const Range& panel, FilterAt filter_at) {
  static_assert(Format::kGroup % (kColumnVectors * kLanes) == 0, "vectors are of one group, whose columns are mixed");
  static_assert(Format::kPanel % Format::kGroup == 0, "panels have whole groups");
  for (int column = panel.begin; column < panel.end; column += kColumnVectors * kLanes) {
    const Range rows = layout.rows_of_columns(tile, column / Format::kGroup * Format::kGroup, Format::kGroup);
    const Range outputs = layout.coarse_of_rows(rows, filter.decimation);
    for (int j = outputs.begin; j < outputs.end; j += kCoarseOutputs) filter_at(j, column - panel.begin);
  }
}

/// Filters the sums over nodes with the coarse weights.
template <typename Pixel>
inline void filter_coarse(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                          const Range& panel, float* scratch) {
  constexpr int kPanel = ColumnFormat<Pixel>::kPanel;
  const int taps = 2 * filter.coarse_radius + 1;
  // Weights have kCoarseGuard zeros on either side, so that every output sees every node of the span.
  const float* weights = filter.coarse;
  for_coarse_outputs<ColumnFormat<Pixel>>(tile, filter, layout, panel, [&](int j, int column) {
    Vector acc[kCoarseOutputs][kColumnVectors] = {};
    const float* from = scratch + layout.nodes_at + j * kPanel + column;
    for (int k = 0; k < taps + kCoarseOutputs - 1; ++k, from += kPanel) {
      for (int v = 0; v < kColumnVectors; ++v) {
        const Vector node = load(from + v * kLanes);
        for (int o = 0; o < kCoarseOutputs; ++o) acc[o][v] += weights[k - o] * node;
      }
    }
    float* to = scratch + layout.coarse_at + j * kPanel + column;
    for (int o = 0; o < kCoarseOutputs; ++o) {
      for (int v = 0; v < kColumnVectors; ++v) store(to + o * kPanel + v * kLanes, acc[o][v]);
    }
  });
}

/// Adds boxes and smooth part up for every output row, on the columns of a panel.
template <typename Format>
inline void add_scales(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                       const Range& panel, const float* coarse, const typename Format::Sample* kept,
                       typename Format::Result* result) {
  constexpr int kPanel = Format::kPanel;
  const int d = filter.decimation, columns = layout.columns;
  const float unit = Format::kResultScale / Format::kSampleScale;
  const float both = unit * (filter.inner_box + filter.outer_box), outer = unit * filter.outer_box;
  // The spline over one node is a parabola, which is followed by its differences.
  const float step = 1.0f / static_cast<float>(d), first_u = -0.5f * static_cast<float>(d - 1) * step;
  for (int group = panel.begin; group < panel.end; group += Format::kGroup) {
    const Range rows = layout.rows_of_columns(tile, group, Format::kGroup);
    const int first_node = rows.begin / d, first_m = first_node * d;
    for (int part = 0; part < Format::kGroup / (2 * kLanes); ++part) {
      const int first = group - panel.begin + part * kLanes, at[2] = {first, first + Format::kGroup / 2};
      Vector box[2], leaving[2];  // samples of the inner box, and the one before it
      for (int p = 0; p < 2; ++p) {
        const typename Format::Sample* from = kept + first_m * kPanel + at[p];
        box[p] = Format::sum_samples(from + kPanel, 2 * filter.box_half + 1);
        leaving[p] = Format::load_sample(from);
      }
      for (int node = first_node, m = first_m; m < rows.end; ++node) {
        Vector value[2], slope[2], slope_step[2];
        for (int p = 0; p < 2; ++p) {
          const float* from = coarse + node * kPanel + at[p];  // of the node before
          const Vector before = load(from), here = load(from + kPanel), after = load(from + 2 * kPanel);
          const Vector linear = 0.5f * (after - before), square = 0.5f * (before + after) - here;
          value[p] = here + 0.25f * square + first_u * (linear + first_u * square);
          slope[p] = step * (linear + (2 * first_u + step) * square);
          slope_step[p] = (2 * step * step) * square;
        }
        const int last = m + d < rows.end ? m + d : rows.end;
        for (; m < last; ++m) {
          const typename Format::Sample* entering_row = kept + (m + 2 * filter.box_half + 2) * kPanel;
          const typename Format::Sample* leaving_row = kept + (m + 1) * kPanel;
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
  static constexpr int kPanel = 2 * kGroup;
  static constexpr float kSampleScale = 32, kResultScale = 16;
  // Sums of so many samples fit uint16.
  static constexpr int kSummands = 8;

  static Vector load_sample(const std::int16_t* from) {
    return load_pixels(reinterpret_cast<const std::uint16_t*>(from));
  }
  static Vector sum_samples(const std::int16_t* from, int rows) {
    typedef std::uint16_t Words __attribute__((vector_size(2 * kLanes)));
    Vector sum = {};
    while (rows > 0) {
      Words words = {};
      const int count = rows < kSummands ? rows : kSummands;
      for (int i = 0; i < count; ++i, from += kPanel) words += load_as<Words>(from);
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

/// Adds samples [begin, end) of kGroups groups of columns from `column` on to `sum`, and keeps them from `kept` on when
/// kKeep.
template <int kGroups, bool kKeep>
inline void sum_samples(const SampleRows<std::uint8_t>& rows, int begin, int end, int column, WordVector sum[][2],
                        std::int16_t* kept) {
  for (int i = begin; i < end; ++i) {
    const std::uint8_t* from = rows.pixels[i] + column;
    std::int16_t* to = kept + (i - rows.keep_begin) * ColumnFormat<std::uint8_t>::kPanel;
    const WordVector weight = repeat_pair(static_cast<std::int32_t>(rows.parts[i]));
    for (int g = 0; g < kGroups; ++g) {
      for (int odd = 0; odd < 2; ++odd) {
        const WordVector sample = multiply_bytes(load_words(from + g * 32 + odd), weight);
        sum[g][odd] = add_words(sum[g][odd], sample);
        if (kKeep) store_words(to + g * 32 + odd * 16, sample);
      }
    }
  }
}

/// Weights of a pixel and the next in the low and high byte of either half.
template <>
inline void make_weights(const SampleRows<std::uint8_t>& rows, int count) {
  constexpr int kScale = static_cast<int>(ColumnFormat<std::uint8_t>::kSampleScale);
  for (int i = 0; i < count; ++i) {
    const auto above =
        static_cast<std::uint32_t>((rows.parts[i] * std::uint64_t{kScale} + (std::uint64_t{1} << 31)) >> 32);
    rows.parts[i] = ((kScale - above) | above << 8) * 0x10001;
  }
}

/// Halvings that make the sum of a node fit 16 bits: one of more samples than fit is summed in parts of as many as do.
inline int node_shift(const TwoScaleFilter& filter) {
  int shift = 0;
  while (filter.decimation > ColumnFormat<std::uint8_t>::kSummands << shift) ++shift;
  return shift;
}

template <int kGroups>
inline void shear_groups(const SampleRows<std::uint8_t>& rows, const TwoScaleFilter& filter, const Range& outputs,
                         int column, std::int32_t* nodes, std::int16_t* kept) {
  using Format = ColumnFormat<std::uint8_t>;
  const int d = filter.decimation, shift = node_shift(filter);
  const WordVector half = repeat_word(static_cast<std::int16_t>(shift > 0 ? 1 << (shift - 1) : 0));
  WordVector before[kGroups][2] = {};  // the node before an odd one
  for (int j = outputs.begin; j < outputs.end + 2 * filter.coarse_radius; ++j) {
    WordVector node[kGroups][2];
    for (int g = 0; g < kGroups; ++g) node[g][0] = node[g][1] = WordVector{};
    for (int begin = j * d; begin < (j + 1) * d; begin += Format::kSummands) {
      const int end = begin + Format::kSummands < (j + 1) * d ? begin + Format::kSummands : (j + 1) * d;
      const Range kept_part = rows.kept_within(begin, end);
      WordVector sum[kGroups][2];
      for (int g = 0; g < kGroups; ++g) sum[g][0] = sum[g][1] = WordVector{};
      sum_samples<kGroups, false>(rows, begin, kept_part.begin, column, sum, kept);
      sum_samples<kGroups, true>(rows, kept_part.begin, kept_part.end, column, sum, kept);
      sum_samples<kGroups, false>(rows, kept_part.end, end, column, sum, kept);
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
          store_signed_pairs(nodes + j / 2 * Format::kPanel + g * 32 + odd * 16, before[g][odd], node[g][odd]);
        }
      }
    }
  }
}

inline void shear(const SampleRows<std::uint8_t>& rows, const TileGeometry& tile, const TwoScaleFilter& filter,
                  const TwoScaleLayout& layout, const Range& panel, float* scratch, std::int16_t* kept) {
  const int count = panel.end - panel.begin;
  const Range outputs = layout.coarse_of_rows(layout.rows_of_columns(tile, panel.begin, count), filter.decimation);
  std::int32_t* nodes = reinterpret_cast<std::int32_t*>(scratch + layout.nodes_at);
  if (count == ColumnFormat<std::uint8_t>::kPanel) {
    shear_groups<2>(rows, filter, outputs, panel.begin, nodes, kept);
  } else {
    shear_groups<1>(rows, filter, outputs, panel.begin, nodes, kept);
  }
}

template <>
inline void filter_coarse<std::uint8_t>(const TileGeometry& tile, const TwoScaleFilter& filter,
                                        const TwoScaleLayout& layout, const Range& panel, float* scratch) {
  using Format = ColumnFormat<std::uint8_t>;
  static_assert(kCoarseOutputs == 4 && kCoarseGuard == 3, "outputs 0 .. 3 take the pairs of weights below");
  const int pairs = filter.coarse_radius + 2;  // of 2 radius + 1 nodes for each of 4 outputs
  const float unit = Format::kResultScale / Format::kSampleScale * static_cast<float>(1 << node_shift(filter)) /
                     static_cast<float>(1 << filter.coarse_shift);
  const float offset = unit * 32768.0f * static_cast<float>(filter.coarse_sum);
  const std::int32_t* nodes = reinterpret_cast<const std::int32_t*>(scratch + layout.nodes_at);
  const std::int32_t *even = filter.coarse_even, *odd = filter.coarse_odd;
  for_coarse_outputs<Format>(tile, filter, layout, panel, [&](int j, int column) {
    IntVector acc[kCoarseOutputs][kColumnVectors] = {};
    const std::int32_t* from = nodes + j / 2 * Format::kPanel + column;
    for (int p = 0; p < pairs; ++p, from += Format::kPanel) {
      const std::int32_t weights[kCoarseOutputs] = {even[p], odd[p], even[p - 1], odd[p - 1]};
      for (int v = 0; v < kColumnVectors; ++v) {
        const IntVector node = load(from + v * kLanes);
        for (int o = 0; o < kCoarseOutputs; ++o) acc[o][v] = multiply_pairs(acc[o][v], node, IntVector{} + weights[o]);
      }
    }
    float* to = scratch + layout.coarse_at + j * Format::kPanel + column;
    for (int o = 0; o < kCoarseOutputs; ++o) {
      for (int v = 0; v < kColumnVectors; ++v) {
        store(to + o * Format::kPanel + v * kLanes, __builtin_convertvector(acc[o][v], Vector) * unit + offset);
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
  const SampleRows<Pixel> rows(source, tile, filter, layout, scratch);
  make_weights(rows, layout.nodes * filter.decimation);
  for (Range panel{0, 0}; panel.begin < layout.columns; panel.begin = panel.end) {
    panel.end = panel.begin + Format::kPanel < layout.columns ? panel.begin + Format::kPanel : layout.columns;
    shear(rows, tile, filter, layout, panel, scratch, kept);
    filter_coarse<Pixel>(tile, filter, layout, panel, scratch);
    add_scales<Format>(tile, filter, layout, panel, scratch + layout.coarse_at, kept, result);
  }
  unshear(tile, layout, result, out);
}

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
