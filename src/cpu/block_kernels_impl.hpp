// Body of the inner loops, included by one source file per instruction set, each of which is compiled with its own
// flags and defines GYRO_DEBLUR_ISA (a namespace) and GYRO_DEBLUR_VECTOR_BYTES. Everything here has internal linkage
// and nothing comes from the standard library's templates: a shared inline function compiled for AVX-512 could
// otherwise be the copy that the linker keeps for every processor.
#include <cstring>

#include "cpu/block_kernels.hpp"

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

constexpr int kLanes = GYRO_DEBLUR_VECTOR_BYTES / 4;

typedef float Vector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));
typedef std::int32_t IntVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));

inline Vector load(const float* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline void store(float* to, Vector v) { std::memcpy(to, &v, sizeof v); }
inline IntVector load(const std::int32_t* from) {
  IntVector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

inline int round_up(int n, int step) { return (n + step - 1) / step * step; }
inline int clamp_row(int row, int rows) { return row < 0 ? 0 : (row >= rows ? rows - 1 : row); }
inline int floor_to_int(double x) {
  const int i = static_cast<int>(x);
  return x < i ? i - 1 : i;
}

/// kLanes pixels as floats.
inline Vector load_pixels(const std::uint8_t* from) {
#if defined(__AVX512F__)
  return (Vector)_mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)from)));
#elif defined(__AVX2__)
  return (Vector)_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)from)));
#else
  Vector v;
  for (int i = 0; i < kLanes; ++i) v[i] = from[i];
  return v;
#endif
}
inline Vector load_pixels(const std::uint16_t* from) {
#if defined(__AVX512F__)
  return (Vector)_mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i*)from)));
#elif defined(__AVX2__)
  return (Vector)_mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i*)from)));
#else
  Vector v;
  for (int i = 0; i < kLanes; ++i) v[i] = from[i];
  return v;
#endif
}

/// Rounds and clips to [0, max_value].
template <typename Pixel>
inline void store_pixels(Pixel* to, Vector v, float max_value) {
  Vector zero = {}, top = zero + max_value;
  v = v + 0.5f;
  v = v > zero ? v : zero;
  v = v < top ? v : top;
#if defined(__AVX512F__)
  const __m512i i = _mm512_cvttps_epi32((__m512)v);
  if (sizeof(Pixel) == 1) {
    _mm_storeu_si128((__m128i*)to, _mm512_cvtepi32_epi8(i));
  } else {
    _mm256_storeu_si256((__m256i*)to, _mm512_cvtepi32_epi16(i));
  }
#else
  const IntVector i = __builtin_convertvector(v, IntVector);
  for (int k = 0; k < kLanes; ++k) to[k] = static_cast<Pixel>(i[k]);
#endif
}

/// Catmull-Rom weights of the four samples around a position `t` past the second.
struct CubicWeights {
  float w[4];
  explicit CubicWeights(double t) {
    w[0] = static_cast<float>((-t + 2 * t * t - t * t * t) / 2);
    w[1] = static_cast<float>((2 - 5 * t * t + 3 * t * t * t) / 2);
    w[2] = static_cast<float>((t + 4 * t * t - 3 * t * t * t) / 2);
    w[3] = static_cast<float>((-t * t + t * t * t) / 2);
  }
};

// ---- Exact taps
// -----------------------------------------------------------------------------------------------------

// Outputs that are summed together: enough independent sums to hide the latency of a multiply-add.
constexpr int kExactRows = 2;
constexpr int kExactVectors = GYRO_DEBLUR_VECTOR_BYTES == 64 ? 4 : 2;

struct ExactLayout {
  int rows, width, first_m, first_n;
  ExactLayout(const TileGeometry& tile, const ExactFilter& filter)
      : rows(tile.m_count + 2 * filter.radius_m + 1),
        // Whole vectors are read for the last outputs.
        width(round_up(round_up(tile.n_count, kExactVectors * kLanes) + filter.n_max - filter.n_min, kLanes) + kLanes),
        first_m(tile.m_begin - filter.radius_m),
        first_n(tile.n_begin + filter.n_min) {}
};

