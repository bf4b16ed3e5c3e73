// Bodies of the loops that align blurred patches, once per instruction set (see base/vectors_impl.hpp).
#include <type_traits>

#include "base/vectors_impl.hpp"
#include "features/alignment_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

/// A row of the interpolation's table, whatever the processor's vectors are.
typedef float Taps __attribute__((vector_size(4 * kInterpolationStride)));
static_assert(kInterpolationStride == 8, "two halves");
static_assert(kLanes <= kPatchRoom, "whole vectors are read and written");

void make_pairs(const unsigned char* bytes, std::ptrdiff_t byte_stride, std::ptrdiff_t next, void* pairs,
                std::ptrdiff_t stride, int width, int height) {
  // Where a pair has its first pixel alone, the second one of the last is in one more.
  constexpr bool kHaveBoth = sizeof(Pair) == 4;
  const int columns = width + (!kHaveBoth && next == 1 ? 1 : 0), rows = height + (!kHaveBoth && next != 1 ? 1 : 0);
  for (int y = 0; y < rows; ++y) {
    const unsigned char* from = bytes + y * byte_stride;
    Pair* to = static_cast<Pair*>(pairs) + y * stride;
    if (columns < kLanes) {
      for (int x = 0; x < columns; ++x) to[x] = pair_of(from + x, from + x + next);
      continue;
    }
    // The last vector overlaps the one before: nothing is read beyond the image.
    for (int x = 0; x < columns; x += kLanes) {
      const int at = x + kLanes <= columns ? x : columns - kLanes;
      store_pairs(to + at, from + at, from + at + next);
    }
  }
}

/// Calls body(vectors, x) for strips of 1 to 4 vectors, whose number is a constant, from column x on. One at a time
/// waits for its own sums: five are three and two.
template <typename Body>
inline void for_each_strip(int width, Body&& body) {
  int x = 0;
  for (int left = (width + kLanes - 1) / kLanes; left > 0;) {
    const int vectors = left > 4 ? 3 : left;
    if (vectors == 1) body(std::integral_constant<int, 1>(), x);
    if (vectors == 2) body(std::integral_constant<int, 2>(), x);
    if (vectors == 3) body(std::integral_constant<int, 3>(), x);
    if (vectors == 4) body(std::integral_constant<int, 4>(), x);
    x += vectors * kLanes;
    left -= vectors;
  }
}

/// Calls body(rows, y) for 1, 2 or 4 rows, a constant, from row y on: independent sums hide the latency of each. Four
/// share the offsets; vectors of 16 floats gain nothing by them.
template <typename Body>
inline void for_each_rows(int height, Body&& body) {
  int y = 0;
  if constexpr (kRegisters == 32 && kLanes == 4) {
    for (; y + 4 <= height; y += 4) body(std::integral_constant<int, 4>(), y);
  }
  for (; y + 2 <= height; y += 2) body(std::integral_constant<int, 2>(), y);
  if (y < height) body(std::integral_constant<int, 1>(), y);
}

void convolve_pairs(const void* pairs, std::ptrdiff_t pair_stride, std::ptrdiff_t next, const int* offsets,
                    const std::int32_t* weights, int taps, float scale, float* written, std::ptrdiff_t stride,
                    int width, int height) {
  for_each_strip(width, [&](auto vectors, int x) {
    for_each_rows(height, [&](auto rows, int y) {
      constexpr int kRows = decltype(rows)::value, kVectors = decltype(vectors)::value;
      const Pair* first = static_cast<const Pair*>(pairs) + x + y * pair_stride;
      IntVector sums[kRows][kVectors] = {};
      for (int k = 0; k < taps; ++k) {
        const Pair* from = first + offsets[k];
        for (int row = 0; row < kRows; ++row, from += pair_stride) {
          for (int i = 0; i < kVectors; ++i) {
            sums[row][i] = add_pairs(sums[row][i], from + i * kLanes, next, weights[k]);
          }
        }
      }
      float* to = written + x + y * stride;
      for (int row = 0; row < kRows; ++row, to += stride) {
        for (int i = 0; i < kVectors; ++i) {
          store(to + i * kLanes, scale * __builtin_convertvector(sums[row][i], Vector));
        }
      }
    });
  });
}

