#include "cpu/cpu_convolver.hpp"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numeric>
#include <stdexcept>

#include <opencv2/core.hpp>

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace gyro_deblur {
namespace {

// Below this the interpolation between lanes and pixels shows (against exact taps 47 dB at 30 px, less below), and
// exact taps are cheap.
constexpr double kMinTwoScaleExtentPx = 30.0;
// Box and smooth rest cancel each other from this gain (1 / gamma) down to one, so that their errors grow with it: 0.7
// grey levels at gamma = 0.01, 2 at 0.005, 38 at 0.001. Kernels of a smaller gamma are left to the reference engine.
constexpr double kMaxBoxGain = 128.0;
// Exact taps of longer kernels would need a neighbourhood beyond any cache.
constexpr int kMaxExactRadius = 128;
// Samples of the smooth part in one extent of the box. It falls as |H|^3, so that few do: at 1 grey level of noise 24
// leave an error of 52 dB, 16 of 46 dB. Below 48 px the lanes cost as much again, and every sample is used.
constexpr double kCoarseSamplesPerExtent = 20.0;
constexpr double kMinCoarseExtentPx = 48.0;
// Samples on either side of the box's ends that are corrected: the splat onto the unit grid and the box's fractional
// edge reach 1.5 px.
constexpr int kEdgeReach = 2;
constexpr int kAlignFloats = 16;

}  // namespace

CpuConvolver::CpuConvolver(int threads, const BlockKernels& kernels)
    : threads_(threads), kernels_(kernels), reference_(threads) {}

void CpuConvolver::plan_block(const BlockFilter& block, int depth, Plan& plan) const {
  plan.method = Method::COPY;
  if (block.kernel == nullptr) return;
  const double dx = std::cos(block.angle_rad), dy = std::sin(block.angle_rad);
  plan.major_is_y = std::abs(dy) > std::abs(dx);
  const double major = plan.major_is_y ? dy : dx;
  plan.slope = (plan.major_is_y ? dx : dy) / major;
  if (block.kernel->box_height * block.kernel->box_extent_px > kMaxBoxGain) {
    plan.method = Method::REFERENCE;
  } else if (block.kernel->box_extent_px >= kMinTwoScaleExtentPx) {
    plan_two_scale(*block.kernel, major, depth, plan);
  } else if (depth == CV_8U && block.kernel->radius() <= kMaxExactRadius) {
    plan_exact(*block.kernel, block.angle_rad, plan);
  } else {
    plan.method = Method::REFERENCE;
  }
}

void CpuConvolver::plan_exact(const LineKernel& kernel, double angle_rad, Plan& plan) const {
  plan.method = Method::EXACT;
  const std::vector<KernelTap> taps = rotate_kernel(kernel, angle_rad);
  float largest = 0;
  for (const KernelTap& tap : taps) largest = std::max(largest, std::abs(tap.weight));
  // As many bits as there is room for.
  constexpr int kMaxShift = 14;
  int shift = kMaxShift;
  while (shift > 0 && largest * (1 << shift) > kMaxExactWeight - 1) --shift;

  std::vector<std::int32_t> weights(taps.size());
  double sum = 0;
  std::int32_t fixed_sum = 0;
  std::size_t strongest = 0;
  for (std::size_t i = 0; i < taps.size(); ++i) {
    weights[i] = static_cast<std::int32_t>(std::lround(taps[i].weight * (1 << shift)));
    sum += taps[i].weight;
    fixed_sum += weights[i];
    if (std::abs(weights[i]) > std::abs(weights[strongest])) strongest = i;
  }
  // Rounding must not change the brightness. What is missing is a few units of the largest weight.
  const std::int32_t missing = static_cast<std::int32_t>(std::lround(sum * (1 << shift))) - fixed_sum;
  weights[strongest] = std::clamp(weights[strongest] + missing, -kMaxExactWeight, kMaxExactWeight);

  plan.pair_taps.clear();
  ExactFilter& filter = plan.exact;
  filter = {};
  filter.shift = shift;
  filter.n_min = std::numeric_limits<int>::max();
  filter.n_max = std::numeric_limits<int>::min();
  const auto m_of = [&](const KernelTap& tap) { return plan.major_is_y ? tap.dy : tap.dx; };
  const auto n_of = [&](const KernelTap& tap) { return plan.major_is_y ? tap.dx : tap.dy; };
  for (std::size_t i = 0; i < taps.size(); ++i) {
    // Convolution: output at p takes input at p - tap. Two neighbours across make one pair.
    const bool paired =
        i + 1 < taps.size() && m_of(taps[i + 1]) == m_of(taps[i]) && n_of(taps[i + 1]) == n_of(taps[i]) + 1;
    const std::int32_t low = paired ? weights[i + 1] : weights[i], high = paired ? weights[i] : 0;
    const PairTap pair{-m_of(taps[i]), -n_of(taps[i]) - (paired ? 1 : 0),
                       static_cast<std::int32_t>((static_cast<std::uint32_t>(high) << 16) |
                                                 (static_cast<std::uint32_t>(low) & 0xffffu))};
    filter.radius_m = std::max(filter.radius_m, std::abs(pair.m));
    filter.n_min = std::min(filter.n_min, pair.n);
    filter.n_max = std::max(filter.n_max, pair.n);
    plan.pair_taps.push_back(pair);
    if (paired) ++i;
  }
  filter.taps = plan.pair_taps.data();
  filter.count = static_cast<int>(plan.pair_taps.size());
  plan.reach_m = filter.radius_m + 1;
}

namespace {

/// The kernel along the major axis less the box: smooth, so that few samples describe it.
class SmoothPart {
 public:
  /// @param stretch steps of the major axis in one pixel of the line, (0, 1]
  /// @param d       steps that one sample stands for
  SmoothPart(const LineKernel& kernel, double stretch, int d) : stretch_(stretch), d_(d) {
    // Zeros on both sides for the cubic and for the half steps of `second_derivative`.
    margin_ = static_cast<int>(std::ceil(2 * d / stretch_)) + 4;
    const int size = static_cast<int>(kernel.taps.size());
    const std::vector<double> box = box_blur_kernel(kernel.box_extent_px, size);
    values_.assign(size + 2 * margin_, 0.0f);
    const double height = kernel.box_height * kernel.box_extent_px;
    for (int i = 0; i < size; ++i) values_[i + margin_] = static_cast<float>(kernel.taps[i] - height * box[i]);
    center_ = size / 2 + margin_;
  }

  /// Value at step m, smoothed as tap_on_major_axis smooths it and sharpened by `removed_variance`: smoothing by a
  /// variance v adds v / 2 times the second derivative.
  double at(int m, double removed_variance) const {
    const double half_step = d_ / 2.0;
    const double value = sample(m);
    const double second = (sample(m - half_step) - 2 * value + sample(m + half_step)) / (half_step * half_step);
    return (value + (splat_variance(m) - removed_variance) / 2 * second) / stretch_;
  }

 private:
  /// Catmull-Rom at a position along the major axis; 0 outside the kernel.
  double sample(double m) const {
    const double s = m / stretch_ + center_;
    const int below = static_cast<int>(s);
    if (below < 1 || below + 2 >= static_cast<int>(values_.size())) return 0;
    const double t = s - below;
    const float* v = values_.data() + below;
    return v[0] +
           t / 2 *
               (v[1] - v[-1] + t * (2 * v[-1] - 5 * v[0] + 4 * v[1] - v[2] + t * (3 * (v[0] - v[1]) + v[2] - v[-1])));
  }

  /// A tap at fraction f between two steps gets the variance f (1 - f). Averaged over the taps around a step; where f
  /// runs through a whole period there, the mean is 1/6.
  double splat_variance(int m) const {
    if (2 * d_ * (1 - stretch_) >= 1) return 1.0 / 6;
    const double nearest = std::round(m / stretch_);
    double sum = 0;
    for (int i = -d_; i < d_; ++i) {
      const double step = (nearest + i) * stretch_;
      const double fraction = step - std::floor(step);
      sum += fraction * (1 - fraction);
    }
    return sum / (2 * d_);
  }

  double stretch_;
  int d_, margin_, center_;
  std::vector<float> values_;  // along the line, unit steps, the kernel's centre at [center_]
};

}  // namespace

// The kernel along the major axis is split into three parts:
//   box_height inside the box        -> two running sums,
//   what differs at the box's ends   -> exact taps, merged into weights of the running sums there,
//   the smooth rest                  -> its values at every d-th step, applied to sums over d samples, and a cubic
//                                       between the d-th outputs.
// All weights are in correlation order: the weight at offset k acts on the input k steps further, which is the kernel
// at -k.
void CpuConvolver::plan_two_scale(const LineKernel& kernel, double major, int depth, Plan& plan) const {
  plan.method = Method::TWO_SCALE;
  const double stretch = std::abs(major);  // steps of the major axis in one pixel of the line
  const double extent = kernel.box_extent_px * stretch;
  const int d = extent < kMinCoarseExtentPx ? 1 : static_cast<int>(std::lround(extent / kCoarseSamplesPerExtent));
  const int radius = (static_cast<int>(std::ceil(kernel.radius() * stretch)) + d - 1) / d;

  plan.edge_offsets.clear();
  plan.edge_weights.clear();
  plan.coarse.assign(2 * radius + 1 + 2 * kCoarseGuard, 0.0f);
  float* coarse = plan.coarse.data() + kCoarseGuard + radius;  // weight of node k at [k]
  const int inside = static_cast<int>(std::floor(extent / 2));
  if (d == 1) {
    for (int k = -radius; k <= radius; ++k) coarse[k] = static_cast<float>(tap_on_major_axis(kernel, major, -k));
  } else {
    const SmoothPart smooth(kernel, stretch, d);
    const double height = kernel.box_height / stretch;
    // The sum decides the brightness and must be exact: the box and the rest nearly cancel in it. A running sum at
    // offset o makes o of a constant image of one.
    double edge_sum = 0;
    const auto add_edge = [&](int offset, double weight) {
      plan.edge_offsets.push_back(offset);
      plan.edge_weights.push_back(static_cast<float>(weight));
      edge_sum += static_cast<double>(plan.edge_weights.back()) * offset;
    };
    constexpr int kCorrected = 2 * kEdgeReach;
    const int first = inside - kEdgeReach + 1;
    double correction[kCorrected + 2] = {};  // of offsets first - 1 .. first + kCorrected, on either side
    for (int i = 0; i < kCorrected; ++i) {
      const int offset = first + i;
      const double model = smooth.at(offset, 0.0) + (offset <= inside ? height : 0.0);
      correction[i + 1] = tap_on_major_axis(kernel, stretch, offset) - model;
    }
    // A weight w on the sample at offset o is w on the running sum at o and -w on that at o - 1.
    for (int i = 0; i <= kCorrected; ++i) {
      const int offset = first - 1 + i;
      const double weight = correction[i] - correction[i + 1] + (offset == inside ? height : 0.0);
      add_edge(offset, weight);
      add_edge(-offset - 1, -weight);
    }
    const double node_variance = (d * d - 1) / 12.0;  // of a sum over d samples
    std::vector<double> weights(radius + 1);
    for (int k = 0; k <= radius; ++k) weights[k] = smooth.at(k * d, node_variance);
    const double wanted = std::accumulate(kernel.taps.begin(), kernel.taps.end(), 0.0) - edge_sum;
    const double scale = wanted / (d * (2 * std::accumulate(weights.begin(), weights.end(), 0.0) - weights[0]));
    for (int k = 0; k <= radius; ++k) coarse[k] = coarse[-k] = static_cast<float>(weights[k] * scale);
  }

  plan.two_scale = {plan.edge_offsets.data(),
                    plan.edge_weights.data(),
                    static_cast<int>(plan.edge_offsets.size()),
                    d > 1 ? inside + kEdgeReach + 1 : 0,
                    plan.coarse.data() + kCoarseGuard,
                    radius,
                    d,
                    depth == CV_8U ? 255.0f : 65535.0f};
  plan.reach_m = (radius + kCoarseGuard + 5) * d;
}

template <typename Pixel>
void CpuConvolver::run_tile(const Tile& tile, const Plan& plan, const Planes<Pixel>& planes, float* scratch,
                            Pixel* line_order) const {
  const SourcePlane<Pixel> source = planes.view(plan.major_is_y);
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
    for (int x = 0; x < whole_cols; x += 8) {
      transpose_8x8(reinterpret_cast<const std::uint8_t*>(from + y * from_stride + x), from_stride,
                    reinterpret_cast<std::uint8_t*>(to + x * to_stride + y), to_stride);
    }
  }
  for (int y = 0; y < rows; ++y) {
    for (int x = y < whole_rows ? whole_cols : 0; x < cols; ++x) to[x * to_stride + y] = from[y * from_stride + x];
  }
}

