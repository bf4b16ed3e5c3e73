// The loops that the alignment of blurred patches spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Floats that may be read, and written, beyond the end of a row of a patch.
constexpr int kPatchRoom = 16;

/// Pixels that interpolation takes along each axis; rows of its table have room for a whole vector.
constexpr int kInterpolationTaps = 6, kInterpolationStride = 8, kInterpolationSteps = 1024;

/// Weights of pixels for a place between them, as a table and as polynomials.
struct Interpolation {
  /// kInterpolationSteps + 1 rows of kInterpolationStride weights, by the fraction of a pixel; the last two of each row
  /// are 0.
  const float* table;
  /// Coefficients of 1, s^2, s^4 and of s, s^3, s^5, where s is the fraction less a half. The weight of the k-th pixel
  /// is even less odd, that of the k-th from the end even and odd.
  float even[kInterpolationTaps / 2][3], odd[kInterpolationTaps / 2][3];
};

/// Rows of places between pixels. The i-th place of the k-th row has the first pixel that its interpolation takes at
/// (x + i dx + k row_dx, y + i dy + k row_dy), rounded down, and its fraction of a pixel is that of these. All of them
/// are >= 0 along x and >= 1 along y. Up to a row more is read above and below, and up to a column more on the right.
struct SampleGrid {
  int width, height;
  float x, y, dx, dy, row_dx, row_dy;
};

/// The functions of one instruction set. Strides are in floats.
struct AlignmentSimd {
  const char* name;
  /// Pairs of bytes, each with the one that is `next` bytes farther. Nothing else is read.
  /// @param next    1 or byte_stride
  /// @param pairs   room for `height` + 1 rows of `stride` pairs, and kPatchRoom more, of 4 bytes each; in a form that
  ///                convolve_pairs() alone knows
  /// @param stride  of pairs; `width` + kPatchRoom at least
  void (*make_pairs)(const unsigned char* bytes, std::ptrdiff_t byte_stride, std::ptrdiff_t next, void* pairs,
                     std::ptrdiff_t stride, int width, int height);
  /// written(x, y) = scale * sum over k < taps of the pair offsets[k] + x + y * pair_stride times weights[k], for
  /// x < width: its first byte times the low half of the weight, its second one times the high half, both signed. The
  /// sums are below 2^31.
  /// @param next  1 where the second byte of a pair is the first of the next in a row, pair_stride where it is that of
  ///              the pair in the next row
  void (*convolve_pairs)(const void* pairs, std::ptrdiff_t pair_stride, std::ptrdiff_t next, const int* offsets,
                         const std::int32_t* weights, int taps, float scale, float* written, std::ptrdiff_t stride,
                         int width, int height);
  /// written(x, y) = sum of shares[k] * read[offsets[k] + x + y * read_stride] over k < taps, for x < width.
  void (*convolve)(const float* read, std::ptrdiff_t read_stride, const int* offsets, const float* shares, int taps,
                   float* written, std::ptrdiff_t stride, int width, int height);
  /// sorted[k count + i] = pixels[n i + k] for i < count and k < n, where n is 2 or 3.
  void (*sort_by_two)(const float* pixels, float* sorted, int count);
  void (*sort_by_three)(const float* pixels, float* sorted, int count);
  /// Pixels at the places of a grid. What is written beyond the end of a row, within kPatchRoom, is finite.
  void (*sample)(const float* pixels, std::ptrdiff_t stride, const Interpolation& interpolation, const SampleGrid& grid,
                 float* sampled, std::ptrdiff_t sampled_stride);
  /// Derivatives along x and y at width * height pixels by Scharr's filters, which read a pixel on either side. What
  /// is written beyond the end of a row is 0.
  void (*differentiate)(const float* patch, std::ptrdiff_t patch_stride, float* along_x, float* along_y,
                        std::ptrdiff_t stride, int width, int height);
  /// Moves what a patch shows at (u, v), which is (x, y) less the middle, along x by the sum of b[0], b[2] and b[4]
  /// times u^2, u v and v^2, and along y by that of b[1], b[3] and b[5] times these. To first order: they are
  /// multiplied by the derivatives and taken off. Reads a pixel on either side. What is written beyond the end of a row
  /// is finite.
  void (*displace)(const float* patch, std::ptrdiff_t patch_stride, const float* b, float middle_x, float middle_y,
                   float* displaced, std::ptrdiff_t stride, int width, int height);
  /// Sums of p, p t and p^2, where p is `patch` less `offset`. After each row of `other` (t) kPatchRoom
  /// pixels are 0, of the patch finite.
  void (*compare)(const float* patch, std::ptrdiff_t patch_stride, float offset, const float* other,
                  std::ptrdiff_t stride, int width, int height, float* sums);
  /// written = scale_a * a + scale_b * b + offset. What is written beyond the end of a row is 0.
  void (*combine)(const float* a, std::ptrdiff_t a_stride, float scale_a, const float* b, std::ptrdiff_t b_stride,
                  float scale_b, float offset, float* written, std::ptrdiff_t stride, int width, int height);
  /// sums[i] = sum of patch * factors[i] for i < 3. `factors` are 0 on kPatchRoom pixels after each of their rows,
  /// where `patch` is finite.
  void (*project)(const float* patch, std::ptrdiff_t patch_stride, const float* const* factors, std::ptrdiff_t stride,
                  int width, int height, float* sums);
  /// Sums of ax bx, ax by + ay bx, and ay by, where b are derivatives of a patch by five-point differences, which read
  /// two pixels on either side. After each of their rows kPatchRoom pixels of `ax` and `ay` are 0, those of the patch
  /// finite.
  void (*multiply_by_derivatives)(const float* ax, const float* ay, std::ptrdiff_t stride, const float* patch,
                                  std::ptrdiff_t patch_stride, int width, int height, float* sums);
  /// Sums of ax bx, ax by + ay bx, and ay by. After each row kPatchRoom pixels of `a` or of `b` are 0, the others
  /// finite.
  void (*multiply_gradients)(const float* ax, const float* ay, const float* bx, const float* by, std::ptrdiff_t stride,
                             int width, int height, float* sums);
};

GYRO_DEBLUR_SIMD_KERNELS(AlignmentSimd)

}  // namespace gyro_deblur