/// Rounds, clips and stores a vector of scaled sums.
inline void store_exact(std::uint8_t* to, IntVector sum, const ExactFilter& filter) {
  const IntVector zero = {}, top = zero + 255;
  sum = (sum + (filter.shift > 0 ? 1 << (filter.shift - 1) : 0)) >> filter.shift;
  sum = sum > zero ? sum : zero;
  sum = sum < top ? sum : top;
#if defined(__AVX512F__)
  _mm_storeu_si128((__m128i*)to, _mm512_cvtepi32_epi8((__m512i)sum));
#else
  for (int k = 0; k < kLanes; ++k) to[k] = static_cast<std::uint8_t>(sum[k]);
#endif
}

/// Walks over the tile's outputs, kExactRows by kExactVectors, and lets sum(at, vectors, sums) fill the sums for the
/// outputs whose first one is at offset `at` of the neighbourhood.
template <typename Sum>
inline void for_exact_outputs(const TileGeometry& tile, const ExactFilter& filter, const ExactLayout& layout,
                              std::uint8_t* out, Sum sum) {
  for (int m = 0; m < tile.m_count; m += kExactRows) {
    for (int n = 0; n < tile.n_count; n += kExactVectors * kLanes) {
      IntVector sums[kExactRows][kExactVectors];
      sum((m + filter.radius_m) * layout.width + n - filter.n_min, sums);
      for (int row = 0; row < kExactRows && m + row < tile.m_count; ++row) {
        for (int v = 0; v < kExactVectors && n + v * kLanes < tile.n_count; ++v) {
          store_exact(out + (m + row) * kMaxTileSide + n + v * kLanes, sums[row][v], filter);
        }
      }
    }
  }
}

#if defined(__AVX512VNNI__)

// Two steps of the line at once: bytes (m, n), (m, n + 1), (m + 1, n'), (m + 1, n' + 1), where n' - n is 0 or the sign
// of the slope. Half the loads of pairs, which is what limits those; weights are split in two so that they fit bytes.
struct Quad {
  int at;                  // first byte's place in the neighbourhood, relative to the output
  int side;                // which of the two arrangements
  std::int32_t high, low;  // weights / 128 and the rest, a byte each
};

struct QuadLayout {
  int size;  // of one array
  explicit QuadLayout(const ExactLayout& layout) : size(layout.rows * layout.width + kLanes) {}
};

std::size_t exact_scratch_floats(const TileGeometry& tile, const ExactFilter& filter) {
  const ExactLayout layout(tile, filter);
  return static_cast<std::size_t>(3 * QuadLayout(layout).size) +
         static_cast<std::size_t>(filter.count) * sizeof(Quad) / sizeof(float);
}

inline std::int32_t pack_bytes(std::int32_t a, std::int32_t b, std::int32_t c, std::int32_t d) {
  return (a & 0xff) | (b & 0xff) << 8 | (c & 0xff) << 16 | static_cast<std::int32_t>((d & 0xffu) << 24);
}