void convolve(const float* read, std::ptrdiff_t read_stride, const int* offsets, const float* shares, int taps,
              float* written, std::ptrdiff_t stride, int width, int height) {
  for_each_strip(width, [&](auto vectors, int x) {
    for_each_rows(height, [&](auto rows, int y) {
      constexpr int kRows = decltype(rows)::value, kVectors = decltype(vectors)::value;
      const float* first = read + x + y * read_stride;
      Vector sums[kRows][kVectors] = {};
      for (int k = 0; k < taps; ++k) {
        const float* from = first + offsets[k];
        for (int row = 0; row < kRows; ++row, from += read_stride) {
          for (int i = 0; i < kVectors; ++i) sums[row][i] += shares[k] * load(from + i * kLanes);
        }
      }
      float* to = written + x + y * stride;
      for (int row = 0; row < kRows; ++row, to += stride) {
        for (int i = 0; i < kVectors; ++i) store(to + i * kLanes, sums[row][i]);
      }
    });
  });
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

/// 0, 1, 2 and so on, `last` at most.
inline Vector count_to(float last) {
  Vector counting, lasts = Vector{} + last;
  for (int i = 0; i < kLanes; ++i) counting[i] = static_cast<float>(i);
  return counting < lasts ? counting : lasts;
}

/// Places between pixels, all >= 0: where the row of the table is that has their weights, and the first pixel.
struct TablePlaces {
  std::int32_t weights[kLanes], pixels[kLanes];
};
inline void look_up(Vector at, TablePlaces* places) {
  const IntVector whole = __builtin_convertvector(at, IntVector);
  const Vector fraction = at - __builtin_convertvector(whole, Vector);
  const IntVector steps = __builtin_convertvector(fraction * kInterpolationSteps + 0.5f, IntVector);
  const IntVector weights = steps * kInterpolationStride;
  std::memcpy(places->weights, &weights, sizeof weights);
  std::memcpy(places->pixels, &whole, sizeof whole);
}

/// Products with a row of the table, but for the sum of the lanes.
inline FourFloats weigh(const Taps& values, const float* across) {
  Taps weights;
  std::memcpy(&weights, across, sizeof weights);
  const Taps products = values * weights;
  FourFloats halves[2];
  std::memcpy(halves, &products, sizeof products);
  return halves[0] + halves[1];
}

/// Sums of the lanes of lanes_at(i) for i < count <= kLanes, a multiple of four of which are written.
template <typename Lanes>
inline void sum_lanes(int count, float* sums, Lanes&& lanes_at) {
  for (int i = 0; i < count; i += 4) {
    const FourFloats lanes[4] = {lanes_at(i), lanes_at(i + 1), lanes_at(i + 2), lanes_at(i + 3)};
    const FourFloats four = reduce_add_four(lanes);
    std::memcpy(sums + i, &four, sizeof four);
  }
}

void sample_row(const float* pixels, std::ptrdiff_t stride, const float* table, float x, float y, float dx, float dy,
                int count, float* sampled) {
  for (int i = 0; i < count; i += kLanes) {
    const Vector at = static_cast<float>(i) + count_to(static_cast<float>(count - 1 - i));
    TablePlaces across, down;
    look_up(x + dx * at, &across);
    look_up(y + dy * at, &down);
    sum_lanes(count - i < kLanes ? count - i : kLanes, sampled + i, [&](int lane) {
      const float *weights = table + down.weights[lane],
                  *row = pixels + down.pixels[lane] * stride + across.pixels[lane];
      Taps even = {}, odd = {}, values;
      for (int k = 0; k < kInterpolationTaps; k += 2, row += 2 * stride) {
        std::memcpy(&values, row, sizeof values);
        even += weights[k] * values;
        std::memcpy(&values, row + stride, sizeof values);
        odd += weights[k + 1] * values;
      }
      return weigh(even + odd, table + across.weights[lane]);
    });
  }
}

/// Weighted sum of six values in each lane.
inline Vector weigh(const Vector* values, const Interpolation& interpolation, Vector fraction) {
  const Vector s = fraction - 0.5f, square = s * s;
  Vector sum = {};
  for (int k = 0; k < kInterpolationTaps / 2; ++k) {
    const float *e = interpolation.even[k], *o = interpolation.odd[k];
    const Vector even = e[0] + square * (e[1] + square * e[2]), odd = s * (o[0] + square * (o[1] + square * o[2]));
    const Vector near = values[k], far = values[kInterpolationTaps - 1 - k];
    sum += even * (near + far) + odd * (far - near);
  }
  return sum;
}

/// Interpolates along y, at y + dy * x for the columns x < count.
inline void sample_columns(const float* pixels, std::ptrdiff_t stride, const Interpolation& interpolation, float y,
                           float dy, int count, float* sampled) {
  for (int x = 0; x < count; x += kLanes) {
    const Vector at = y + dy * (static_cast<float>(x) + count_to(static_cast<float>(count - 1 - x)));
    const IntVector tops = __builtin_convertvector(at, IntVector);
    const int begin = tops[0], end = tops[kLanes - 1], first = begin < end ? begin : end,
              last = begin < end ? end : begin;
    const float* row = pixels + first * stride + x;
    Vector values[kInterpolationTaps];
    for (int k = 0; k < kInterpolationTaps; ++k) values[k] = load(row + k * stride);
    for (int top = first + 1; top <= last; ++top) {
      row += stride;
      const IntVector is_there = tops >= top;
      for (int k = 0; k < kInterpolationTaps; ++k) values[k] = is_there ? load(row + k * stride) : values[k];
    }
    store(sampled + x, weigh(values, interpolation, at - __builtin_convertvector(tops, Vector)));
  }
}

/// pick() takes what is so far from the first at most.
constexpr int kFarthestPick = 3 * kLanes / 2 + 3;

/// Interpolates along x, at x + i * dx for i < count.
/// @param dx  > 0
inline void sample_along(const float* line, const Interpolation& interpolation, float x, float dx, int count,
                         float* sampled) {
  const int fit = 1 + static_cast<int>(static_cast<float>(kFarthestPick - kInterpolationTaps) / dx),
            at_a_time = fit < kLanes ? fit : kLanes;
  const Vector steps = dx * count_to(static_cast<float>(at_a_time - 1));
  for (int i = 0; i < count; i += at_a_time) {
    const Vector at = x + static_cast<float>(i) * dx + steps;
    const IntVector lefts = __builtin_convertvector(at, IntVector), away = lefts - lefts[0];
    const float* window = line + lefts[0];
    Vector values[kInterpolationTaps];
    for (int k = 0; k < kInterpolationTaps; ++k) values[k] = pick(window, away + k);
    store(sampled + i, weigh(values, interpolation, at - __builtin_convertvector(lefts, Vector)));
  }
}

/// Whether samples are close enough to each other, and in few enough rows, for all to be interpolated along y first.
/// @param columns  that are read
inline bool is_separable(const SampleGrid& grid, int columns) {
  constexpr int kSamplesForVector = 4;
  constexpr float kShortestStep = 0.5f, kSteepest = 0.2f;
  return grid.dx >= kShortestStep && grid.dy * grid.dy <= kSteepest * kSteepest * grid.dx * grid.dx &&
         columns * kSamplesForVector <= grid.width * kLanes;
}

void sample(const float* pixels, std::ptrdiff_t stride, const Interpolation& interpolation, const SampleGrid& grid,
            float* sampled, std::ptrdiff_t sampled_stride) {
  constexpr int kMostColumns = 256, kBefore = kInterpolationTaps / 2 - 1;
  const float to_last = static_cast<float>(grid.width - 1) * grid.dx;
  // Two columns more: by fractions of places, and by rounding.
  const int columns = to_last < kMostColumns ? static_cast<int>(to_last) + kInterpolationTaps + 2 : kMostColumns + 1;
  if (columns <= kMostColumns && is_separable(grid, columns)) {
    const float slope = grid.dy / grid.dx;
    float line[kMostColumns + 3 * kLanes + 4];
    std::memset(line + round_up(columns, kLanes), 0, (2 * kLanes + 4) * sizeof(float));  // pick() reads a window
    for (int row = 0; row < grid.height; ++row) {
      const float x = grid.x + static_cast<float>(row) * grid.row_dx,
                  y = grid.y + static_cast<float>(row) * grid.row_dy;
      const int left = static_cast<int>(x);
      sample_columns(pixels + left, stride, interpolation, y - slope * (x - static_cast<float>(left - kBefore)), slope,
                     columns, line);
      sample_along(line, interpolation, x - static_cast<float>(left), grid.dx, grid.width,
                   sampled + row * sampled_stride);
    }
    return;
  }
  for (int row = 0; row < grid.height; ++row) {
    sample_row(pixels, stride, interpolation.table, grid.x + static_cast<float>(row) * grid.row_dx,
               grid.y + static_cast<float>(row) * grid.row_dy, grid.dx, grid.dy, grid.width,
               sampled + row * sampled_stride);
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

void displace(const float* patch, std::ptrdiff_t patch_stride, const float* b, float middle_x, float middle_y,
              float* displaced, std::ptrdiff_t stride, int width, int height) {
  for (int x = 0; x < width; x += kLanes) {
    const Vector u = count_to(static_cast<float>(kLanes - 1)) + (static_cast<float>(x) - middle_x);
    const Vector x_by_uu = b[0] * u * u, x_by_u = b[2] * u, y_by_uu = b[1] * u * u, y_by_u = b[3] * u;
    for (int y = 0; y < height; ++y) {
      const float v = static_cast<float>(y) - middle_y;
      const Vector moved_x = x_by_uu + v * (x_by_u + v * b[4]), moved_y = y_by_uu + v * (y_by_u + v * b[5]);
      // Scharr's filters would smooth across: fine texture would move too little.
      const float* middle = patch + y * patch_stride + x;
      const Vector across = load(middle + 1) - load(middle - 1),
                   down = load(middle + patch_stride) - load(middle - patch_stride);
      store(displaced + y * stride + x, load(middle) - 0.5f * (across * moved_x + down * moved_y));
    }
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
const AlignmentSimd kAlignmentSimd = {GYRO_DEBLUR_ISA_NAME,
                                      make_pairs,
                                      convolve_pairs,
                                      convolve,
                                      sort_by_two,
                                      sort_by_three,
                                      sample,
                                      differentiate,
                                      displace,
                                      compare,
                                      combine,
                                      project,
                                      multiply_by_derivatives,
                                      multiply_gradients};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