/// Makes room for `rows` rows of `cols` pixels with `pad` more on either side. Returns the distance between rows: an
/// odd number of cache lines, so that rows do not compete for the same cache set.
template <typename Pixel>
std::ptrdiff_t reserve_padded(int rows, int cols, int pad, std::vector<Pixel>& storage) {
  constexpr int kPixelsPerLine = 64 / sizeof(Pixel);
  const std::ptrdiff_t stride = (((cols + 2 * pad) / kPixelsPerLine + 1) | 1) * kPixelsPerLine;
  const std::size_t needed = stride * rows;
  if (storage.size() < needed) storage.resize(needed);
  return stride;
}

/// Copies `channel` into `storage` with `pad` replicated pixels left and right, and returns its view.
template <typename Pixel>
SourcePlane<Pixel> pad_columns(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& storage) {
  const std::ptrdiff_t stride = reserve_padded(channel.rows, channel.cols, pad, storage);
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int y = 0; y < channel.rows; ++y) {
    const Pixel* from = channel.ptr<Pixel>(y);
    Pixel* to = storage.data() + y * stride;
    std::fill_n(to, pad, from[0]);
    std::copy_n(from, channel.cols, to + pad);
    std::fill_n(to + pad + channel.cols, pad, from[channel.cols - 1]);
  }
  return {storage.data() + pad, stride, channel.rows};
}

