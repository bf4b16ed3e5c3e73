// The inner loops of the CPU engine: one interface, compiled once per instruction set (see block_kernels_impl.hpp).
#pragma once

#include <cstddef>
#include <cstdint>

namespace gyro_deblur {

/// Work on a tile in line coordinates: m runs along the major axis of the blur (image rows of `source`), n across it
/// (contiguous in memory). A line through (m0, n0) follows n = n0 + slope (m - m0), |slope| <= 1.
struct TileGeometry {
  int m_begin, m_count;  ///< outputs, >= 1
  int n_begin, n_count;  ///< outputs, >= 1, n_count <= kMaxTileSide
  double slope;
};

/// A plane of pixels, at least 1x1, that goes on with its edge pixels outside: rows [0, rows) of columns [0, cols), and
/// the columns around its edges again, with `pad` columns more. Nothing changes farther out than that, so that a pad as
/// wide as what is read at a time is enough.
template <typename Pixel>
struct SourcePlane {
  const Pixel* origin;    ///< pixel (m, n) = (0, 0)
  std::ptrdiff_t stride;  ///< pixels from row to row
  int rows, cols;
  /// Pixel (m, n) is at left[m * edge_stride + n] for n in [-pad, pad) and at right[m * edge_stride + n] for n in
  /// [cols - pad, cols + pad).
  const Pixel *left, *right;
  std::ptrdiff_t edge_stride;
  int pad;
};

/// What the inner loops need for a tile.
struct TileNeeds {
  std::size_t scratch_floats;  ///< 64-byte aligned
  int columns;                 ///< read at a time: least `pad` of the source
};

constexpr int kMaxTileSide = 72;  ///< a block of 64 px and its margins
/// Pixels from row to row of a finished tile: whole vectors are written.
constexpr int kTileStride = (kMaxTileSide + 31) / 32 * 32;
constexpr int kCoarseGuard = 3;  ///< zeros that the caller puts on either side of TwoScaleFilter::coarse

/// Exact taps: at step `m` along the line the two neighbours across, with weights as a pair of int16.
struct PairTap {
  int m, n;              ///< input relative to the output
  std::int32_t weights;  ///< weight of n in the low half, of n + 1 in the high half
};

/// Largest size of a weight. int16 would hold eight times as much; with this, sums of 2000 taps at full brightness
/// still fit int32.
constexpr int kMaxPairWeight = 1 << 12;
constexpr int kMaxByteWeight = 127;  ///< where weights_are_bytes

struct ExactFilter {
  const PairTap* taps;
  int count;
  bool weights_are_bytes;  ///< twice as fast, and coarser; for sets with has_byte_weights
  int radius_m;            ///< max |tap.m|
  int n_min, n_max;        ///< over taps
  float scale;             ///< grey levels in a sum of weights times pixels
};

/// Two scales (see TwoScaleWeights). Applies to correlation order: output(m) = sum weight[k] input(m + k).
struct TwoScaleFilter {
  int box_half;                ///< samples of the inner box on either side of the output
  float inner_box, outer_box;  ///< weights of the two boxes
  const float* coarse;         ///< 2 coarse_radius + 1 weights of sums over `decimation` samples
  int coarse_radius;
  /// The same weights w in fixed point with coarse_shift bits, for 8-bit pixels, as pairs of int16 with the lower index
  /// in the low half: coarse_even[i] is w[2 i], w[2 i + 1] and coarse_odd[i] is w[2 i - 1], w[2 i], with zeros beyond
  /// the ends; i from -1 to coarse_radius + 1. Their sum is coarse_sum.
  const std::int32_t *coarse_even, *coarse_odd;
  int coarse_shift;
  std::int32_t coarse_sum;
  int decimation;   ///< >= 2
  float max_value;  ///< of the pixel type
};

/// Rows of a matrix that combine_columns takes at a time: floats in the widest vector.
constexpr int kRowGroup = 16;

/// The functions of one instruction set. Source and `scratch` are as *_needs() of the same arguments says. `tile`
/// receives m_count rows of kTileStride pixels.
struct BlockKernels {
  const char* name;
  int lanes;              ///< floats in a vector
  bool has_byte_weights;  ///< see ExactFilter
  TileNeeds (*exact_needs)(const TileGeometry&, const ExactFilter&);
  void (*exact_u8)(const SourcePlane<std::uint8_t>&, const TileGeometry&, const ExactFilter&, float* scratch,
                   std::uint8_t* tile);
  TileNeeds (*two_scale_u8_needs)(const TileGeometry&, const TwoScaleFilter&);
  TileNeeds (*two_scale_u16_needs)(const TileGeometry&, const TwoScaleFilter&);
  void (*two_scale_u8)(const SourcePlane<std::uint8_t>&, const TileGeometry&, const TwoScaleFilter&, float* scratch,
                       std::uint8_t* tile);
  void (*two_scale_u16)(const SourcePlane<std::uint16_t>&, const TileGeometry&, const TwoScaleFilter&, float* scratch,
                        std::uint16_t* tile);
  /// What kernel_on_major_axis() gives for steps 0 .. steps of a symmetric kernel, 2 radius + 1 taps around taps[0],
  /// whose taps are `step` apart in [0.7, 1]. Writes whole groups of kRowGroup.
  void (*resample_kernel)(const float* taps, int radius, double step, int steps, float* on_axis);
  /// sums[i] = sum of factors[m] * columns[m * kRowGroup + i] over m < count, for i < kRowGroup.
  void (*combine_columns)(const float* columns, const float* factors, int count, float* sums);
};

namespace baseline {
extern const BlockKernels kKernels;
}
#if defined(__x86_64__)
namespace avx2 {
extern const BlockKernels kKernels;
}
namespace avx512 {
extern const BlockKernels kKernels;
}
#endif

/// The widest set this processor runs.
const BlockKernels& best_block_kernels();

/// A set by name ("baseline", "avx2", "avx512"), or null when this processor or build does not have it.
const BlockKernels* find_block_kernels(const char* name);

}  // namespace gyro_deblur
