// The operations of vectors_generic_impl.hpp with SSE2, AVX2 and AVX-512 (see vectors_impl.hpp).
#pragma once

#include <immintrin.h>

#include "base/vectors_generic_impl.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

constexpr int kRegisters = kLanes == 16 ? 32 : 16;

template <typename Pixel>
inline Vector load_pixels(const Pixel* from) {
#if defined(__AVX512F__)
  return (Vector)_mm512_cvtepi32_ps(sizeof(Pixel) == 1
                                        ? _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)from))
                                        : _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i*)from)));
#elif defined(__AVX2__)
  return (Vector)_mm256_cvtepi32_ps(sizeof(Pixel) == 1 ? _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)from))
                                                       : _mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i*)from)));
#else
  const __m128i zero = _mm_setzero_si128();
  std::int64_t bits = 0;
  std::memcpy(&bits, from, 4 * sizeof(Pixel));
  const __m128i pixels = _mm_cvtsi64_si128(bits), words = sizeof(Pixel) == 1 ? _mm_unpacklo_epi8(pixels, zero) : pixels;
  return (Vector)_mm_cvtepi32_ps(_mm_unpacklo_epi16(words, zero));
#endif
}

template <typename Pixel>
inline void store_pixels(Pixel* to, Vector v) {
  const Vector clipped = clip_for_truncation<Pixel>(v);
#if defined(__AVX512F__)
  const __m512i i = _mm512_cvttps_epi32((__m512)clipped);
  if (sizeof(Pixel) == 1) {
    _mm_storeu_si128((__m128i*)to, _mm512_cvtepi32_epi8(i));
  } else {
    _mm256_storeu_si256((__m256i*)to, _mm512_cvtepi32_epi16(i));
  }
#else
#if defined(__AVX2__)
  const __m256i i = _mm256_cvttps_epi32((__m256)clipped);
  const __m128i words = _mm_packus_epi32(_mm256_castsi256_si128(i), _mm256_extracti128_si256(i, 1));
#else
  // There is no instruction for unsigned words: less 2^15 they are signed.
  const __m128i i = _mm_sub_epi32(_mm_cvttps_epi32((__m128)clipped), _mm_set1_epi32(1 << 15));
  const __m128i words = _mm_xor_si128(_mm_packs_epi32(i, i), _mm_set1_epi16(static_cast<short>(-32768)));
#endif
  const __m128i pixels = sizeof(Pixel) == 1 ? _mm_packus_epi16(words, words) : words;
  std::memcpy(to, &pixels, kLanes * sizeof(Pixel));
#endif
}

/// acc + low * low + high * high of the int16 halves of each lane.
inline IntVector multiply_pairs(IntVector acc, IntVector pixels, IntVector weights) {
#if defined(__AVX512VNNI__)
  return (IntVector)_mm512_dpwssd_epi32((__m512i)acc, (__m512i)pixels, (__m512i)weights);
#elif defined(__AVX2__)
  return acc + (IntVector)_mm256_madd_epi16((__m256i)pixels, (__m256i)weights);
#else
  return acc + (IntVector)_mm_madd_epi16((__m128i)pixels, (__m128i)weights);
#endif
}

using generic::Pair;
using generic::pair_at;
using generic::pair_of;
inline void store_pairs(Pair* to, const std::uint8_t* first, const std::uint8_t* second) {
#if defined(__AVX512F__)
  const __m512i low = _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)first)),
                high = _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)second));
  _mm512_storeu_si512(to, _mm512_or_si512(low, _mm512_slli_epi32(high, 16)));
#elif defined(__AVX2__)
  const __m256i low = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)first)),
                high = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)second));
  _mm256_storeu_si256((__m256i*)to, _mm256_or_si256(low, _mm256_slli_epi32(high, 16)));
#else
  const __m128i low = _mm_unpacklo_epi8(_mm_cvtsi32_si128(load_as<int>(first)), _mm_setzero_si128()),
                high = _mm_unpacklo_epi8(_mm_cvtsi32_si128(load_as<int>(second)), _mm_setzero_si128());
  _mm_storeu_si128((__m128i*)to, _mm_unpacklo_epi16(low, high));
#endif
}
inline IntVector add_pairs(IntVector acc, const Pair* from, std::int32_t weights) {
  return multiply_pairs(acc, load(from), IntVector{} + weights);
}
inline IntVector add_pairs(IntVector acc, const Pair* from, std::ptrdiff_t, std::int32_t weights) {
  return add_pairs(acc, from, weights);
}