/// The same of the transposed channel.
template <typename Pixel>
SourcePlane<Pixel> pad_transposed(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& storage) {
  const std::ptrdiff_t stride = reserve_padded(channel.cols, channel.rows, pad, storage);
  constexpr int kBand = 64;  // columns of the channel that one thread transposes at a time
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int x = 0; x < channel.cols; x += kBand) {
    const int band = std::min(kBand, channel.cols - x);
    transpose(channel.ptr<Pixel>(0) + x, channel.step1(), channel.rows, band, storage.data() + x * stride + pad,
              stride);
    for (int i = 0; i < band; ++i) {
      Pixel* row = storage.data() + (x + i) * stride;
      std::fill_n(row, pad, row[pad]);
      std::fill_n(row + pad + channel.rows, pad, row[pad + channel.rows - 1]);
    }
  }
  return {storage.data() + pad, stride, channel.cols};
}

/// Stores a tile, given in line order, into channel `channel` of `dst`.
template <typename Pixel>
void store_tile(const Pixel* line_order, const cv::Rect& rect, bool major_is_y, int channel, cv::Mat& dst) {
  const int channels = dst.channels();
  if (channels == 1 && major_is_y) {
    for (int y = 0; y < rect.height; ++y) {
      std::copy_n(line_order + y * kMaxTileSide, rect.width, dst.ptr<Pixel>(rect.y + y) + rect.x);
    }
    return;
  }
  if (channels == 1) {
    transpose(line_order, kMaxTileSide, rect.width, rect.height, dst.ptr<Pixel>(rect.y) + rect.x, dst.step1());
    return;
  }
  for (int y = 0; y < rect.height; ++y) {
    Pixel* to = dst.ptr<Pixel>(rect.y + y) + static_cast<std::ptrdiff_t>(rect.x) * channels + channel;
    for (int x = 0; x < rect.width; ++x) {
      to[x * channels] = major_is_y ? line_order[y * kMaxTileSide + x] : line_order[x * kMaxTileSide + y];
    }
  }
}

}  // namespace