void exact_u8(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const ExactFilter& filter,
              float* scratch, std::uint8_t* out) {
  const ExactLayout layout(tile, filter);
  const int size = QuadLayout(layout).size;
  const int lean = tile.slope < 0 ? -1 : 1;

  std::int32_t* pairs = reinterpret_cast<std::int32_t*>(scratch);
  for (int r = 0; r < layout.rows; ++r) {
    const std::uint8_t* from =
        source.origin + clamp_row(layout.first_m + r, source.rows) * source.stride + layout.first_n;
    for (int i = 0; i < layout.width; i += kLanes) {
      const __m512i first = _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)(from + i)));
      const __m512i second = _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)(from + i + 1)));
      _mm512_storeu_si512(pairs + r * layout.width + i, _mm512_or_si512(first, _mm512_slli_epi32(second, 8)));
    }
  }
  // The vector after the last row and before the first is read for the leaning arrangement, but no output uses it.
  std::int32_t* quads[2] = {pairs + size, pairs + 2 * size};
  const int last = (layout.rows - 1) * layout.width;
  for (int i = 0; i < last; i += kLanes) {
    const __m512i here = _mm512_loadu_si512(pairs + i);
    const __m512i straight = _mm512_loadu_si512(pairs + i + layout.width);
    const __m512i leaning = _mm512_loadu_si512(pairs + i + layout.width + lean);
    _mm512_storeu_si512(quads[0] + i, _mm512_or_si512(here, _mm512_slli_epi32(straight, 16)));
    _mm512_storeu_si512(quads[1] + i, _mm512_or_si512(here, _mm512_slli_epi32(leaning, 16)));
  }

  Quad* list = reinterpret_cast<Quad*>(scratch + 3 * size);
  int count = 0;
  const auto low_half = [](std::int32_t weights) {
    return static_cast<std::int32_t>(static_cast<std::uint32_t>(weights) << 16) >> 16;
  };
  for (int t = 0; t < filter.count; ++t) {
    const PairTap& tap = filter.taps[t];
    std::int32_t w[4] = {low_half(tap.weights), tap.weights >> 16, 0, 0};
    Quad quad{tap.m * layout.width + tap.n, 0, 0, 0};
    if (t + 1 < filter.count) {
      const PairTap& next = filter.taps[t + 1];
      // Taps come in falling or rising order of m; the quad starts at the lower.
      const PairTap& lower = next.m < tap.m ? next : tap;
      const PairTap& upper = next.m < tap.m ? tap : next;
      const int step = upper.n - lower.n;
      if (upper.m == lower.m + 1 && (step == 0 || step == lean)) {
        quad.at = lower.m * layout.width + lower.n;
        quad.side = step == 0 ? 0 : 1;
        w[0] = low_half(lower.weights);
        w[1] = lower.weights >> 16;
        w[2] = low_half(upper.weights);
        w[3] = upper.weights >> 16;
        ++t;
      }
    }
    quad.high = pack_bytes(w[0] >> 7, w[1] >> 7, w[2] >> 7, w[3] >> 7);
    quad.low = pack_bytes(w[0] & 127, w[1] & 127, w[2] & 127, w[3] & 127);
    list[count++] = quad;
  }

  for_exact_outputs(tile, filter, layout, out, [&](int at, IntVector sums[kExactRows][kExactVectors]) {
    __m512i high[kExactRows][kExactVectors] = {}, low[kExactRows][kExactVectors] = {};
    for (int q = 0; q < count; ++q) {
      const std::int32_t* from = quads[list[q].side] + at + list[q].at;
      const __m512i high_weights = _mm512_set1_epi32(list[q].high), low_weights = _mm512_set1_epi32(list[q].low);
      for (int row = 0; row < kExactRows; ++row) {
        for (int v = 0; v < kExactVectors; ++v) {
          const __m512i pixels = _mm512_loadu_si512(from + row * layout.width + v * kLanes);
          high[row][v] = _mm512_dpbusd_epi32(high[row][v], pixels, high_weights);
          low[row][v] = _mm512_dpbusd_epi32(low[row][v], pixels, low_weights);
        }
      }
    }
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kExactVectors; ++v) {
        sums[row][v] = (IntVector)_mm512_add_epi32(_mm512_slli_epi32(high[row][v], 7), low[row][v]);
      }
    }
  });
}

#else

/// acc + low * low + high * high of the int16 halves of each lane.
inline IntVector multiply_pairs(IntVector acc, IntVector pixels, IntVector weights) {
#if defined(__AVX2__)
  return acc + (IntVector)_mm256_madd_epi16((__m256i)pixels, (__m256i)weights);
#elif defined(__SSE2__)
  return acc + (IntVector)_mm_madd_epi16((__m128i)pixels, (__m128i)weights);
#else
  const IntVector low = (weights << 16) >> 16, high = weights >> 16;
  return acc + (pixels & 0xffff) * low + (pixels >> 16) * high;
#endif
}

std::size_t exact_scratch_floats(const TileGeometry& tile, const ExactFilter& filter) {
  const ExactLayout layout(tile, filter);
  return static_cast<std::size_t>(layout.rows) * layout.width;
}