#if defined(__AVX512VBMI__) && defined(__AVX512VNNI__)
#define GYRO_DEBLUR_HAS_BYTE_PRODUCTS
using Bytes = __m512i;
constexpr int kByteOffset = 0;  // pixels are multiplied less this
inline Bytes load_bytes(const std::uint8_t* from) { return _mm512_loadu_si512(from); }
/// Of two vectors, i, i + 1 of the first and i, i + 1 of the second, for i from `begin` on.
inline Bytes side_by_side(int begin) {
  const IntVector counting = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  return (Bytes)((counting + begin) * 0x01010101 + 0x41400100);
}
/// acc + for each lane four pixels of two vectors, picked by `order`, times the signed bytes of `weights`.
inline IntVector add_byte_products(IntVector acc, Bytes first, Bytes second, Bytes order, std::int32_t weights) {
  return (IntVector)_mm512_dpbusd_epi32((__m512i)acc, _mm512_permutex2var_epi8(first, order, second),
                                        _mm512_set1_epi32(weights));
}
#endif

inline Vector pick(const float* window, IntVector index) {
#if defined(__AVX512F__)
  return (Vector)_mm512_permutex2var_ps((__m512)load(window), (__m512i)index, (__m512)load(window + kLanes));
#elif defined(__AVX2__)
  const __m256 low = _mm256_permutevar8x32_ps((__m256)load(window), (__m256i)index);
  const __m256 high = _mm256_permutevar8x32_ps((__m256)load(window + kLanes), (__m256i)index);
  return (Vector)_mm256_blendv_ps(low, high, (__m256)(index << 28));  // by bit 3
#else
  return generic::pick(window, index);
#endif
}

inline Vector reciprocal(Vector v) {
#if defined(__AVX512F__)
  return (Vector)_mm512_rcp14_ps((__m512)v);
#else
#if defined(__AVX__)
  const Vector guess = (Vector)_mm256_rcp_ps((__m256)v);
#else
  const Vector guess = (Vector)_mm_rcp_ps((__m128)v);
#endif
  return guess * (2 - v * guess);
#endif
}

inline FourFloats reduce_add_four(const FourFloats* vectors) {
#if defined(__SSE3__)
  return (FourFloats)_mm_hadd_ps(_mm_hadd_ps((__m128)vectors[0], (__m128)vectors[1]),
                                 _mm_hadd_ps((__m128)vectors[2], (__m128)vectors[3]));
#else
  return generic::reduce_add_four(vectors);
#endif
}

inline void load_interleaved(const float* from, Vector& even, Vector& odd) {
  const Vector a = load(from), b = load(from + kLanes);
#if defined(__AVX512F__)
  const IntVector evens = {0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30};
  even = (Vector)_mm512_permutex2var_ps((__m512)a, (__m512i)evens, (__m512)b);
  odd = (Vector)_mm512_permutex2var_ps((__m512)a, (__m512i)(evens + 1), (__m512)b);
#elif defined(__AVX2__)
  // By halves, in the order first, third, second, fourth quarter.
  const __m256 evens = _mm256_shuffle_ps((__m256)a, (__m256)b, 0x88),
               odds = _mm256_shuffle_ps((__m256)a, (__m256)b, 0xDD);
  even = (Vector)_mm256_permute4x64_pd((__m256d)evens, 0xD8);
  odd = (Vector)_mm256_permute4x64_pd((__m256d)odds, 0xD8);
#else
  even = (Vector)_mm_shuffle_ps((__m128)a, (__m128)b, 0x88);
  odd = (Vector)_mm_shuffle_ps((__m128)a, (__m128)b, 0xDD);
#endif
}

inline void store_interleaved(float* to, Vector even, Vector odd) {
#if defined(__AVX512F__)
  const IntVector pairs = {0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23};
  const __m512 first = _mm512_permutex2var_ps((__m512)even, (__m512i)pairs, (__m512)odd);
  const __m512 second = _mm512_permutex2var_ps((__m512)even, (__m512i)(pairs + 8), (__m512)odd);
#elif defined(__AVX2__)
  const __m256 low = _mm256_unpacklo_ps((__m256)even, (__m256)odd),
               high = _mm256_unpackhi_ps((__m256)even, (__m256)odd);
  const __m256 first = _mm256_permute2f128_ps(low, high, 0x20), second = _mm256_permute2f128_ps(low, high, 0x31);
#else
  const __m128 first = _mm_unpacklo_ps((__m128)even, (__m128)odd), second = _mm_unpackhi_ps((__m128)even, (__m128)odd);
#endif
  store(to, (Vector)first);
  store(to + kLanes, (Vector)second);
}

