// Bodies of the loops that align blurred patches, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "features/alignment_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

/// A row of the interpolation's table, whatever the processor's vectors are.
typedef float Taps __attribute__((vector_size(4 * kInterpolationStride)));
static_assert(kInterpolationStride == 8, "two halves");
static_assert(kLanes <= kPatchRoom, "whole vectors are read and written");

void widen(const unsigned char* bytes, std::ptrdiff_t byte_stride, float* written, std::ptrdiff_t stride, int width,
           int height) {
  typedef unsigned char Pixels __attribute__((vector_size(kLanes)));
  typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes)));
  for (int y = 0; y < height; ++y) {
    const unsigned char* from = bytes + y * byte_stride;
    float* to = written + y * stride;
    if (width < kLanes) {
      for (int x = 0; x < width; ++x) to[x] = from[x];
      continue;
    }
    // The last vector overlaps the one before: nothing is read beyond the image.
    for (int x = 0; x < width; x += kLanes) {
      const int at = x + kLanes <= width ? x : width - kLanes;
      const Pixels values = load_as<Pixels>(from + at);
      // One size at a time: compilers take wider steps lane by lane.
      const IntVector wide = __builtin_convertvector(__builtin_convertvector(values, Shorts), IntVector);
      store(to + at, __builtin_convertvector(wide, Vector));
    }
  }
}

/// Two rows at a time: independent sums hide the latency of each.
template <int kVectors>
inline void convolve_strip(const float* read, std::ptrdiff_t read_stride, const int* offsets, const float* shares,
                           int taps, float* written, std::ptrdiff_t stride, int height) {
  for (int y = 0; y < height; y += 2) {
    const int second = y + 1 < height ? y + 1 : y;
    const float *upper = read + y * read_stride, *lower = read + second * read_stride;
    Vector above[kVectors] = {}, below[kVectors] = {};
    for (int k = 0; k < taps; ++k) {
      const float share = shares[k];
      const int offset = offsets[k];
      for (int i = 0; i < kVectors; ++i) {
        above[i] += share * load(upper + offset + i * kLanes);
        below[i] += share * load(lower + offset + i * kLanes);
      }
    }
    for (int i = 0; i < kVectors; ++i) {
      store(written + y * stride + i * kLanes, above[i]);
      store(written + second * stride + i * kLanes, below[i]);
    }
  }
}

void convolve(const float* read, std::ptrdiff_t read_stride, const int* offsets, const float* shares, int taps,
              float* written, std::ptrdiff_t stride, int width, int height) {
  int x = 0;
  for (int left = (width + kLanes - 1) / kLanes; left > 0;) {
    const int vectors = left > 4 ? 3 : left;
    const auto strip = vectors == 1   ? convolve_strip<1>
                       : vectors == 2 ? convolve_strip<2>
                       : vectors == 3 ? convolve_strip<3>
                                      : convolve_strip<4>;
    strip(read + x, read_stride, offsets, shares, taps, written + x, stride, height);
    x += vectors * kLanes;
    left -= vectors;
  }
}

void sort_by_two(const float* __restrict pixels, float* __restrict sorted, int count) {
  for (int i = 0; i < count; ++i) {
    sorted[i] = pixels[2 * i];
    sorted[count + i] = pixels[2 * i + 1];
  }
}

void sort_by_three(const float* __restrict pixels, float* __restrict sorted, int count) {
  for (int i = 0; i < count; ++i) {
    sorted[i] = pixels[3 * i];
    sorted[count + i] = pixels[3 * i + 1];
    sorted[2 * count + i] = pixels[3 * i + 2];
  }
}

/// Interpolated at a pixel but for the sum of its lanes.
inline FourFloats interpolate(const float* pixels, std::ptrdiff_t stride, const float* table, float at_x, float at_y) {
  const int left = static_cast<int>(at_x), top = static_cast<int>(at_y);
  const int step_x = static_cast<int>((at_x - static_cast<float>(left)) * kInterpolationSteps + 0.5f),
            step_y = static_cast<int>((at_y - static_cast<float>(top)) * kInterpolationSteps + 0.5f);
  const float *across = table + step_x * kInterpolationStride, *down = table + step_y * kInterpolationStride,
              *row = pixels + top * stride + left;
  Taps even = {}, odd = {}, values, weights;
  for (int j = 0; j < kInterpolationTaps; j += 2, row += 2 * stride) {
    std::memcpy(&values, row, sizeof values);
    even += down[j] * values;
    std::memcpy(&values, row + stride, sizeof values);
    odd += down[j + 1] * values;
  }
  std::memcpy(&weights, across, sizeof weights);
  const Taps products = (even + odd) * weights;
  FourFloats halves[2];
  std::memcpy(halves, &products, sizeof products);
  return halves[0] + halves[1];
}

void sample_row(const float* pixels, std::ptrdiff_t stride, const float* table, float x, float y, float dx, float dy,
                int count, float* sampled) {
  constexpr int kAtATime = 4;
  for (int i = 0; i < count; i += kAtATime) {
    const int left = count - i < kAtATime ? count - i : kAtATime;
    FourFloats lanes[kAtATime];
    for (int j = 0; j < kAtATime; ++j) {
      const auto at = static_cast<float>(i + (j < left ? j : 0));
      lanes[j] = interpolate(pixels, stride, table, x + at * dx, y + at * dy);
    }
    const FourFloats sums = reduce_add_four(lanes);
    std::memcpy(sampled + i, &sums, static_cast<std::size_t>(left) * sizeof(float));
  }
}

