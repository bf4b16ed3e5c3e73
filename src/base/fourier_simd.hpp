// The loops of the Fourier transform of a tile: one interface, compiled once per instruction set.
//
// A tile of real numbers has rows of fourier_stride(across.size) floats, on a cache line. Its spectrum takes its place:
// rows of frequency v = 0 .. down.size / 2 - 1 (cycles in the tile, down), the real parts in row v, the imaginary parts
// in row down.size / 2 + v. Frequencies of half a cycle a pixel, whose phase a real tile does not have, are left out.
#pragma once

#include "base/fourier.hpp"
#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Floats of scratch that the loops take for tiles whose longer side is `size`, on a cache line.
constexpr int fourier_scratch(int size) { return 32 * size; }

/// The functions of one instruction set.
struct FourierSimd {
  const char* name;
  int lanes;          ///< rows of the spectrum that filter_rows takes at a time; divides kFourierStep / 2
  int largest_radix;  ///< with which plans are fastest
  /// Transforms all columns of a tile.
  void (*transform_columns)(const FourierTile& plan, float* tile, float* scratch);
  /// Transforms the rows of frequencies first_row .. first_row + lanes - 1 (first_row a multiple of lanes), multiplies
  /// them by `gain` and transforms them back for columns first_col .. end_col - 1 at least.
  /// @param gain  for across.places[u] of each frequency u, `lanes` real and then `lanes` imaginary parts. Row 0 stands
  ///              for itself alone, so that it has to have gain(-u) = conj(gain(u)).
  void (*filter_rows)(const FourierTile& plan, int first_row, const float* gain, int first_col, int end_col,
                      float* tile, float* scratch);
  /// Powers of the rows of frequencies first_row .. first_row + lanes - 1 (first_row a multiple of lanes): that of
  /// frequency u across and v down goes to powers[(u < 0 ? across.size + u : u) * down.size / 2 + v], on a cache line.
  void (*row_powers)(const FourierTile& plan, int first_row, const float* tile, float* powers, float* scratch);
  /// Transforms columns first_col .. end_col - 1, at least, back. With a gain of 1 that is the tile, less what has half
  /// a cycle a pixel across (if the gain is 0 there) or down.
  void (*restore_columns)(const FourierTile& plan, int first_col, int end_col, float* tile, float* scratch);
};

GYRO_DEBLUR_SIMD_KERNELS(FourierSimd)

}  // namespace gyro_deblur