/// Four floats of every fourth row, from row `from` on, one after the other.
inline Vector load_quarters(const float* from, std::ptrdiff_t stride) {
#if defined(__AVX512F__)
  __m512 v = _mm512_castps128_ps512(_mm_load_ps(from));
  v = _mm512_insertf32x4(v, _mm_load_ps(from + 4 * stride), 1);
  v = _mm512_insertf32x4(v, _mm_load_ps(from + 8 * stride), 2);
  return (Vector)_mm512_insertf32x4(v, _mm_load_ps(from + 12 * stride), 3);
#elif defined(__AVX2__)
  return (Vector)_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(from)), _mm_load_ps(from + 4 * stride), 1);
#else
  static_cast<void>(stride);
  return load(from);
#endif
}

inline Vector unpack_low(Vector a, Vector b) {
#if defined(__AVX512F__)
  return (Vector)_mm512_unpacklo_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
  return (Vector)_mm256_unpacklo_ps((__m256)a, (__m256)b);
#else
  return (Vector)_mm_unpacklo_ps((__m128)a, (__m128)b);
#endif
}

inline Vector unpack_high(Vector a, Vector b) {
#if defined(__AVX512F__)
  return (Vector)_mm512_unpackhi_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
  return (Vector)_mm256_unpackhi_ps((__m256)a, (__m256)b);
#else
  return (Vector)_mm_unpackhi_ps((__m128)a, (__m128)b);
#endif
}

inline Vector unpack_low_pairs(Vector a, Vector b) {
#if defined(__AVX512F__)
  return (Vector)_mm512_unpacklo_pd((__m512d)a, (__m512d)b);
#elif defined(__AVX2__)
  return (Vector)_mm256_unpacklo_pd((__m256d)a, (__m256d)b);
#else
  return (Vector)_mm_unpacklo_pd((__m128d)a, (__m128d)b);
#endif
}

inline Vector unpack_high_pairs(Vector a, Vector b) {
#if defined(__AVX512F__)
  return (Vector)_mm512_unpackhi_pd((__m512d)a, (__m512d)b);
#elif defined(__AVX2__)
  return (Vector)_mm256_unpackhi_pd((__m256d)a, (__m256d)b);
#else
  return (Vector)_mm_unpackhi_pd((__m128d)a, (__m128d)b);
#endif
}

/// Squares of four, one for each quarter of a vector: whole vectors are stored.
inline void transpose_floats(const float* from, std::ptrdiff_t from_stride, float* to, std::ptrdiff_t to_stride) {
  for (int x = 0; x < kLanes; x += 4, to += 4 * to_stride) {
    const Vector a = load_quarters(from + x, from_stride), b = load_quarters(from + from_stride + x, from_stride),
                 c = load_quarters(from + 2 * from_stride + x, from_stride),
                 d = load_quarters(from + 3 * from_stride + x, from_stride);
    const Vector ab_low = unpack_low(a, b), ab_high = unpack_high(a, b);
    const Vector cd_low = unpack_low(c, d), cd_high = unpack_high(c, d);
    store(to, unpack_low_pairs(ab_low, cd_low));
    store(to + to_stride, unpack_high_pairs(ab_low, cd_low));
    store(to + 2 * to_stride, unpack_low_pairs(ab_high, cd_high));
    store(to + 3 * to_stride, unpack_high_pairs(ab_high, cd_high));
  }
}

inline void transpose_bytes(const std::uint8_t* from, std::ptrdiff_t from_stride, std::uint8_t* to,
                            std::ptrdiff_t to_stride) {
  const auto pair = [&](int row) {
    return _mm_unpacklo_epi8(_mm_loadl_epi64((const __m128i*)(from + row * from_stride)),
                             _mm_loadl_epi64((const __m128i*)(from + (row + 1) * from_stride)));
  };
  const __m128i a = pair(0), b = pair(2), c = pair(4), d = pair(6);
  const __m128i ab_low = _mm_unpacklo_epi16(a, b), ab_high = _mm_unpackhi_epi16(a, b);
  const __m128i cd_low = _mm_unpacklo_epi16(c, d), cd_high = _mm_unpackhi_epi16(c, d);
  const __m128i columns[] = {_mm_unpacklo_epi32(ab_low, cd_low), _mm_unpackhi_epi32(ab_low, cd_low),
                             _mm_unpacklo_epi32(ab_high, cd_high), _mm_unpackhi_epi32(ab_high, cd_high)};
  for (int i = 0; i < 4; ++i) {
    _mm_storel_epi64((__m128i*)(to + 2 * i * to_stride), columns[i]);
    _mm_storel_epi64((__m128i*)(to + (2 * i + 1) * to_stride), _mm_srli_si128(columns[i], 8));
  }
}

