// Where the inner loops of two scales find what they work on, once per instruction set (see base/vectors_impl.hpp).
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
/// (of 2) of part h of a group is at h * kLanes + p * kGroup / 2. All is computed for kPanel columns, or what is left
/// of them, before the next: their samples and nodes stay in the first-level cache.
template <typename Pixel>
struct ColumnFormat {
  using Sample = float;
  using Result = float;
  static constexpr int kGroup = 2 * kLanes;
  static constexpr int kPanel = 32;
  static constexpr float kSampleScale = 1, kResultScale = 1;  // units in one grey level
  static Vector load_sample(const float* from) { return load(from); }
  static Vector sum_samples(const float* from, int rows) {
    Vector sum = {};
    for (int i = 0; i < rows; ++i, from += kPanel) sum += load(from);
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

/// Where things are in scratch. Column v of row m holds the image at n = first_column + v + slope (m - center). Rows of
/// samples, nodes and coarse outputs have the columns of a panel, those of results all columns.
struct TwoScaleLayout {
  // m at which columns are at integer n: an integer, so that a slope of 1 needs no interpolation anywhere.
  int center;
  int first_column, columns;  // columns: whole groups
  int coarse_outputs;         // nodes at which the smooth part is evaluated, from node -1
  int first_node;             // node j sums m_begin + [j d, (j + 1) d)
  int nodes;
  int kept_first, kept_rows;                                     // samples kept, relative to m_begin
  int parts_at, kept_at, nodes_at, coarse_at, result_at, total;  // in floats; pixels of SampleRows are at 0

  TwoScaleLayout(const TileGeometry& tile, const TwoScaleFilter& filter, int group, int panel, int sample_bytes) {
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
    const int floats_of_kept = round_up(kept_rows * panel * sample_bytes, kCacheLineBytes) / 4;
    parts_at = nodes * d * static_cast<int>(sizeof(void*) / sizeof(float));
    kept_at = round_up(parts_at + nodes * d, kCacheLineBytes / 4);
    nodes_at = kept_at + floats_of_kept;
    coarse_at = nodes_at + nodes * panel;
    result_at = coarse_at + coarse_outputs * panel;
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
    using Format = ColumnFormat<Pixel>;
    return TwoScaleLayout(tile, filter, Format::kGroup, Format::kPanel, sizeof(typename Format::Sample));
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

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