/// H. Scharr's filters: (-1 0 1) / 2 along the axis, (3 10 3) / 16 across it.
void differentiate(const float* patch, std::ptrdiff_t patch_stride, float* along_x, float* along_y,
                   std::ptrdiff_t stride, int width, int height) {
  constexpr float kMiddle = 10.0f / 32, kSide = 3.0f / 32;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; x += kLanes) {
      const float *middle = patch + y * patch_stride + x, *above = middle - patch_stride,
                  *below = middle + patch_stride;
      const Vector falling = load(below + 1) - load(above - 1), rising = load(above + 1) - load(below - 1);
      const Vector across = load(middle + 1) - load(middle - 1), down = load(below) - load(above);
      store(along_x + y * stride + x, kMiddle * across + kSide * (falling + rising));
      store(along_y + y * stride + x, kMiddle * down + kSide * (falling - rising));
    }
    for (int x = width; x % kLanes != 0; ++x) along_x[y * stride + x] = along_y[y * stride + x] = 0;
  }
}

/// 1 in the lanes that are left of a row, 0 in the others.
inline Vector lanes_left(int count) {
  static const float kMask[2 * kPatchRoom] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
  return load(kMask + kPatchRoom - (count < kLanes ? count : kLanes));
}

void compare(const float* patch, std::ptrdiff_t patch_stride, float offset, const float* other, std::ptrdiff_t stride,
             int width, int height, float* sums) {
  Vector first = {}, product = {}, second = {};
  for (int x = 0; x < width; x += kLanes) {
    const Vector mask = lanes_left(width - x);
    for (int y = 0; y < height; ++y) {
      const Vector value = mask * (load(patch + y * patch_stride + x) - offset);
      first += value;
      product += value * load(other + y * stride + x);
      second += value * value;
    }
  }
  sums[0] = reduce_add(first);
  sums[1] = reduce_add(product);
  sums[2] = reduce_add(second);
}

void combine(const float* a, std::ptrdiff_t a_stride, float scale_a, const float* b, std::ptrdiff_t b_stride,
             float scale_b, float offset, float* written, std::ptrdiff_t stride, int width, int height) {
  for (int x = 0; x < width; x += kLanes) {
    const Vector mask = lanes_left(width - x);
    for (int y = 0; y < height; ++y) {
      store(written + y * stride + x,
            mask * (scale_a * load(a + y * a_stride + x) + scale_b * load(b + y * b_stride + x) + offset));
    }
  }
}

void project(const float* patch, std::ptrdiff_t patch_stride, const float* const* factors, std::ptrdiff_t stride,
             int width, int height, float* sums) {
  Vector first = {}, second = {}, third = {};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; x += kLanes) {
      const std::ptrdiff_t at = y * stride + x;
      const Vector value = load(patch + y * patch_stride + x);
      first += value * load(factors[0] + at);
      second += value * load(factors[1] + at);
      third += value * load(factors[2] + at);
    }
  }
  sums[0] = reduce_add(first);
  sums[1] = reduce_add(second);
  sums[2] = reduce_add(third);
}

void multiply_by_derivatives(const float* ax, const float* ay, std::ptrdiff_t stride, const float* patch,
                             std::ptrdiff_t patch_stride, int width, int height, float* sums) {
  constexpr float kNear = 8.0f / 12, kFar = 1.0f / 12;
  Vector xx = {}, xy = {}, yy = {};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; x += kLanes) {
      const std::ptrdiff_t at = y * stride + x;
      const float* value = patch + y * patch_stride + x;
      const Vector second_x = kNear * (load(value + 1) - load(value - 1)) - kFar * (load(value + 2) - load(value - 2)),
                   second_y = kNear * (load(value + patch_stride) - load(value - patch_stride)) -
                              kFar * (load(value + 2 * patch_stride) - load(value - 2 * patch_stride));
      const Vector first_x = load(ax + at), first_y = load(ay + at);
      xx += first_x * second_x;
      xy += first_x * second_y + first_y * second_x;
      yy += first_y * second_y;
    }
  }
  sums[0] = reduce_add(xx);
  sums[1] = reduce_add(xy);
  sums[2] = reduce_add(yy);
}

void multiply_gradients(const float* ax, const float* ay, const float* bx, const float* by, std::ptrdiff_t stride,
                        int width, int height, float* sums) {
  Vector xx = {}, xy = {}, yy = {};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; x += kLanes) {
      const std::ptrdiff_t at = y * stride + x;
      const Vector first_x = load(ax + at), first_y = load(ay + at), second_x = load(bx + at), second_y = load(by + at);
      xx += first_x * second_x;
      xy += first_x * second_y + first_y * second_x;
      yy += first_y * second_y;
    }
  }
  sums[0] = reduce_add(xx);
  sums[1] = reduce_add(xy);
  sums[2] = reduce_add(yy);
}

}  // namespace

extern const AlignmentSimd kAlignmentSimd;
const AlignmentSimd kAlignmentSimd = {
    GYRO_DEBLUR_ISA_NAME, widen,   convolve, sort_by_two, sort_by_three,           sample_row,
    differentiate,        compare, combine,  project,     multiply_by_derivatives, multiply_gradients};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
