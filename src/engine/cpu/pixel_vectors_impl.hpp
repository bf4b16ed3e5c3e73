// What the inner loops of exact taps and of two scales share (see base/vectors_impl.hpp).
#pragma once

#include "base/vectors_impl.hpp"
#include "engine/cpu/block_simd.hpp"

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

inline int round_up(int n, int step) { return (n + step - 1) / step * step; }
inline int clamp_to(int i, int count) { return i < 0 ? 0 : (i >= count ? count - 1 : i); }
constexpr int floor_to_int(double x) {
  const int i = static_cast<int>(x);
  return x < i ? i - 1 : i;
}

/// acc + low * low + high * high of the int16 halves of each lane.
inline IntVector multiply_pairs(IntVector acc, IntVector pixels, IntVector weights) {
#if defined(__AVX512VNNI__)
  return (IntVector)_mm512_dpwssd_epi32((__m512i)acc, (__m512i)pixels, (__m512i)weights);
#elif defined(__AVX2__)
  return acc + (IntVector)_mm256_madd_epi16((__m256i)pixels, (__m256i)weights);
#elif defined(__SSE2__)
  return acc + (IntVector)_mm_madd_epi16((__m128i)pixels, (__m128i)weights);
#else
  const IntVector low = (weights << 16) >> 16, high = weights >> 16;
  return acc + (pixels & 0xffff) * low + (pixels >> 16) * high;
#endif
}

/// kLanes pixels as floats.
template <typename Pixel>
inline Vector load_pixels(const Pixel* from) {
#if defined(__AVX512F__)
  return (Vector)_mm512_cvtepi32_ps(sizeof(Pixel) == 1
                                        ? _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)from))
                                        : _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i*)from)));
#elif defined(__AVX2__)
  return (Vector)_mm256_cvtepi32_ps(sizeof(Pixel) == 1 ? _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)from))
                                                       : _mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i*)from)));
#elif defined(__aarch64__)
  std::uint64_t bits = 0;
  std::memcpy(&bits, from, 4 * sizeof(Pixel));
  const uint16x4_t words = sizeof(Pixel) == 1 ? vget_low_u16(vmovl_u8(vcreate_u8(bits))) : vcreate_u16(bits);
  return (Vector)vcvtq_f32_u32(vmovl_u16(words));
#else
  Vector v;
  for (int i = 0; i < kLanes; ++i) v[i] = from[i];
  return v;
#endif
}

/// Rounds and clips to the pixel type.
template <typename Pixel>
inline void store_pixels(Pixel* to, Vector v) {
  Vector zero = {}, top = zero + (sizeof(Pixel) == 1 ? 255.0f : 65535.0f);
  v = v + 0.5f;
  v = v > zero ? v : zero;
  v = v < top ? v : top;
#if defined(__AVX512F__)
  const __m512i i = _mm512_cvttps_epi32((__m512)v);
  if (sizeof(Pixel) == 1) {
    _mm_storeu_si128((__m128i*)to, _mm512_cvtepi32_epi8(i));
  } else {
    _mm256_storeu_si256((__m256i*)to, _mm512_cvtepi32_epi16(i));
  }
#elif defined(__aarch64__)
  const uint16x4_t words = vmovn_u32(vcvtq_u32_f32((float32x4_t)v));
  if (sizeof(Pixel) == 1) {
    const std::uint32_t four = vget_lane_u32(vreinterpret_u32_u8(vmovn_u16(vcombine_u16(words, words))), 0);
    std::memcpy(to, &four, sizeof four);
  } else {
    std::memcpy(to, &words, sizeof words);
  }
#else
  const IntVector i = __builtin_convertvector(v, IntVector);
  for (int k = 0; k < kLanes; ++k) to[k] = static_cast<Pixel>(i[k]);
#endif
}

constexpr int kCacheLineBytes = 64;

}  // namespace
}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