void exact_u8(const SourcePlane<std::uint8_t>& source, const TileGeometry& tile, const ExactFilter& filter,
              float* scratch, std::uint8_t* out) {
  const ExactLayout layout(tile, filter);
  std::int32_t* pairs = reinterpret_cast<std::int32_t*>(scratch);
  for (int r = 0; r < layout.rows; ++r) {
    const std::uint8_t* from =
        source.origin + clamp_row(layout.first_m + r, source.rows) * source.stride + layout.first_n;
    std::int32_t* to = pairs + r * layout.width;
    for (int i = 0; i < layout.width; ++i) to[i] = from[i] | (from[i + 1] << 16);
  }
  for_exact_outputs(tile, filter, layout, out, [&](int at, IntVector sums[kExactRows][kExactVectors]) {
    IntVector acc[kExactRows][kExactVectors] = {};
    for (int t = 0; t < filter.count; ++t) {
      const PairTap& tap = filter.taps[t];
      const std::int32_t* from = pairs + at + tap.m * layout.width + tap.n;
      const IntVector weights = IntVector{} + tap.weights;
      for (int row = 0; row < kExactRows; ++row) {
        for (int v = 0; v < kExactVectors; ++v) {
          acc[row][v] = multiply_pairs(acc[row][v], load(from + row * layout.width + v * kLanes), weights);
        }
      }
    }
    for (int row = 0; row < kExactRows; ++row) {
      for (int v = 0; v < kExactVectors; ++v) sums[row][v] = acc[row][v];
    }
  });
}

#endif

// ---- Two scales
// -----------------------------------------------------------------------------------------------------

// Vectors of lanes and coarse outputs that are summed together: 8 independent sums hide the latency of an FMA.
constexpr int kLaneVectors = 2;
constexpr int kCacheLineBytes = 64;
constexpr int kCoarseOutputs = kCoarseGuard + 1;
// Vectors that a row of outputs takes on the lanes: three more than its pixels, from the last whole vector before.
constexpr int kRowVectors = (kMaxTileSide + 3 + kLanes - 1 + kLanes - 1) / kLanes;

/// Where things are in scratch. Lane v of row m holds the image at n = first_lane + v + slope (m - center).
struct TwoScaleLayout {
  double center;          // m at which lanes are at integer n
  int first_lane, lanes;  // lanes: a multiple of kLanes
  int coarse_outputs;     // nodes at which the smooth part is evaluated
  int first_node;         // node j sums m_begin + [j d, (j + 1) d)
  int nodes;
  int prefix_first, prefix_rows;                                         // running sums kept, relative to m_begin
  int rows_at, parts_at, prefix_at, nodes_at, coarse_at, row_at, total;  // in floats

  TwoScaleLayout(const TileGeometry& tile, const TwoScaleFilter& filter) {
    const int d = filter.decimation;
    center = tile.m_begin + (tile.m_count - 1) / 2.0;
    const double lean = (tile.slope < 0 ? -tile.slope : tile.slope) * (tile.m_count - 1) / 2.0;
    first_lane = floor_to_int(tile.n_begin - lean) - 2;  // one for the cubic, one for rounding
    const int last_lane = floor_to_int(tile.n_begin + tile.n_count - 1 + lean) + 3;
    lanes = round_up(last_lane - first_lane + 1, kLanes);
    // Outputs lie between nodes first_output + 1 and first_output + coarse_outputs - 2 for the cubic.
    first_output = -2;
    coarse_outputs =
        round_up(floor_to_int((tile.m_count - 1 - (d - 1) / 2.0) / d) + 2 - first_output + 1, kCoarseOutputs);
    first_node = first_output - filter.coarse_radius;
    nodes = coarse_outputs + 2 * filter.coarse_radius;
    prefix_first = -filter.edge_reach;
    prefix_rows = tile.m_count + 2 * filter.edge_reach;
    rows_at = 0;
    parts_at = rows_at + nodes * d * static_cast<int>(sizeof(std::ptrdiff_t) / sizeof(float));
    prefix_at = round_up(parts_at + nodes * d, kLanes);
    nodes_at = prefix_at + prefix_rows * lanes;
    coarse_at = nodes_at + nodes * lanes;
    row_at = coarse_at + coarse_outputs * lanes;
    total = row_at + 2 * kRowVectors * kLanes;
  }
  int first_output;
};

std::size_t two_scale_scratch_floats(const TileGeometry& tile, const TwoScaleFilter& filter) {
  return static_cast<std::size_t>(TwoScaleLayout(tile, filter).total);
}