template <typename Pixel>
void CpuConvolver::convolve_as(const cv::Mat& src, const std::vector<BlockFilter>& blocks, cv::Mat& dst,
                               Planes<Pixel>& planes) {
  const int threads = threads_ > 0 ? threads_ : omp_get_max_threads();
  const int count = static_cast<int>(blocks.size());
  plans_.resize(std::max(plans_.size(), blocks.size()));
#pragma omp parallel for num_threads(threads) schedule(dynamic)
  for (int i = 0; i < count; ++i) plan_block(blocks[i], src.depth(), plans_[i]);

  tiles_.clear();
  left_to_reference_.assign(blocks.begin(), blocks.end());
  bool need_reference = false, need_upright = false, need_transposed = false;
  double border_upright = 0, border_transposed = 0;
  std::size_t scratch_floats = 0;
  for (int i = 0; i < count; ++i) {
    const Plan& plan = plans_[i];
    if (plan.method == Method::REFERENCE) need_reference = true;
    if (plan.method != Method::EXACT && plan.method != Method::TWO_SCALE) continue;
    left_to_reference_[i].kernel = nullptr;
    const cv::Rect& rect = blocks[i].rect;
    for (int y = rect.y; y < rect.br().y; y += kMaxTileSide) {
      for (int x = rect.x; x < rect.br().x; x += kMaxTileSide) {
        const cv::Rect part(x, y, std::min(kMaxTileSide, rect.br().x - x), std::min(kMaxTileSide, rect.br().y - y));
        Tile tile{{}, part, i};
        tile.geometry = plan.major_is_y ? TileGeometry{part.y, part.height, part.x, part.width, plan.slope}
                                        : TileGeometry{part.x, part.width, part.y, part.height, plan.slope};
        scratch_floats =
            std::max(scratch_floats, plan.method == Method::EXACT
                                         ? kernels_.exact_scratch_floats(tile.geometry, plan.exact)
                                         : kernels_.two_scale_scratch_floats(tile.geometry, plan.two_scale));
        tiles_.push_back(tile);
      }
    }
    // Lines leave the tile sideways by their slope; whole vectors are read beyond, up to four of outputs and some of
    // rounding.
    const double pad = std::abs(plan.slope) * (plan.reach_m + kMaxTileSide) + 8 * kernels_.lanes + 8;
    (plan.major_is_y ? need_upright : need_transposed) = true;
    (plan.major_is_y ? border_upright : border_transposed) =
        std::max(plan.major_is_y ? border_upright : border_transposed, pad);
  }

  if (need_reference) {
    reference_.convolve(src, left_to_reference_, dst);
  } else {
    for (int i = 0; i < count; ++i) {
      if (plans_[i].method == Method::COPY) src(blocks[i].rect).copyTo(dst(blocks[i].rect));
    }
  }
  if (tiles_.empty()) return;

  scratch_.resize(threads);
  for (std::vector<float>& scratch : scratch_) {
    if (scratch.size() < scratch_floats + kAlignFloats) scratch.resize(scratch_floats + kAlignFloats);
  }
  for (int channel = 0; channel < src.channels(); ++channel) {
    cv::Mat plane = src;
    if (src.channels() > 1) {
      cv::extractChannel(src, channel_, channel);
      plane = channel_;
    }
    if (need_upright) {
      planes.upright_view = pad_columns(plane, static_cast<int>(std::ceil(border_upright)), threads, planes.upright);
    }
    if (need_transposed) {
      planes.transposed_view =
          pad_transposed(plane, static_cast<int>(std::ceil(border_transposed)), threads, planes.transposed);
    }
    const int tile_count = static_cast<int>(tiles_.size());
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (int i = 0; i < tile_count; ++i) {
      const Tile& tile = tiles_[i];
      const Plan& plan = plans_[tile.plan];
      alignas(64) Pixel line_order[kMaxTileSide * kMaxTileSide];
      float* scratch = scratch_[omp_get_thread_num()].data();
      const std::uintptr_t past_line = reinterpret_cast<std::uintptr_t>(scratch) % 64;
      if (past_line != 0) scratch += (64 - past_line) / sizeof(float);
      run_tile(tile, plan, planes, scratch, line_order);
      store_tile(line_order, tile.rect, plan.major_is_y, channel, dst);
    }
  }
}

void CpuConvolver::convolve(const cv::Mat& src, const std::vector<BlockFilter>& blocks, cv::Mat& dst) {
  require_convolvable(src);
  dst.create(src.size(), src.type());
  if (src.depth() == CV_8U) {
    convolve_as(src, blocks, dst, planes8_);
  } else {
    convolve_as(src, blocks, dst, planes16_);
  }
}

}  // namespace gyro_deblur
