// Bodies of the loops that search for corners, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "features/corner_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

static_assert(2 * kLanes <= kCornerRoom, "whole vectors are read and written, and a pixel beyond");

void downsample2x(const unsigned char* upper, const unsigned char* lower, float* half, int width) {
  typedef std::uint16_t Pairs __attribute__((vector_size(2 * kLanes)));
  if (width < kLanes) {
    for (int x = 0; x < width; ++x) {
      half[x] = 0.25f * static_cast<float>(upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1]);
    }
    return;
  }
  // The last vector overlaps the one before: nothing is read beyond the rows.
  for (int x = 0; x < width; x += kLanes) {
    const int at = x + kLanes <= width ? x : width - kLanes;
    const Pairs above = load_as<Pairs>(upper + 2 * at), below = load_as<Pairs>(lower + 2 * at);
    const Pairs sums = (above & 255) + (above >> 8) + (below & 255) + (below >> 8);
    // One size at a time: compilers take wider steps lane by lane.
    store(half + at, 0.25f * __builtin_convertvector(__builtin_convertvector(sums, IntVector), Vector));
  }
}

void multiply(const float* above, const float* middle, const float* below, GradientProducts products, int width) {
  for (int x = 0; x < width; x += kLanes) {
    const Vector across = load(middle + x + 1) - load(middle + x - 1), down = load(below + x) - load(above + x);
    store(products.xx + x, across * across);
    store(products.xy + x, across * down);
    store(products.yy + x, down * down);
  }
}

inline Vector sum_of_nine(const float* above, const float* middle, const float* below) {
  return (load(above - 1) + load(above) + load(above + 1)) + (load(middle - 1) + load(middle) + load(middle + 1)) +
         (load(below - 1) + load(below) + load(below + 1));
}

void rate(const GradientProducts* rows, float* strengths, int width) {
  constexpr float kTiny = 1e-6f;  // of grey levels: far below rounding
  for (int x = 0; x < width; x += kLanes) {
    const Vector xx = sum_of_nine(rows[0].xx + x, rows[1].xx + x, rows[2].xx + x),
                 xy = sum_of_nine(rows[0].xy + x, rows[1].xy + x, rows[2].xy + x),
                 yy = sum_of_nine(rows[0].yy + x, rows[1].yy + x, rows[2].yy + x);
    store(strengths + x, (xx * yy - xy * xy) / (xx + yy + kTiny));
  }
}

int find_peaks(const float* above, const float* middle, const float* below, int first_x, int last_x, int* columns) {
  int count = 0;
  for (int x = first_x; x < last_x; x += kLanes) {
    const Vector strength = load(middle + x);
    // Of equal neighbours the first is the peak.
    const IntVector is_peak = (strength > load(above + x - 1)) & (strength > load(above + x)) &
                              (strength > load(above + x + 1)) & (strength > load(middle + x - 1)) &
                              (strength >= load(middle + x + 1)) & (strength >= load(below + x - 1)) &
                              (strength >= load(below + x)) & (strength >= load(below + x + 1));
    std::uint64_t words[sizeof is_peak / 8], any = 0;
    std::memcpy(words, &is_peak, sizeof is_peak);
    for (const std::uint64_t word : words) any |= word;
    if (any == 0) continue;
    for (int i = 0; i < kLanes && x + i < last_x; ++i) {
      columns[count] = x + i;
      count += is_peak[i] != 0 ? 1 : 0;
    }
  }
  return count;
}

}  // namespace

extern const CornerSimd kCornerSimd;
const CornerSimd kCornerSimd = {GYRO_DEBLUR_ISA_NAME, downsample2x, multiply, rate, find_peaks};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
