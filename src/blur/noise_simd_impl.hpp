// Body of the loops that the estimate of noise spends its time in, once per instruction set (see
// base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "blur/noise_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

// 1, -4, 6, -4, 1 has the most power at half a cycle a pixel that five weights can have alone there.
template <typename T>
inline T checkerboard(T a, T b, T c, T d, T e) {
  return a + e - 4.0f * (b + d) + 6.0f * c;
}

template <typename Pixel>
inline void add_every(const Pixel* from, int stride, int count, float scale, int full_scale, float* __restrict to) {
  for (int x = 0; x < count; ++x) {
    const int sample = from[x * stride];
    const int ends = (sample == 0) + (sample >= full_scale);
    to[x] += scale * static_cast<float>(sample) + kNoiseClipped * static_cast<float>(ends);
  }
}

template <typename Pixel>
void add_samples(const Pixel* from, int stride, int count, float scale, int full_scale, float* to) {
  // Strides that the compiler knows vectorise.
  if (stride == 1) {
    add_every(from, 1, count, scale, full_scale, to);
  } else if (stride == 2) {
    add_every(from, 2, count, scale, full_scale, to);
  } else {
    add_every(from, stride, count, scale, full_scale, to);
  }
}

void sum_band(const float* const* rows, int cols, float* __restrict down, NoiseSums sums) {
  float* __restrict power = sums.power, * __restrict first = sums.first, * __restrict second = sums.second, * __restrict clipped = sums.clipped;
  for (int x = 0; x < cols; ++x) power[x] = first[x] = second[x] = clipped[x] = 0;
  for (int y = 0; y < kNoiseBandRows; ++y) {
    const float* row = rows[y];
    for (int x = 0; x < cols; ++x) clipped[x] += row[x] < 0 ? 1.0f : 0.0f;
  }
  const int end = cols - kNoiseReachPx;
  for (int y = 0; y < kNoiseSquarePx; ++y) {
    const float *a = rows[y], *b = rows[y + 1], *c = rows[y + 2], *d = rows[y + 3], *e = rows[y + 4];
    for (int x = 0; x < cols; ++x) down[x] = checkerboard(a[x], b[x], c[x], d[x], e[x]);
    for (int x = kNoiseReachPx; x < end; ++x) {
      const float finest = checkerboard(down[x - 2], down[x - 1], down[x], down[x + 1], down[x + 2]);
      power[x] += finest * finest;
    }
    if (y % 2 == 1) continue;
    for (int x = kNoiseReachPx; x < end; ++x) {
      const float mean = (c[x] + c[x + 1] + d[x] + d[x + 1]) / 4;
      first[x] += mean;
      second[x] += mean * mean;
    }
  }
}

}  // namespace

extern const NoiseSimd kNoiseSimd;
const NoiseSimd kNoiseSimd = {GYRO_DEBLUR_ISA_NAME, add_samples<std::uint8_t>, add_samples<std::uint16_t>, sum_band};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
