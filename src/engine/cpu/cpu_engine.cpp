#include "engine/cpu/cpu_engine.hpp"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <tuple>

#include <opencv2/core.hpp>

#include "base/parallel.hpp"
#include "engine/filter_grid.hpp"

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace gyro_deblur {
namespace {

// Exact taps are cheap below this, and further down the interpolation between lanes and pixels shows: on single
// photographs 0.12 dB of restored quality at 34 px and 7 degrees, 0.08 dB at most from here on.
constexpr double kMinTwoScaleExtentPx = 36.0;
static_assert(kMinTwoScaleExtentPx >= kConstantRatioExtentPx, "shorter kernels have no jump to take out");
// Nearly along an axis the lanes lie between pixels over whole stretches of a line, where exact taps do not, and the
// interpolation shows up to longer extents.
constexpr double kMinTwoScaleExtentNearAxisPx = 57.0;
constexpr double kNearAxisSlope = 0.15;
// Still nearer to an axis and up to this extent, tiles are cut so short that lanes drift by no more than this between
// the middle row, where they lie on pixels, and the ends; 0.10 dB are lost at 58 px and 2 degrees without. But not
// shorter than this many rows: the neighbourhood that the kernel needs comes on top for every tile.
constexpr double kMaxShortTileExtentPx = 75.0;
constexpr double kMaxShortTileSlope = 0.08;
constexpr double kMaxLaneDriftPx = 0.2;
constexpr int kMinTileRows = 9;
// Up to this radius weights have 12 bits even where bytes are faster: short blur is restored so well (to 43 dB at 2 px)
// that the rounding to bytes shows, by up to 0.45 dB, against 0.07 dB at 5 px.
constexpr int kMaxFineRadius = 12;
// Box and smooth rest cancel each other from this gain (1 / gamma) down to one, so that their errors grow with it: 0.7
// grey levels at gamma = 0.01, 2 at 0.005, 38 at 0.001. Kernels of a smaller gamma are left to the reference engine.
constexpr double kMaxBoxGain = 128.0;
// Exact taps of longer kernels would need a neighbourhood beyond any cache.
constexpr int kMaxExactRadius = 128;
constexpr int kAlignFloats = 16;

bool exact_is_possible(const LineKernel& kernel, int depth) {
  return depth == CV_8U && kernel.radius() <= kMaxExactRadius;
}

/// std::lround, which is a call.
std::int32_t round_to_int(double x) { return static_cast<std::int32_t>(x < 0 ? x - 0.5 : x + 0.5); }

/// Two int16 in one int32.
std::int32_t pack_int16(std::int32_t low, std::int32_t high) {
  return static_cast<std::int32_t>((static_cast<std::uint32_t>(high) << 16) |
                                   (static_cast<std::uint32_t>(low) & 0xffffu));
}

}  // namespace

CpuEngine::CpuEngine(int threads, const BlockKernels& kernels)
    : threads_(threads), kernels_(kernels), float_(threads) {}

void CpuEngine::plan_block(const BlockFilter& block, int depth, Plan& plan) {
  plan.method = Method::COPY;
  plan.max_rows = kMaxTileSide;
  if (block.kernel == nullptr) return;
  const double dx = std::cos(block.angle_rad), dy = std::sin(block.angle_rad);
  plan.major_is_y = std::abs(dy) > std::abs(dx);
  const double major = plan.major_is_y ? dy : dx;
  plan.slope = (plan.major_is_y ? dx : dy) / major;
  const std::vector<float>& taps = block.kernel->taps;
  const bool is_zero = std::all_of(taps.begin(), taps.end(), [](float tap) { return tap == 0; });
  if (is_zero || block.kernel->box_height * block.kernel->box_extent_px > kMaxBoxGain) {
    plan.method = Method::FLOAT;
    return;
  }
  if (takes_two_scales(*block.kernel, plan.slope, depth)) {
    plan.max_rows = max_two_scale_rows(*block.kernel, plan.slope);
    plan_two_scale(*block.kernel, major, depth, plan);
  } else if (exact_is_possible(*block.kernel, depth)) {
    plan_exact(*block.kernel, block.angle_rad, plan);
  } else {
    plan.method = Method::FLOAT;
  }
}

bool CpuEngine::takes_two_scales(const LineKernel& kernel, double slope, int depth) {
  const bool near_axis = std::abs(slope) < kNearAxisSlope && exact_is_possible(kernel, depth);
  return kernel.box_extent_px >= (near_axis ? kMinTwoScaleExtentNearAxisPx : kMinTwoScaleExtentPx);
}

int CpuEngine::max_two_scale_rows(const LineKernel& kernel, double slope) {
  const double steepness = std::abs(slope);
  if (kernel.box_extent_px > kMaxShortTileExtentPx || steepness > kMaxShortTileSlope) return kMaxTileSide;
  // Also where the slope is 0.
  if (steepness * kMaxTileSide <= 2 * kMaxLaneDriftPx) return kMaxTileSide;
  return std::max(static_cast<int>(2 * kMaxLaneDriftPx / steepness), kMinTileRows);
}

void CpuEngine::plan_exact(const LineKernel& kernel, double angle_rad, Plan& plan) const {
  plan.method = Method::EXACT;
  const std::vector<KernelTap>& taps = plan.taps;
  rotate_kernel(kernel, angle_rad, plan.taps, plan.on_axis);
  float largest = 0;
  for (const KernelTap& tap : taps) largest = std::max(largest, std::abs(tap.weight));
  double sum = 0;
  for (const KernelTap& tap : taps) sum += tap.weight;
  // As large as there is room for, one unit left for errors of neighbours; and such that the sum, which decides the
  // brightness, is a whole number.
  const bool bytes = kernels_.has_byte_weights && kernel.radius() > kMaxFineRadius;
  const int max_weight = bytes ? kMaxByteWeight : kMaxPairWeight;
  double unit = (max_weight - 1) / std::max<double>(largest, std::numeric_limits<float>::min());
  if (std::abs(sum) * unit >= 1) unit = std::floor(std::abs(sum) * unit) / std::abs(sum);

  plan.pair_taps.clear();
  ExactFilter& filter = plan.exact;
  filter = {};
  filter.weights_are_bytes = bytes;
  filter.scale = static_cast<float>(1 / unit);
  filter.n_min = std::numeric_limits<int>::max();
  filter.n_max = std::numeric_limits<int>::min();
  const auto m_of = [&](const KernelTap& tap) { return plan.major_is_y ? tap.dy : tap.dx; };
  const auto n_of = [&](const KernelTap& tap) { return plan.major_is_y ? tap.dx : tap.dy; };
  // Rounding errors are passed on along the line, which is blurred in that direction and hardly sees their alternation:
  // that of a step's sum, and that of how it is shared between two neighbours.
  double sum_error = 0, share_error = 0;
  const auto round_with = [](double exact, double& error) {
    exact += error;
    const std::int32_t rounded = round_to_int(exact);
    error = exact - rounded;
    return rounded;
  };
  for (std::size_t i = 0; i < taps.size(); ++i) {
    // Convolution: output at p takes input at p - tap. Two neighbours across make one pair.
    const bool paired =
        i + 1 < taps.size() && m_of(taps[i + 1]) == m_of(taps[i]) && n_of(taps[i + 1]) == n_of(taps[i]) + 1;
    const double low = (paired ? taps[i + 1].weight : taps[i].weight) * unit;
    const double high = paired ? taps[i].weight * unit : 0.0;
    const std::int32_t both = round_with(low + high, sum_error);
    const std::int32_t fixed_low = paired ? round_with(low, share_error) : both;
    const PairTap pair{-m_of(taps[i]), -n_of(taps[i]) - (paired ? 1 : 0), pack_int16(fixed_low, both - fixed_low)};
    filter.radius_m = std::max(filter.radius_m, std::abs(pair.m));
    filter.n_min = std::min(filter.n_min, pair.n);
    filter.n_max = std::max(filter.n_max, pair.n);
    plan.pair_taps.push_back(pair);
    if (paired) ++i;
  }
  filter.taps = plan.pair_taps.data();
  filter.count = static_cast<int>(plan.pair_taps.size());
}

// Rounding errors are passed on to the next weight inwards: their sum over neighbours, which is what a blurred image
// sees, stays below one unit.
void CpuEngine::fix_coarse_weights(Plan& plan) {
  TwoScaleFilter& filter = plan.two_scale;
  const int radius = filter.coarse_radius;
  const std::vector<float>& weights = plan.weights.coarse;
  double size = 0, largest = 0;
  for (int k = 0; k <= radius; ++k) {
    size += (k == 0 ? 1 : 2) * std::abs(weights[k]);
    largest = std::max<double>(largest, std::abs(weights[k]));
  }
  // Sums of nodes are below 2^15 in size, results below 2^31, and weights below 2^15 even with a neighbour's error.
  constexpr int kMaxShift = 14;
  filter.coarse_shift = kMaxShift;
  while (filter.coarse_shift > 0 &&
         (size * (1 << filter.coarse_shift) > 65000.0 || largest * (1 << filter.coarse_shift) > 32000.0)) {
    --filter.coarse_shift;
  }

  plan.fixed_weights.assign(2 * radius + 1 + 8, 0);
  std::int32_t* fixed = plan.fixed_weights.data() + radius + 4;  // of node k at [k]
  const double unit = 1 << filter.coarse_shift;
  double error = 0, wanted = 0;
  for (int k = radius; k >= 0; --k) {
    const double exact = weights[k] * unit;
    fixed[k] = fixed[-k] = round_to_int(exact + (k == 0 ? 2 : 1) * error);
    error += exact - fixed[k];
    wanted += (k == 0 ? 1 : 2) * exact;
  }
  filter.coarse_sum = std::accumulate(plan.fixed_weights.begin(), plan.fixed_weights.end(), 0);
  // What is left of the sum decides the brightness.
  filter.inner_box +=
      static_cast<float>((wanted - filter.coarse_sum) / unit * filter.decimation / (2 * filter.box_half + 1));

  const int pairs = radius + 3;  // from pair -1
  plan.coarse_pairs.resize(2 * pairs);
  std::int32_t* even = plan.coarse_pairs.data() + 1;
  std::int32_t* odd = even + pairs;
  for (int i = -1; i <= radius + 1; ++i) {
    const std::int32_t* at = fixed - radius + 2 * i;
    even[i] = pack_int16(at[0], at[1]);
    odd[i] = pack_int16(at[-1], at[0]);
  }
  filter.coarse_even = even;
  filter.coarse_odd = odd;
}

// The kernel along the major axis jumps at the ends of its box and is smooth elsewhere: two boxes carry the jumps, and
// few coarse weights the rest.
void CpuEngine::plan_two_scale(const LineKernel& kernel, double major, int depth, Plan& plan) {
  plan.method = Method::TWO_SCALE;
  const double stretch = std::abs(major);  // steps of the major axis in one pixel of the line
  // A box that covers the samples -b .. b ends at b + 1 / 2: the box's end lies between those of the two boxes.
  const int box_half = static_cast<int>(std::floor((kernel.box_extent_px * stretch - 1) / 2));
  const int d = TwoScaleDesign::decimation_for(box_half);
  const int steps = static_cast<int>(std::ceil(kernel.radius() * stretch)), radius = (steps + d - 1) / d;
  const TwoScaleDesign& design = designs_.get(box_half, radius);

  plan.on_axis.resize(steps + kRowGroup);
  kernels_.resample_kernel(kernel.taps.data() + kernel.radius(), kernel.radius(), stretch, steps, plan.on_axis.data());
  design.fit(plan.on_axis.data(), steps, kernels_, plan.weights);
  plan.coarse.assign(2 * radius + 1 + 2 * kCoarseGuard, 0.0f);
  float* middle = plan.coarse.data() + kCoarseGuard + radius;
  for (int k = 0; k <= radius; ++k) middle[k] = middle[-k] = plan.weights.coarse[k];

  plan.two_scale = {};
  TwoScaleFilter& filter = plan.two_scale;
  filter.box_half = box_half;
  filter.inner_box = plan.weights.inner_box;
  filter.outer_box = plan.weights.outer_box;
  filter.coarse = plan.coarse.data() + kCoarseGuard;
  filter.coarse_radius = radius;
  filter.decimation = d;
  filter.max_value = depth == CV_8U ? 255.0f : 65535.0f;
  if (depth == CV_8U) fix_coarse_weights(plan);
}

template <typename Pixel>
void CpuEngine::run_tile(const SourcePlane<Pixel>& source, const Tile& tile, const Plan& plan, float* scratch,
                         Pixel* line_order) const {
  if constexpr (sizeof(Pixel) == 1) {
    if (plan.method == Method::EXACT) {
      kernels_.exact_u8(source, tile.geometry, plan.exact, scratch, line_order);
    } else {
      kernels_.two_scale_u8(source, tile.geometry, plan.two_scale, scratch, line_order);
    }
  } else {
    kernels_.two_scale_u16(source, tile.geometry, plan.two_scale, scratch, line_order);
  }
}

namespace {

/// Transposes 8x8 bytes.
void transpose_8x8(const std::uint8_t* from, std::ptrdiff_t from_stride, std::uint8_t* to, std::ptrdiff_t to_stride) {
#if defined(__SSE2__)
  const auto pair = [&](int row) {
    return _mm_unpacklo_epi8(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(from + row * from_stride)),
                             _mm_loadl_epi64(reinterpret_cast<const __m128i*>(from + (row + 1) * from_stride)));
  };
  const __m128i a = pair(0), b = pair(2), c = pair(4), d = pair(6);
  const __m128i ab_low = _mm_unpacklo_epi16(a, b), ab_high = _mm_unpackhi_epi16(a, b);
  const __m128i cd_low = _mm_unpacklo_epi16(c, d), cd_high = _mm_unpackhi_epi16(c, d);
  const __m128i columns[] = {_mm_unpacklo_epi32(ab_low, cd_low), _mm_unpackhi_epi32(ab_low, cd_low),
                             _mm_unpacklo_epi32(ab_high, cd_high), _mm_unpackhi_epi32(ab_high, cd_high)};
  for (int i = 0; i < 4; ++i) {
    _mm_storel_epi64(reinterpret_cast<__m128i*>(to + 2 * i * to_stride), columns[i]);
    _mm_storel_epi64(reinterpret_cast<__m128i*>(to + (2 * i + 1) * to_stride), _mm_srli_si128(columns[i], 8));
  }
#else
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 8; ++x) to[x * to_stride + y] = from[y * from_stride + x];
  }
