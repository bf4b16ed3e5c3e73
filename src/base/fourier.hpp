// Discrete Fourier transforms of small tiles: their sizes, and what transforms of one size share.
#pragma once

#include <vector>

namespace gyro_deblur {

/// Sizes are multiples of this: two of the widest vector.
constexpr int kFourierStep = 32;

/// Longest side of a tile [px].
constexpr int kMaxFourierSize = 1024;

/// The smallest multiple of kFourierStep that is at least `length` (1 to kMaxFourierSize) and has no prime factors
/// other than 2, 3 and 5.
int fourier_size(int length);

/// Floats from a row of `size` pixels of a tile to the next: an odd number of cache lines, so that pixels above each
/// other do not compete for the same cache sets.
constexpr int fourier_stride(int size) { return size + 16; }

/// A plan as the loops see it (fourier_simd.hpp).
struct FourierStages {
  int size;
  int count;                  ///< of stages
  const int* radices;         ///< by stage; their product is `size`
  const float* twiddles;      ///< by stage; see FourierPlan
  const float* twiddles_end;  ///< behind them, where those of the last stage would begin: it has none
  const int* places;          ///< of `size` frequencies: where a transform along one axis leaves them
};

/// A tile's two axes. Rows have across.size pixels.
struct FourierTile {
  FourierStages across, down;
};

/// Mixed-radix transform of one size, decimated in frequency (C. Van Loan, Computational Frameworks for the Fast
/// Fourier Transform, SIAM 1992, section 2.1): in place, natural order to digit-reversed order; the inverse back.
/// A stage of radix r takes each run of L elements as r parts of L / r and multiplies element j of part q of its result
/// by exp(-2 pi i j q / L): the twiddles, for j = 1 .. L / r - 1 and q = 1 .. r - 1, as pairs of floats.
class FourierPlan {
 public:
  /// @param largest_radix  4 or 8, see FourierSimd
  /// Precondition: size = fourier_size(size).
  FourierPlan(int size, int largest_radix);

  FourierStages stages() const;

 private:
  int size_;
  std::vector<int> radices_, places_;
  std::vector<float> twiddles_;
};

}  // namespace gyro_deblur
