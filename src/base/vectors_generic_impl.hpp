// Types of vectors, and the operations in plain loops and the compiler's own vectors: for architectures without a
// header of their own, and for sets that have nothing faster (see vectors_impl.hpp).
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

constexpr int kLanes = GYRO_DEBLUR_VECTOR_BYTES / 4;
constexpr int kDoubleLanes = GYRO_DEBLUR_VECTOR_BYTES / 8;

typedef float Vector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));
typedef double DoubleVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));
typedef std::int32_t IntVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));
typedef std::uint8_t ByteVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));
typedef float FourFloats __attribute__((vector_size(16)));

template <typename T>
inline T load_as(const void* from) {
  T v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline Vector load(const float* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline DoubleVector load(const double* from) { return load_as<DoubleVector>(from); }
inline IntVector load(const std::int32_t* from) { return load_as<IntVector>(from); }
inline void store(float* to, Vector v) { std::memcpy(to, &v, sizeof v); }
inline void store(double* to, DoubleVector v) { std::memcpy(to, &v, sizeof v); }

constexpr int kCacheLineBytes = 64;
inline int round_up(int n, int step) { return (n + step - 1) / step * step; }
inline int clamp_to(int i, int count) { return i < 0 ? 0 : (i >= count ? count - 1 : i); }

/// Sums of all lanes, from the first to the last.
inline float reduce_add(Vector v) {
  float sum = 0;
  for (int i = 0; i < kLanes; ++i) sum += v[i];
  return sum;
}
inline double reduce_add(DoubleVector v) {
  double sum = 0;
  for (int i = 0; i < kDoubleLanes; ++i) sum += v[i];
  return sum;
}

/// Makes truncation round, and clips to the pixel type.
template <typename Pixel>
inline Vector clip_for_truncation(Vector v) {
  Vector zero = {}, top = zero + (sizeof(Pixel) == 1 ? 255.0f : 65535.0f);
  v = v + 0.5f;
  v = v > zero ? v : zero;
  return v < top ? v : top;
}

namespace generic {

constexpr int kRegisters = 16;  // vectors that the processor holds

/// kLanes pixels as floats.
template <typename Pixel>
inline Vector load_pixels(const Pixel* from) {
  Vector v;
  for (int i = 0; i < kLanes; ++i) v[i] = from[i];
  return v;
}

/// Rounds, clips to the pixel type, and stores kLanes pixels.
template <typename Pixel>
inline void store_pixels(Pixel* to, Vector v) {
  const IntVector i = __builtin_convertvector(clip_for_truncation<Pixel>(v), IntVector);
  for (int k = 0; k < kLanes; ++k) to[k] = static_cast<Pixel>(i[k]);
}

using Pair = std::int32_t;
/// A pixel and the next one, as what add_pairs() reads.
inline Pair pair_at(const std::uint8_t* from) { return from[0] | (from[1] << 16); }
/// The same of any two pixels.
inline Pair pair_of(const std::uint8_t* first, const std::uint8_t* second) { return *first | (*second << 16); }
/// Pairs of kLanes pixels and as many others.
inline void store_pairs(Pair* to, const std::uint8_t* first, const std::uint8_t* second) {
  typedef std::uint8_t Pixels __attribute__((vector_size(kLanes)));
  typedef std::int16_t Words __attribute__((vector_size(2 * kLanes)));
  // One size at a time: compilers take wider steps lane by lane.
  const IntVector low = __builtin_convertvector(__builtin_convertvector(load_as<Pixels>(first), Words), IntVector),
                  high = __builtin_convertvector(__builtin_convertvector(load_as<Pixels>(second), Words), IntVector),
                  pairs = low | (high << 16);
  std::memcpy(to, &pairs, sizeof pairs);
}
/// acc + low half of `weights` * pixel + high half * next pixel, of kLanes pairs.
inline IntVector add_pairs(IntVector acc, const Pair* from, std::int32_t weights) {
  const IntVector pixels = load(from), pair = IntVector{} + weights, low = (pair << 16) >> 16, high = pair >> 16;
  return acc + (pixels & 0xffff) * low + (pixels >> 16) * high;
}
/// The same where the second pixel of a pair is the first of the one `next` farther.
inline IntVector add_pairs(IntVector acc, const Pair* from, std::ptrdiff_t, std::int32_t weights) {
  return add_pairs(acc, from, weights);
}

/// Elements of a window of 2 kLanes + 4 by their index, below 1.5 kLanes + 4.
inline Vector pick(const float* window, IntVector index) {
  Vector v;
  for (int i = 0; i < kLanes; ++i) v[i] = window[index[i]];
  return v;
}

/// 1 / v to 2^-14 at least; anything where v is 0.
inline Vector reciprocal(Vector v) { return 1 / v; }

/// Sums of the lanes of each of four vectors: adding those of one vector after the other would take most of the time.
inline FourFloats reduce_add_four(const FourFloats* vectors) {
  FourFloats sums;
  for (int i = 0; i < 4; ++i) sums[i] = (vectors[i][0] + vectors[i][1]) + (vectors[i][2] + vectors[i][3]);
  return sums;
}

/// Transposes a square of kLanes floats a side, whose rows are aligned to 16 bytes.
inline void transpose_floats(const float* from, std::ptrdiff_t from_stride, float* to, std::ptrdiff_t to_stride) {
  for (int y = 0; y < kLanes; ++y) {
    for (int x = 0; x < kLanes; ++x) to[x * to_stride + y] = from[y * from_stride + x];
  }
}

/// Loads kLanes pairs: first elements, and second ones.
inline void load_interleaved(const float* from, Vector& even, Vector& odd) {
  for (int i = 0; i < kLanes; ++i) {
    even[i] = from[2 * i];
    odd[i] = from[2 * i + 1];
  }
}

/// Stores elements of two vectors in turn.
inline void store_interleaved(float* to, Vector even, Vector odd) {
  for (int i = 0; i < kLanes; ++i) {
    to[2 * i] = even[i];
    to[2 * i + 1] = odd[i];
  }
}

/// Transposes 8x8 bytes.
inline void transpose_bytes(const std::uint8_t* from, std::ptrdiff_t from_stride, std::uint8_t* to,
                            std::ptrdiff_t to_stride) {
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 8; ++x) to[x * to_stride + y] = from[y * from_stride + x];
  }
}

/// Copies `columns` columns, a multiple of 64, of the rows of a window (first_m, first_n, rows) of an image of bytes to
/// rows of `stride` bytes. Outside of the image its edge pixels go on.
template <typename Image, typename Window>
inline void copy_extended(const Image& image, const Window& window, int columns, std::uint8_t* to, int stride) {
  const int n = window.first_n;
  const auto row_at = [&](int r) { return image.origin + clamp_to(window.first_m + r, image.rows) * image.stride; };
  const int before = n >= 0 ? 0 : (-n < columns ? -n : columns), end = image.cols - n;
  const int inside = (end < before ? before : (end < columns ? end : columns)) - before;
  for (int r = 0; r < window.rows; ++r, to += stride) {
    const std::uint8_t* row = row_at(r);
    if (before > 0) std::memset(to, row[0], before);
    std::memcpy(to + before, row + n + before, inside);
    if (before + inside < columns) std::memset(to + before + inside, row[image.cols - 1], columns - before - inside);
  }
}

}  // namespace generic

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
