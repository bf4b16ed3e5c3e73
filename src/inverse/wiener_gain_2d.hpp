// The inverse of a curved path: its gain at every frequency of a tile (doc/design/fourier_filter.md).
#pragma once

#include <vector>

#include "base/fourier.hpp"
#include "inverse/wiener_gain_2d_simd.hpp"
#include "inverse/wiener_inverse_2d.hpp"

namespace gyro_deblur {

/// What else the gain is multiplied with at k cycles in a tile along one axis, k = 0 .. size / 2 - 1.
struct PlaneBand {
  std::vector<float> gain;
  std::vector<float> again;  ///< where it blurs again
};

/// The gain of one inverse after another for tiles of one size or another. Keeps its memory.
class WienerGain2d {
 public:
  /// @param simd  with as many lanes as those of the transform
  explicit WienerGain2d(const WienerGain2dSimd& simd) : simd_(simd) {}

  /// Prepares for rows(). Preconditions: finite places, WienerInverse2d's ranges; the plans of
  /// `tile` and the bands of its axes live on.
  void set(const WienerInverse2d& inverse, const FourierTile& tile, const PlaneBand& band_across,
           const PlaneBand& band_down);

  /// Gain at frequencies down of first_row .. first_row + lanes - 1 (first_row a multiple of lanes), as
  /// FourierSimd::filter_rows takes it: 2 * lanes * across.size floats. 0 at half a cycle a pixel across.
  /// @param again  if not null, as many floats: the gain of the inverse and the blur after it, G(f) H(f), 0 to
  ///               1 + N(0), times its band
  void rows(int first_row, float* gain, float* again = nullptr);

 private:
  const WienerGain2dSimd& simd_;
  WienerGain2dTables tables_{};
  std::vector<float> across_, down_;  // of tables_
};

}  // namespace gyro_deblur
