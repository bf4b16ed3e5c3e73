// The loops of the 2-D filter around its transforms: one interface, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// What a tile is made from. Pixel type: that of the function which takes it.
struct TileSource {
  const void* pixels;         ///< of the image
  std::ptrdiff_t row_pixels;  ///< from a row of the image to the next
  int image_cols, image_rows;
  int x, y, width, height;       ///< window of the tile
  int cols, rows;                ///< of the tile
  const float *fade_x, *fade_y;  ///< behind the window: share of what lies a tile earlier
};

/// Floats of scratch that loading a tile of `cols` columns takes.
constexpr int tile_scratch(int cols) { return 4 * cols; }

/// The functions of one instruction set. Rows of tiles are fourier_stride(cols) floats apart, those of windows have
/// no gaps.
struct TileSimd {
  const char* name;
  /// Loads the window of a tile, and behind it what fades from the image behind into the image before. Edges of the
  /// image go on.
  void (*load_bytes)(const TileSource& source, float* tile, float* scratch);
  void (*load_words)(const TileSource& source, float* tile, float* scratch);
  void (*load_floats)(const TileSource& source, float* tile, float* scratch);
  /// tile += (step - step * inside_x * inside_y) (continued - tile), for all of a tile.
  void (*continue_tile)(int cols, int rows, float step, const float* inside_x, const float* inside_y,
                        const float* continued, float* tile);
  /// The window of a tile of `cols` columns times its weights.
  void (*weigh)(const float* tile, int cols, int width, int height, const float* weights_x, const float* weights_y,
                float* window);
  /// to += from, for a rectangle; strides in floats.
  void (*add)(const float* from, std::ptrdiff_t from_stride, int width, int height, float* to,
              std::ptrdiff_t to_stride);
  /// values = (values + halves) / (weights + weights_of_halves). Where weights_of_halves is not above 0 but weights is,
  /// the halves do not count: the low pass reaches a little beyond a window, with a negative weight.
  void (*mix_sizes)(const float* halves, const float* weights_of_halves, const float* weights, int count,
                    float* values);
  /// Rounds rows of `width` values to pixels, clipped to their type; NaN becomes 0. Pixels are `step` apart in a row.
  void (*store_bytes)(const float* from, std::ptrdiff_t from_stride, int width, int height, int step, std::uint8_t* to,
                      std::ptrdiff_t to_stride);
  void (*store_words)(const float* from, std::ptrdiff_t from_stride, int width, int height, int step, std::uint16_t* to,
                      std::ptrdiff_t to_stride);
};

GYRO_DEBLUR_SIMD_KERNELS(TileSimd)

}  // namespace gyro_deblur