#endif
}

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
      transpose_8x8(reinterpret_cast<const std::uint8_t*>(from + y * from_stride + x), from_stride,
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

/// The channel itself, with copies of its left and right edges in `edges`.
template <typename Pixel>
SourcePlane<Pixel> upright_plane(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& edges) {
  const std::ptrdiff_t stride = reserve_rows(channel.rows, 4 * pad, edges);
  const int cols = channel.cols, copied = std::min(pad, cols);
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int y = 0; y < channel.rows; ++y) {
    const Pixel *from = channel.ptr<Pixel>(y), first = from[0], last = from[cols - 1];
    Pixel* to = std::fill_n(edges.data() + y * stride, pad, first);
    to = std::fill_n(std::copy_n(from, copied, to), pad - copied, last);
    to = std::copy_n(from + cols - copied, copied, std::fill_n(to, pad - copied, first));
    std::fill_n(to, pad, last);
  }
  return {channel.ptr<Pixel>(),
          static_cast<std::ptrdiff_t>(channel.step1()),
          channel.rows,
          cols,
          edges.data() + pad,
          edges.data() + 3 * pad - cols,
          stride,
          pad};
}

/// Copies the transposed channel into `storage`, with its edges repeated.
template <typename Pixel>
SourcePlane<Pixel> transposed_plane(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& storage) {
  const std::ptrdiff_t stride = reserve_rows(channel.cols, channel.rows + 2 * pad, storage);
  constexpr int kBand = 64;  // columns of the channel that one thread transposes at a time
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int x = 0; x < channel.cols; x += kBand) {
    const int band = std::min(kBand, channel.cols - x);
    transpose(channel.ptr<Pixel>(0) + x, channel.step1(), channel.rows, band, storage.data() + x * stride + pad,
              stride);
    for (int i = x; i < x + band; ++i) {
      Pixel* row = storage.data() + i * stride;
      std::fill_n(row, pad, row[pad]);
      std::fill_n(row + pad + channel.rows, pad, row[pad + channel.rows - 1]);
    }
  }
  const Pixel* origin = storage.data() + pad;
  return {origin, stride, channel.cols, channel.rows, origin, origin, stride, pad};
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
void store_tile(const Pixel* line_order, const cv::Rect& tile, bool major_is_y, int channel, int channels,
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

/// Calls work(begin, length) for the fewest, equally long parts of [begin, end) that are no longer than `longest`.
template <typename Work>
void for_each_part(int begin, int end, int longest, const Work& work) {
  const int parts = (end - begin + longest - 1) / longest;
  for (int i = 0; i < parts; ++i) {
    const int from = begin + (end - begin) * i / parts, to = begin + (end - begin) * (i + 1) / parts;
    work(from, to - from);
  }
}

}  // namespace

