// Body of the loops that make weights, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "inverse/tap_loops.hpp"

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

/// Elements of a window by their index.
#if defined(__AVX512F__)
inline Vector pick(const float* window, IntVector index) {
  return (Vector)_mm512_permutex2var_ps((__m512)load(window), (__m512i)index, (__m512)load(window + kLanes));
}
#elif defined(__AVX2__)
inline Vector pick(const float* window, IntVector index) {
  const __m256 low = _mm256_permutevar8x32_ps((__m256)load(window), (__m256i)index);
  const __m256 high = _mm256_permutevar8x32_ps((__m256)load(window + kLanes), (__m256i)index);
  return (Vector)_mm256_blendv_ps(low, high, (__m256)(index << 28));  // by bit 3
}
#else
inline Vector pick(const float* window, IntVector index) {
  Vector v;
  for (int i = 0; i < kLanes; ++i) v[i] = window[index[i]];
  return v;
}
#endif

void resample_kernel(const float* taps, int radius, double step, int steps, float* on_axis) {
  // kLanes steps lie between at most 1.5 times as many taps, and the outermost see one more before and two behind.
  constexpr int kWindow = 2 * kLanes + 4;
  const double taps_a_step = 1 / step;
  const float s = static_cast<float>(step);
  const Vector zero = {};
  Vector in_taps;
  for (int i = 0; i < kLanes; ++i) in_taps[i] = static_cast<float>(i * taps_a_step);
  for (int m = 0; m <= steps; m += kLanes) {
    const double first = m * taps_a_step;
    const int begin = static_cast<int>(first);
    const float* window = taps + begin - 1;
    const int available = radius - begin + 2;
    float copy[kWindow];
    if (available < kWindow) {
      for (int i = 0; i < kWindow; ++i) copy[i] = i < available ? window[i] : 0.0f;
      window = copy;
    }
    const Vector position = in_taps + static_cast<float>(first - begin);
    const IntVector index = __builtin_convertvector(position, IntVector);
    const Vector before = (position - __builtin_convertvector(index, Vector)) * s, after = s - before;
    const Vector far_before = 1 - s - before, far_after = 1 - s - after;
    const Vector sum = pick(window, index + 1) * (1 - before) + pick(window, index + 2) * (1 - after) +
                       pick(window, index) * (far_before > zero ? far_before : zero) +
                       pick(window, index + 3) * (far_after > zero ? far_after : zero);
    store(on_axis + m, sum);
  }
}

void combine_columns(const float* columns, const float* factors, int count, float* sums) {
  constexpr int kVectors = kRowGroup / kLanes;
  constexpr int kChains = 4;  // independent sums, to hide the latency of an FMA
  Vector acc[kChains][kVectors] = {};
  const auto add = [&](int m, Vector* chain) {
    for (int v = 0; v < kVectors; ++v) chain[v] += factors[m] * load(columns + m * kRowGroup + v * kLanes);
  };
  int m = 0;
  for (; m + kChains <= count; m += kChains) {
    for (int c = 0; c < kChains; ++c) add(m + c, acc[c]);
  }
  for (; m < count; ++m) add(m, acc[0]);
  for (int v = 0; v < kVectors; ++v) {
    store(sums + v * kLanes, (acc[0][v] + acc[1][v]) + (acc[2][v] + acc[3][v]));
  }
}

}  // namespace

extern const TapLoops kTapLoops;
const TapLoops kTapLoops = {GYRO_DEBLUR_ISA_NAME, resample_kernel, combine_columns};

}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