/// Sums samples [begin, end) of the lanes, `part` of the way between pixels, into `sum`; and keeps running sums at
/// `kept`, a row of `lanes` each, when kKeep.
template <typename Pixel, int kVectors, bool kKeep>
inline void sum_samples(const Pixel* origin, const std::ptrdiff_t* rows, const float* parts, int begin, int end,
                        int lanes, Vector* sum, Vector* running, float* kept) {
  for (int i = begin; i < end; ++i) {
    const Pixel* from = origin + rows[i];
    const float part = parts[i];
    for (int v = 0; v < kVectors; ++v) {
      const Vector below = load_pixels(from + v * kLanes);
      const Vector above = load_pixels(from + v * kLanes + 1);
      const Vector sample = below + part * (above - below);
      sum[v] += sample;
      if (kKeep) {
        running[v] += sample;
        store(kept + v * kLanes, running[v]);
      }
    }
    if (kKeep) kept += lanes;
  }
}

template <typename Pixel, int kVectors>
inline void shear_lanes(const SourcePlane<Pixel>& source, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                        int lane, float* scratch) {
  const int d = filter.decimation, lanes = layout.lanes;
  const std::ptrdiff_t* rows = reinterpret_cast<const std::ptrdiff_t*>(scratch + layout.rows_at);
  const float* parts = scratch + layout.parts_at;
  const Pixel* origin = source.origin + lane;
  // Samples whose running sums are kept.
  const int keep_begin = layout.prefix_first - layout.first_node * d, keep_end = keep_begin + layout.prefix_rows;
  float* kept = scratch + layout.prefix_at + lane;
  Vector running[kVectors] = {};
  for (int j = 0; j < layout.nodes; ++j) {
    const int begin = j * d, end = begin + d;
    Vector sum[kVectors] = {};
    if (end <= keep_begin || begin >= keep_end) {
      sum_samples<Pixel, kVectors, false>(origin, rows, parts, begin, end, lanes, sum, running, kept);
    } else {
      const int from = begin < keep_begin ? keep_begin : begin, to = end > keep_end ? keep_end : end;
      sum_samples<Pixel, kVectors, false>(origin, rows, parts, begin, from, lanes, sum, running, kept);
      sum_samples<Pixel, kVectors, true>(origin, rows, parts, from, to, lanes, sum, running, kept);
      sum_samples<Pixel, kVectors, false>(origin, rows, parts, to, end, lanes, sum, running, kept);
      kept += static_cast<std::ptrdiff_t>(to - from) * lanes;
    }
    for (int v = 0; v < kVectors; ++v) store(scratch + layout.nodes_at + j * lanes + lane + v * kLanes, sum[v]);
  }
}

/// Resamples the neighbourhood into lanes (linear across the line) and accumulates sums over nodes and running sums.
template <typename Pixel>
inline void shear(const SourcePlane<Pixel>& source, const TileGeometry& tile, const TwoScaleFilter& filter,
                  const TwoScaleLayout& layout, float* scratch) {
  std::ptrdiff_t* rows = reinterpret_cast<std::ptrdiff_t*>(scratch + layout.rows_at);
  float* parts = scratch + layout.parts_at;
  const int samples = layout.nodes * filter.decimation;
  const int first_m = tile.m_begin + layout.first_node * filter.decimation;
  for (int i = 0; i < samples; ++i) {
    const double across = tile.slope * (first_m + i - layout.center);
    const int whole = floor_to_int(across);
    parts[i] = static_cast<float>(across - whole);
    rows[i] = clamp_row(first_m + i, source.rows) * source.stride + layout.first_lane + whole;
    // The neighbourhood of a tile is a thousand cache lines that no hardware prefetcher foresees.
    const char* begin = reinterpret_cast<const char*>(source.origin + rows[i]);
    const char* end = begin + (layout.lanes + 1) * static_cast<int>(sizeof(Pixel));
    for (const char* line = begin; line < end; line += kCacheLineBytes) __builtin_prefetch(line);
    __builtin_prefetch(end - 1);
  }
  int lane = 0;
  for (; lane + kLaneVectors * kLanes <= layout.lanes; lane += kLaneVectors * kLanes) {
    shear_lanes<Pixel, kLaneVectors>(source, filter, layout, lane, scratch);
  }
  for (; lane < layout.lanes; lane += kLanes) shear_lanes<Pixel, 1>(source, filter, layout, lane, scratch);
}