template <typename Pixel>
void CpuEngine::filter_as(const cv::Mat& src, const FilterGrid& grid, Buffers<Pixel>& buffers, cv::Mat& dst) {
  const int threads = threads_ > 0 ? threads_ : omp_get_max_threads();
  const int count = static_cast<int>(grid.blocks.size());
  plans_.resize(std::max(plans_.size(), grid.blocks.size()));
  constexpr int kBlocksAtATime = 8;
  run_parallel(count, threads, kBlocksAtATime, [&](int i) { plan_block(grid.blocks[i], src.depth(), plans_[i]); });
  seams_.plan(grid, src.type());

  tiles_.clear();
  left_to_float_.clear();
  bool need_upright = false, need_transposed = false;
  TileNeeds needs{};
  for (int i = 0; i < count; ++i) {
    const Plan& plan = plans_[i];
    if (plan.method == Method::COPY) src(grid.rect(i)).copyTo(dst(grid.rect(i)));
    if (plan.method == Method::FLOAT) left_to_float_.push_back(i);
    if (plan.method != Method::EXACT && plan.method != Method::TWO_SCALE) continue;
    const cv::Rect reach = seams_.reach(i);
    const int max_height = plan.major_is_y ? plan.max_rows : kMaxTileSide;
    const int max_width = plan.major_is_y ? kMaxTileSide : plan.max_rows;
    for_each_part(reach.y, reach.br().y, max_height, [&](int y, int height) {
      for_each_part(reach.x, reach.br().x, max_width, [&](int x, int width) {
        Tile tile{{}, {x, y, width, height}, i};
        tile.geometry = plan.major_is_y ? TileGeometry{y, height, x, width, plan.slope}
                                        : TileGeometry{x, width, y, height, plan.slope};
        const auto two_scale_needs = sizeof(Pixel) == 1 ? kernels_.two_scale_u8_needs : kernels_.two_scale_u16_needs;
        const TileNeeds of_tile = plan.method == Method::EXACT ? kernels_.exact_needs(tile.geometry, plan.exact)
                                                               : two_scale_needs(tile.geometry, plan.two_scale);
        needs.scratch_floats = std::max(needs.scratch_floats, of_tile.scratch_floats);
        needs.columns = std::max(needs.columns, of_tile.columns);
        tiles_.push_back(tile);
      });
    });
    (plan.major_is_y ? need_upright : need_transposed) = true;
  }

  // Tiles that follow each other along m read nearly the same rows, which are then still in the second-level cache.
  std::sort(tiles_.begin(), tiles_.end(), [&](const Tile& a, const Tile& b) {
    const auto key = [&](const Tile& tile) {
      return std::make_tuple(plans_[tile.block].major_is_y, tile.geometry.n_begin, tile.geometry.m_begin);
    };
    return key(a) < key(b);
  });

  float_.filter_blocks(src, grid, left_to_float_, seams_, dst);

  scratch_.resize(threads);
  for (std::vector<float>& scratch : scratch_) {
    scratch.resize(std::max(scratch.size(), needs.scratch_floats + kAlignFloats));
  }
  const int channels = tiles_.empty() ? 0 : src.channels();
  for (int channel = 0; channel < channels; ++channel) {
    cv::Mat plane = src;
    if (channels > 1) {
      cv::extractChannel(src, channel_, channel);
      plane = channel_;
    }
    SourcePlane<Pixel> upright{}, transposed{};
    if (need_upright) upright = upright_plane(plane, needs.columns, threads, buffers.edges);
    if (need_transposed) transposed = transposed_plane(plane, needs.columns, threads, buffers.transposed);
    const int tile_count = static_cast<int>(tiles_.size());
#pragma omp parallel for num_threads(threads) schedule(dynamic, 8)
    for (int i = 0; i < tile_count; ++i) {
      const Tile& tile = tiles_[i];
      const Plan& plan = plans_[tile.block];
      alignas(64) Pixel line_order[kMaxTileSide * kTileStride];
      float* scratch = scratch_[omp_get_thread_num()].data();
      const std::uintptr_t past_line = reinterpret_cast<std::uintptr_t>(scratch) % 64;
      if (past_line != 0) scratch += (64 - past_line) / sizeof(float);
      run_tile(plan.major_is_y ? upright : transposed, tile, plan, scratch, line_order);
      for (const SeamBlender::Part<Pixel>& part : seams_.parts<Pixel>(tile.block, dst)) {
        store_tile(line_order, tile.rect, plan.major_is_y, channel, channels, part);
      }
    }
  }
  seams_.blend(src, threads, dst);
}

void CpuEngine::filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  require_filterable(src, grid);
  dst.create(src.size(), src.type());
  if (src.depth() == CV_8U) {
    filter_as(src, grid, buffers8_, dst);
  } else {
    filter_as(src, grid, buffers16_, dst);
  }
}

}  // namespace gyro_deblur
