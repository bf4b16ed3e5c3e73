// The inner loops of the CPU engine: one interface, compiled once per instruction set (see block_simd_impl.hpp).
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/instruction_sets.hpp"
#include "inverse/coefficients.hpp"

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
/// wide as what is read at a time is enough. pad = 0: no columns outside.
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
  int columns;  ///< least `pad` of the source: what is read at a time where that may be outside; 0 for exact taps
};

constexpr int kMaxTileSide = 72;  ///< a block of 64 px and its margins
/// Pixels from row to row of a finished tile: whole vectors are written.
constexpr int kTileStride = (kMaxTileSide + 31) / 32 * 32;

/// The functions of one instruction set. Source and `scratch` are as *_needs() of the same arguments says. `tile`
/// receives m_count rows of kTileStride pixels.
struct BlockSimd {
  const char* name;
  int lanes;              ///< floats in a vector
  bool has_byte_weights;  ///< takes ExactFilter::weights_are_bytes, faster and coarser
  TileNeeds (*exact_needs)(const TileGeometry&, const ExactFilter&);
  void (*exact_u8)(const SourcePlane<std::uint8_t>&, const TileGeometry&, const ExactFilter&, float* scratch,
                   std::uint8_t* tile);
  TileNeeds (*two_scale_u8_needs)(const TileGeometry&, const TwoScaleFilter&);
  TileNeeds (*two_scale_u16_needs)(const TileGeometry&, const TwoScaleFilter&);
  void (*two_scale_u8)(const SourcePlane<std::uint8_t>&, const TileGeometry&, const TwoScaleFilter&, float* scratch,
                       std::uint8_t* tile);
  void (*two_scale_u16)(const SourcePlane<std::uint16_t>&, const TileGeometry&, const TwoScaleFilter&, float* scratch,
                        std::uint16_t* tile);
};

GYRO_DEBLUR_SIMD_KERNELS(BlockSimd)

}  // namespace gyro_deblur
