// The operations of vectors_generic_impl.hpp on 64-bit ARM, with NEON and, where there is, SDOT (see vectors_impl.hpp).
#pragma once

#include <arm_neon.h>

#include "base/vectors_generic_impl.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

using generic::copy_extended;
using generic::reduce_add_four;
using generic::transpose_floats;

constexpr int kRegisters = 32;

template <typename Pixel>
inline Vector load_pixels(const Pixel* from) {
  std::uint64_t bits = 0;
  std::memcpy(&bits, from, 4 * sizeof(Pixel));
  const uint16x4_t words = sizeof(Pixel) == 1 ? vget_low_u16(vmovl_u8(vcreate_u8(bits))) : vcreate_u16(bits);
  return (Vector)vcvtq_f32_u32(vmovl_u16(words));
}

template <typename Pixel>
inline void store_pixels(Pixel* to, Vector v) {
  const uint16x4_t words = vmovn_u32(vcvtq_u32_f32((float32x4_t)clip_for_truncation<Pixel>(v)));
  if (sizeof(Pixel) == 1) {
    const std::uint32_t four = vget_lane_u32(vreinterpret_u32_u8(vmovn_u16(vcombine_u16(words, words))), 0);
    std::memcpy(to, &four, sizeof four);
  } else {
    std::memcpy(to, &words, sizeof words);
  }
}

// NEON multiplies four pixels of 16 bits by a weight, and adds, in one instruction: a pair is its first pixel, and the
// second one is in the next.
using Pair = std::int16_t;
inline Pair pair_at(const std::uint8_t* from) { return from[0]; }
inline Pair pair_of(const std::uint8_t* first, const std::uint8_t*) { return *first; }
inline void store_pairs(Pair* to, const std::uint8_t* first, const std::uint8_t*) {
  std::uint32_t four;
  std::memcpy(&four, first, sizeof four);
  vst1_s16(to, vreinterpret_s16_u16(vget_low_u16(vmovl_u8(vcreate_u8(four)))));
}
inline IntVector add_pairs(IntVector acc, const Pair* from, std::ptrdiff_t next, std::int32_t weights) {
  const auto low = static_cast<std::int16_t>(weights), high = static_cast<std::int16_t>(weights >> 16);
  const int32x4_t first = vmlal_n_s16((int32x4_t)acc, vld1_s16(from), low);
  return (IntVector)vmlal_n_s16(first, vld1_s16(from + next), high);
}
inline IntVector add_pairs(IntVector acc, const Pair* from, std::int32_t weights) {
  return add_pairs(acc, from, 1, weights);
}

constexpr int kByteOffset = 128;  // products are of signed bytes
#if defined(__ARM_FEATURE_DOTPROD)
#define GYRO_DEBLUR_HAS_BYTE_PRODUCTS
using Bytes = uint8x16_t;
inline Bytes load_bytes(const std::uint8_t* from) { return vld1q_u8(from); }
inline Bytes side_by_side(int begin) {
  const IntVector counting = {0, 1, 2, 3};
  return (Bytes)((counting + begin) * 0x01010101 + 0x11100100);
}
inline IntVector add_byte_products(IntVector acc, Bytes first, Bytes second, Bytes order, std::int32_t weights) {
  const uint8x16x2_t both = {{first, second}};
  return (IntVector)vdotq_s32((int32x4_t)acc, (int8x16_t)vqtbl2q_u8(both, order), (int8x16_t)vdupq_n_s32(weights));
}
#else
#define GYRO_DEBLUR_HAS_BYTE_PAIRS
/// Adds to each lane of up to four vectors its byte and the next, less kByteOffset each, times the low and the high
/// half of `weights`, which are bytes but not -128: two products have 16 bits. Reads 17 bytes.
template <int kVectors>
inline void add_byte_pairs(IntVector (&acc)[kVectors], const std::uint8_t* from, std::int32_t weights) {
  const int8x16_t low = vdupq_n_s8(static_cast<std::int8_t>(weights)),
                  high = vdupq_n_s8(static_cast<std::int8_t>(weights >> 16));
  const int8x16_t first = (int8x16_t)vld1q_u8(from), second = (int8x16_t)vld1q_u8(from + 1);
  const int16x8_t left =
      vmlal_s8(vmull_s8(vget_low_s8(first), vget_low_s8(low)), vget_low_s8(second), vget_low_s8(high));
  acc[0] = (IntVector)vaddw_s16((int32x4_t)acc[0], vget_low_s16(left));
  if constexpr (kVectors > 1) acc[1] = (IntVector)vaddw_high_s16((int32x4_t)acc[1], left);
  if constexpr (kVectors > 2) {
    const int16x8_t right = vmlal_high_s8(vmull_high_s8(first, low), second, high);
    acc[2] = (IntVector)vaddw_s16((int32x4_t)acc[2], vget_low_s16(right));
    if constexpr (kVectors > 3) acc[3] = (IntVector)vaddw_high_s16((int32x4_t)acc[3], right);
  }
}
#endif

inline Vector pick(const float* window, IntVector index) {
  const std::uint8_t* bytes = (const std::uint8_t*)window;
  const uint8x16x3_t all = {{vld1q_u8(bytes), vld1q_u8(bytes + 16), vld1q_u8(bytes + 32)}};
  return (Vector)vqtbl3q_u8(all, (uint8x16_t)(index * 0x04040404 + 0x03020100));
}

inline Vector reciprocal(Vector v) {
  float32x4_t guess = vrecpeq_f32((float32x4_t)v);  // 8 bits, which every step doubles
  guess = vmulq_f32(guess, vrecpsq_f32((float32x4_t)v, guess));
  return (Vector)vmulq_f32(guess, vrecpsq_f32((float32x4_t)v, guess));
}

inline void load_interleaved(const float* from, Vector& even, Vector& odd) {
  const float32x4x2_t both = vld2q_f32(from);
  even = (Vector)both.val[0];
  odd = (Vector)both.val[1];
}

inline void store_interleaved(float* to, Vector even, Vector odd) {
  vst2q_f32(to, float32x4x2_t{{(float32x4_t)even, (float32x4_t)odd}});
}

inline void transpose_bytes(const std::uint8_t* from, std::ptrdiff_t from_stride, std::uint8_t* to,
                            std::ptrdiff_t to_stride) {
  const auto pair = [&](int row) {
    return vreinterpretq_u16_u8(vzip1q_u8(vcombine_u8(vld1_u8(from + row * from_stride), vdup_n_u8(0)),
                                          vcombine_u8(vld1_u8(from + (row + 1) * from_stride), vdup_n_u8(0))));
  };
  const uint16x8_t a = pair(0), b = pair(2), c = pair(4), d = pair(6);
  const uint32x4_t ab_low = vreinterpretq_u32_u16(vzip1q_u16(a, b)), ab_high = vreinterpretq_u32_u16(vzip2q_u16(a, b));
  const uint32x4_t cd_low = vreinterpretq_u32_u16(vzip1q_u16(c, d)), cd_high = vreinterpretq_u32_u16(vzip2q_u16(c, d));
  const uint32x4_t columns[] = {vzip1q_u32(ab_low, cd_low), vzip2q_u32(ab_low, cd_low), vzip1q_u32(ab_high, cd_high),
                                vzip2q_u32(ab_high, cd_high)};
  for (int i = 0; i < 4; ++i) {
    const uint8x16_t both = vreinterpretq_u8_u32(columns[i]);
    vst1_u8(to + 2 * i * to_stride, vget_low_u8(both));
    vst1_u8(to + (2 * i + 1) * to_stride, vget_high_u8(both));
  }
}

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
