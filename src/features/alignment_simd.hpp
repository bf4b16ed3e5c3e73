// The loops that the alignment of blurred patches spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstddef>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Floats that may be read, and written, beyond the end of a row of a patch.
constexpr int kPatchRoom = 16;

/// Pixels that interpolation takes along each axis; rows of its table have room for a whole vector.
constexpr int kInterpolationTaps = 6, kInterpolationStride = 8, kInterpolationSteps = 1024;

/// The functions of one instruction set. Strides are in floats.
struct AlignmentSimd {
  const char* name;
  /// Bytes as floats.
  void (*widen)(const unsigned char* bytes, std::ptrdiff_t byte_stride, float* written, std::ptrdiff_t stride,
                int width, int height);
  /// written(x, y) = sum of shares[k] * read[offsets[k] + x + y * read_stride] over k < taps, for x < width.
  void (*convolve)(const float* read, std::ptrdiff_t read_stride, const int* offsets, const float* shares, int taps,
                   float* written, std::ptrdiff_t stride, int width, int height);
  /// sorted[k count + i] = pixels[n i + k] for i < count and k < n, where n is 2 or 3.
  void (*sort_by_two)(const float* pixels, float* sorted, int count);
  void (*sort_by_three)(const float* pixels, float* sorted, int count);
  /// sampled[i] for i < count, at the pixel (x + i dx, y + i dy), both >= 0, with weights for the pixels from (0, 0)
  /// on.
  /// @param table  kInterpolationSteps + 1 rows of kInterpolationStride weights, by the fraction of a pixel; the last
  ///               two of each row are 0
  void (*sample_row)(const float* pixels, std::ptrdiff_t stride, const float* table, float x, float y, float dx,
                     float dy, int count, float* sampled);
  /// Derivatives along x and y at width * height pixels by Scharr's filters, which read a pixel on either side. What
  /// is written beyond the end of a row is 0.
  void (*differentiate)(const float* patch, std::ptrdiff_t patch_stride, float* along_x, float* along_y,
                        std::ptrdiff_t stride, int width, int height);
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