template <int kVectors>
inline void filter_coarse_lanes(const TwoScaleFilter& filter, const TwoScaleLayout& layout, int lane, float* scratch) {
  const int taps = 2 * filter.coarse_radius + 1, lanes = layout.lanes;
  // Weights have kCoarseGuard zeros on either side, so that every output sees every node of the span.
  const float* weights = filter.coarse;
  for (int j = 0; j < layout.coarse_outputs; j += kCoarseOutputs) {
    Vector acc[kCoarseOutputs][kVectors] = {};
    const float* from = scratch + layout.nodes_at + j * lanes + lane;
    for (int k = 0; k < taps + kCoarseOutputs - 1; ++k, from += lanes) {
      for (int v = 0; v < kVectors; ++v) {
        const Vector node = load(from + v * kLanes);
        for (int o = 0; o < kCoarseOutputs; ++o) acc[o][v] += weights[k - o] * node;
      }
    }
    float* to = scratch + layout.coarse_at + j * lanes + lane;
    for (int o = 0; o < kCoarseOutputs; ++o) {
      for (int v = 0; v < kVectors; ++v) store(to + o * lanes + v * kLanes, acc[o][v]);
    }
  }
}

/// Filters the sums over nodes with the coarse weights.
inline void filter_coarse(const TwoScaleFilter& filter, const TwoScaleLayout& layout, float* scratch) {
  int lane = 0;
  for (; lane + kLaneVectors * kLanes <= layout.lanes; lane += kLaneVectors * kLanes) {
    filter_coarse_lanes<kLaneVectors>(filter, layout, lane, scratch);
  }
  for (; lane < layout.lanes; lane += kLanes) filter_coarse_lanes<1>(filter, layout, lane, scratch);
}

/// Adds the parts up at every output's lane and resamples the lanes to pixels.
template <typename Pixel>
inline void unshear(const TileGeometry& tile, const TwoScaleFilter& filter, const TwoScaleLayout& layout,
                    float* scratch, Pixel* out) {
  const int d = filter.decimation, lanes = layout.lanes;
  float* row = scratch + layout.row_at;
  for (int m = 0; m < tile.m_count; ++m) {
    const double node = (m - (d - 1) / 2.0) / d;
    const int node_below = floor_to_int(node);
    const CubicWeights along(node - node_below);

    const double lane = tile.n_begin - tile.slope * (tile.m_begin + m - layout.center) - layout.first_lane;
    const int lane_below = floor_to_int(lane);
    const CubicWeights across(lane - lane_below);
    const int skipped = (lane_below - 1) % kLanes, first = lane_below - 1 - skipped;

    // All vectors of the row at once, aligned: a weight is spread once, and the sums do not wait for each other. What
    // is read past the lanes is not used.
    Vector sums[kRowVectors] = {};
    const float* coarse = scratch + layout.coarse_at + (node_below - 1 - layout.first_output) * lanes + first;
    for (int q = 0; q < 4; ++q, coarse += lanes) {
      for (int v = 0; v < kRowVectors; ++v) sums[v] += along.w[q] * load(coarse + v * kLanes);
    }
    const float* prefix = scratch + layout.prefix_at + (m - layout.prefix_first) * lanes + first;
    for (int e = 0; e < filter.edge_count; ++e) {
      const float* from = prefix + filter.edge_offsets[e] * lanes;
      const float weight = filter.edge_weights[e];
      for (int v = 0; v < kRowVectors; ++v) sums[v] += weight * load(from + v * kLanes);
    }
    for (int v = 0; v < kRowVectors; ++v) store(row + v * kLanes, sums[v]);
    for (int n = 0; n < tile.n_count; n += kLanes) {
      Vector sum = across.w[0] * load(row + skipped + n);
      for (int q = 1; q < 4; ++q) sum += across.w[q] * load(row + skipped + n + q);
      store_pixels(out + m * kMaxTileSide + n, sum, filter.max_value);
    }
  }
}

template <typename Pixel>
void two_scale(const SourcePlane<Pixel>& source, const TileGeometry& tile, const TwoScaleFilter& filter, float* scratch,
               Pixel* out) {
  const TwoScaleLayout layout(tile, filter);
  shear(source, tile, filter, layout, scratch);
  filter_coarse(filter, layout, scratch);
  unshear(tile, filter, layout, scratch, out);
}

}  // namespace

extern const BlockKernels kKernels;
const BlockKernels kKernels = {
    GYRO_DEBLUR_ISA_NAME,    kLanes, exact_scratch_floats, exact_u8, two_scale_scratch_floats, two_scale<std::uint8_t>,
    two_scale<std::uint16_t>};

}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