#if defined(__AVX512BW__)
// Masked at edges: with long taps that is every third tile of a small image.
template <typename Image, typename Window>
inline void copy_extended(const Image& image, const Window& window, int columns, std::uint8_t* to, int stride) {
  const int n = window.first_n;
  const auto row_at = [&](int r) { return image.origin + clamp_to(window.first_m + r, image.rows) * image.stride; };
  const auto bits_below = [](int end) { return end <= 0 ? 0 : end >= 64 ? ~0ull : (1ull << end) - 1; };
  for (int i = 0; i < columns; i += 64) {
    const __mmask64 before = bits_below(-n - i), inside = bits_below(image.cols - n - i) & ~before;
    if (inside == ~0ull) {
      for (int r = 0; r < window.rows; ++r)
        _mm512_storeu_si512(to + r * stride + i, _mm512_loadu_si512(row_at(r) + n + i));
      continue;
    }
    const int last = image.cols - 1;
    for (int r = 0; r < window.rows; ++r) {
      const std::uint8_t* row = row_at(r);
      const __m512i edges = _mm512_mask_set1_epi8(_mm512_set1_epi8((char)row[last]), before, (char)row[0]);
      _mm512_storeu_si512(to + r * stride + i, _mm512_mask_loadu_epi8(edges, inside, row + n + i));
    }
  }
}
#else
using generic::copy_extended;
#endif

#if defined(__AVX2__)
#define GYRO_DEBLUR_HAS_WORD_VECTORS
using WordVector = __m256i;  // 16 words, or 8 pairs of them as integers
inline WordVector load_words(const void* from) { return _mm256_loadu_si256((const __m256i*)from); }
inline void store_words(void* to, WordVector v) { _mm256_storeu_si256((__m256i*)to, v); }
inline WordVector repeat_word(std::int16_t word) { return _mm256_set1_epi16(word); }
inline WordVector add_words(WordVector a, WordVector b) { return _mm256_add_epi16(a, b); }
/// Divides unsigned words by 2^count.
inline WordVector shift_words(WordVector v, int count) { return _mm256_srli_epi16(v, count); }
/// low * low + high * high of the bytes of each word; those of `weights` are signed.
inline WordVector multiply_bytes(WordVector pixels, WordVector weights) {
  return _mm256_maddubs_epi16(pixels, weights);
}
/// Two words, eight times.
inline WordVector repeat_pair(std::int32_t pair) { return _mm256_set1_epi32(pair); }
inline WordVector add_ints(WordVector a, WordVector b) { return _mm256_add_epi32(a, b); }
/// low * low + high * high of the signed words of each pair.
inline WordVector multiply_words(WordVector a, WordVector b) { return _mm256_madd_epi16(a, b); }

/// Stores the words of `first` and `second` in turn, less 2^15 so that they are signed.
inline void store_signed_pairs(std::int32_t* to, WordVector first, WordVector second) {
  const __m256i sign = _mm256_set1_epi16(static_cast<short>(-32768));
  // In such an order that unpacking, which works within halves, leaves the columns in theirs.
  first = _mm256_permute4x64_epi64(_mm256_xor_si256(first, sign), 0xD8);
  second = _mm256_permute4x64_epi64(_mm256_xor_si256(second, sign), 0xD8);
  _mm256_storeu_si256((__m256i*)to, _mm256_unpacklo_epi16(first, second));
  _mm256_storeu_si256((__m256i*)(to + 8), _mm256_unpackhi_epi16(first, second));
}

/// Rounds 2 kLanes values, saturates them to int16, and stores even and odd ones in turn.
inline void store_interleaved(std::int16_t* to, Vector even, Vector odd) {
#if defined(__AVX512F__)
  const __m512i order = _mm512_broadcast_i32x4(_mm_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15));
  const __m512i packed = _mm512_packs_epi32(_mm512_cvtps_epi32((__m512)even), _mm512_cvtps_epi32((__m512)odd));
  _mm512_storeu_si512(to, _mm512_shuffle_epi8(packed, order));
#else
  const __m256i order =
      _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15));
  const __m256i packed = _mm256_packs_epi32(_mm256_cvtps_epi32((__m256)even), _mm256_cvtps_epi32((__m256)odd));
  _mm256_storeu_si256((__m256i*)to, _mm256_shuffle_epi8(packed, order));
#endif
}

/// Divides 16 values by 2^kShift, clips them to bytes, and stores even and odd ones in turn.
template <int kShift>
inline void store_interleaved(std::uint8_t* to, WordVector even, WordVector odd) {
  const __m256i words = _mm256_blend_epi16(_mm256_srai_epi32(even, kShift), _mm256_srai_epi32(odd, kShift - 16), 0xAA);
  _mm_storeu_si128((__m128i*)to, _mm_packus_epi16(_mm256_castsi256_si128(words), _mm256_extracti128_si256(words, 1)));
}

#endif

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
