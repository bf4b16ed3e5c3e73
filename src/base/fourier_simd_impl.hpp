// Body of the loops of the Fourier transform of a tile, once per instruction set (see base/vectors_impl.hpp). Every
// lane of a vector does the same one-dimensional transform of another column, so that nothing is shuffled but where
// columns become rows.
#include "base/fourier_simd.hpp"
#include "base/vectors_impl.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

struct Complex {
  Vector re, im;
};

inline Complex operator+(const Complex& a, const Complex& b) { return {a.re + b.re, a.im + b.im}; }
inline Complex operator-(const Complex& a, const Complex& b) { return {a.re - b.re, a.im - b.im}; }
inline Complex operator*(float a, const Complex& b) { return {a * b.re, a * b.im}; }
inline Complex times_i(const Complex& z) { return {-z.im, z.re}; }

/// Times exp(-2 pi i / 4), or its conjugate.
template <bool kForward>
inline Complex quarter_rotation(const Complex& z) {
  return kForward ? Complex{z.im, -z.re} : times_i(z);
}

/// Complex vectors in memory, `step` floats apart.
struct Elements {
  float *re, *im;
  std::ptrdiff_t step;

  Complex load(std::ptrdiff_t i) const {
    return {GYRO_DEBLUR_ISA::load(re + i * step), GYRO_DEBLUR_ISA::load(im + i * step)};
  }
  void store(std::ptrdiff_t i, const Complex& z) const {
    GYRO_DEBLUR_ISA::store(re + i * step, z.re);
    GYRO_DEBLUR_ISA::store(im + i * step, z.im);
  }
};

/// Discrete transforms of 2, 3, 4, 5 and 8 elements, forward or (times their number) back.
template <bool kForward>
inline void transform(Complex (&x)[2]) {
  const Complex first = x[0];
  x[0] = first + x[1];
  x[1] = first - x[1];
}

template <bool kForward>
inline void transform(Complex (&x)[3]) {
  constexpr float kSin = 0.866025404f;  // of a third of a revolution
  const Complex sum = x[1] + x[2], side = quarter_rotation<kForward>(kSin * (x[1] - x[2])), middle = x[0] - 0.5f * sum;
  x[0] = x[0] + sum;
  x[1] = middle + side;
  x[2] = middle - side;
}

template <bool kForward>
inline void transform(Complex (&x)[4]) {
  const Complex even = x[0] + x[2], odd = x[1] + x[3], rest = x[0] - x[2],
                rotated = quarter_rotation<kForward>(x[1] - x[3]);
  x[0] = even + odd;
  x[1] = rest + rotated;
  x[2] = even - odd;
  x[3] = rest - rotated;
}

template <bool kForward>
inline void transform(Complex (&x)[5]) {
  constexpr float kCos1 = 0.309016994f, kCos2 = -0.809016994f;  // of one and two fifths of a revolution
  constexpr float kSin1 = 0.951056516f, kSin2 = 0.587785252f;
  const Complex sum1 = x[1] + x[4], sum2 = x[2] + x[3], apart1 = x[1] - x[4], apart2 = x[2] - x[3];
  const Complex middle1 = x[0] + kCos1 * sum1 + kCos2 * sum2, middle2 = x[0] + kCos2 * sum1 + kCos1 * sum2;
  const Complex side1 = quarter_rotation<kForward>(kSin1 * apart1 + kSin2 * apart2);
  const Complex side2 = quarter_rotation<kForward>(kSin2 * apart1 - kSin1 * apart2);
  x[0] = x[0] + sum1 + sum2;
  x[1] = middle1 + side1;
  x[2] = middle2 + side2;
  x[3] = middle2 - side2;
  x[4] = middle1 - side1;
}

template <bool kForward>
inline void transform(Complex (&x)[8]) {
  constexpr float kHalf = 0.707106781f;  // sine of an eighth of a revolution
  Complex even[4] = {x[0], x[2], x[4], x[6]}, odd[4] = {x[1], x[3], x[5], x[7]};
  transform<kForward>(even);
  transform<kForward>(odd);
  odd[1] = kHalf * (odd[1] + quarter_rotation<kForward>(odd[1]));
  odd[2] = quarter_rotation<kForward>(odd[2]);
  odd[3] = kHalf * (quarter_rotation<kForward>(odd[3]) - odd[3]);
  for (int i = 0; i < 4; ++i) {
    x[i] = even[i] + odd[i];
    x[i + 4] = even[i] - odd[i];
  }
}

/// One group of elements of a stage: `first` and kRadix - 1 more, `part` apart.
template <int kRadix, bool kForward, bool kTwiddles>
inline void run_group(const Elements& from, const Elements& to, std::ptrdiff_t first, std::ptrdiff_t part,
                      const float* twiddles) {
  Complex x[kRadix];
  for (int q = 0; q < kRadix; ++q) {
    x[q] = from.load(first + q * part);
    if (kTwiddles && !kForward && q > 0) {
      const float c = twiddles[2 * q - 2], s = twiddles[2 * q - 1];
      x[q] = {x[q].re * c + x[q].im * s, x[q].im * c - x[q].re * s};
    }
  }
  transform<kForward>(x);
  for (int q = 0; q < kRadix; ++q) {
    if (kTwiddles && kForward && q > 0) {
      const float c = twiddles[2 * q - 2], s = twiddles[2 * q - 1];
      x[q] = {x[q].re * c - x[q].im * s, x[q].im * c + x[q].re * s};
    }
    to.store(first + q * part, x[q]);
  }
}

/// One stage over runs of `length` elements.
template <int kRadix, bool kForward>
void run_stage(const Elements& from, const Elements& to, int size, int length, const float* twiddles) {
  const int part = length / kRadix;
  for (int run = 0; run < size; run += length) run_group<kRadix, kForward, false>(from, to, run, part, nullptr);
  for (int j = 1; j < part; ++j, twiddles += 2 * (kRadix - 1)) {
    for (int run = 0; run < size; run += length) {
      run_group<kRadix, kForward, true>(from, to, run + j, part, twiddles);
    }
  }
}

template <bool kForward>
void run_stage(const Elements& from, const Elements& to, int size, int length, int radix, const float* twiddles) {
  switch (radix) {
    case 2:
      return run_stage<2, kForward>(from, to, size, length, twiddles);
    case 3:
      return run_stage<3, kForward>(from, to, size, length, twiddles);
    case 4:
      return run_stage<4, kForward>(from, to, size, length, twiddles);
    case 5:
      return run_stage<5, kForward>(from, to, size, length, twiddles);
    default:
      return run_stage<8, kForward>(from, to, size, length, twiddles);
  }
}

/// Twiddles of a stage of runs of `length`.
inline int count_twiddles(int length, int radix) { return 2 * (length / radix - 1) * (radix - 1); }

/// All stages but the last; the first takes its elements from elsewhere.
inline void run_first_stages(const FourierStages& plan, const Elements& from, const Elements& to) {
  const float* twiddles = plan.twiddles;
  int length = plan.size;
  for (int i = 0; i + 1 < plan.count; ++i) {
    run_stage<true>(i == 0 ? from : to, to, plan.size, length, plan.radices[i], twiddles);
    twiddles += count_twiddles(length, plan.radices[i]);
    length /= plan.radices[i];
  }
}

/// The same back, from the last but one to the first, which puts its elements elsewhere.
inline void run_first_stages_back(const FourierStages& plan, const Elements& from, const Elements& to) {
  const float* twiddles = plan.twiddles_end;
  int length = plan.radices[plan.count - 1];
  for (int i = plan.count - 2; i >= 0; --i) {
    length *= plan.radices[i];
    twiddles -= count_twiddles(length, plan.radices[i]);
    run_stage<false>(from, i == 0 ? to : from, plan.size, length, plan.radices[i], twiddles);
  }
}

/// The last stage, the gain, and the first stage of the way back.
template <int kRadix>
void run_innermost(const Elements& elements, int size, const float* gain) {
  for (int first = 0; first < size; first += kRadix, gain += 2 * kRadix * kLanes) {
    Complex x[kRadix];
    for (int q = 0; q < kRadix; ++q) x[q] = elements.load(first + q);
    transform<true>(x);
    for (int q = 0; q < kRadix; ++q) {
      const Vector re = load(gain + 2 * q * kLanes), im = load(gain + (2 * q + 1) * kLanes);
      x[q] = {x[q].re * re - x[q].im * im, x[q].im * re + x[q].re * im};
    }
    transform<false>(x);
    for (int q = 0; q < kRadix; ++q) elements.store(first + q, x[q]);
  }
}

inline void run_innermost(const Elements& elements, int size, int radix, const float* gain) {
  switch (radix) {
    case 2:
      return run_innermost<2>(elements, size, gain);
    case 3:
      return run_innermost<3>(elements, size, gain);
    case 4:
      return run_innermost<4>(elements, size, gain);
    case 5:
      return run_innermost<5>(elements, size, gain);
    default:
      return run_innermost<8>(elements, size, gain);
  }
}

inline Elements in_scratch(float* scratch) { return {scratch, scratch + kLanes, 2 * kLanes}; }

/// Columns that are transformed together: those of one vector are the real parts, those of the next the imaginary ones.
constexpr int kPanel = 2 * kLanes;

void transform_columns(const FourierTile& tile_plan, float* tile, float* scratch) {
  const FourierStages& plan = tile_plan.down;
  const int cols = tile_plan.across.size, size = plan.size, last_radix = plan.radices[plan.count - 1];
  const std::ptrdiff_t stride = fourier_stride(cols);
  const Elements z = in_scratch(scratch);
  for (int col = 0; col < cols; col += kPanel) {
    const Elements columns{tile + col, tile + col + kLanes, stride};
    run_first_stages(plan, columns, z);
    run_stage<true>(z, z, size, last_radix, last_radix, plan.twiddles_end);
    // Of a + i b, a and b real: A(v) = (Z(v) + Z*(-v)) / 2, B(v) = (Z(v) - Z*(-v)) / 2i; the half waits.
    const Vector none = {};
    const Complex mean = z.load(plan.places[0]);
    columns.store(0, 2 * mean);
    columns.store(size / 2, {none, none});
    for (int v = 1; v < size / 2; ++v) {
      const Complex p = z.load(plan.places[v]), q = z.load(plan.places[size - v]);
      columns.store(v, {p.re + q.re, p.im + q.im});
      columns.store(size / 2 + v, {p.im - q.im, q.re - p.re});
    }
  }
}

/// Takes kLanes rows of frequencies from the tile, and runs all stages across but the last.
inline void begin_rows(const FourierTile& tile_plan, int first_row, const float* tile, const Elements& z) {
  const FourierStages& plan = tile_plan.across;
  const std::ptrdiff_t stride = fourier_stride(plan.size);
  const float *re = tile + first_row * stride, *im = re + tile_plan.down.size / 2 * stride;
  for (int x = 0; x < plan.size; x += kLanes) {
    transpose_floats(re + x, stride, z.re + x * z.step, z.step);
    transpose_floats(im + x, stride, z.im + x * z.step, z.step);
  }
  run_first_stages(plan, z, z);
}

void row_powers(const FourierTile& tile_plan, int first_row, const float* tile, float* powers, float* scratch) {
  const FourierStages& plan = tile_plan.across;
  const int last_radix = plan.radices[plan.count - 1], rows = tile_plan.down.size / 2;
  const Elements z = in_scratch(scratch);
  begin_rows(tile_plan, first_row, tile, z);
  run_stage<true>(z, z, plan.size, last_radix, last_radix, plan.twiddles_end);
  for (int u = 0; u < plan.size; ++u) {
    const Complex twice = z.load(plan.places[u]);  // the columns' half has waited
    store(powers + static_cast<std::ptrdiff_t>(u) * rows + first_row,
          0.25f * (twice.re * twice.re + twice.im * twice.im));
  }
}

void filter_rows(const FourierTile& tile_plan, int first_row, const float* gain, int first_col, int end_col,
                 float* tile, float* scratch) {
  const FourierStages& plan = tile_plan.across;
  const int size = plan.size;
  const std::ptrdiff_t stride = fourier_stride(size);
  float *re = tile + first_row * stride, *im = re + tile_plan.down.size / 2 * stride;
  const Elements z = in_scratch(scratch);
  begin_rows(tile_plan, first_row, tile, z);
  run_innermost(z, size, plan.radices[plan.count - 1], gain);
  run_first_stages_back(plan, z, z);
  for (int x = first_col / kLanes * kLanes; x < end_col; x += kLanes) {
    transpose_floats(z.re + x * z.step, z.step, re + x, stride);
    transpose_floats(z.im + x * z.step, z.step, im + x, stride);
  }
}

void restore_columns(const FourierTile& tile_plan, int first_col, int end_col, float* tile, float* scratch) {
  const FourierStages& plan = tile_plan.down;
  const int cols = tile_plan.across.size, size = plan.size, last_radix = plan.radices[plan.count - 1];
  const std::ptrdiff_t stride = fourier_stride(cols);
  // Forward and back, an axis each, multiply by its size; the spectrum has waited for its half.
  const float scale = 0.5f / (static_cast<float>(cols) * static_cast<float>(size));
  const Elements z = in_scratch(scratch);
  for (int col = first_col / kPanel * kPanel; col < end_col; col += kPanel) {
    const Elements columns{tile + col, tile + col + kLanes, stride};
    const Vector none = {};
    z.store(plan.places[0], scale * columns.load(0));
    z.store(plan.places[size / 2], {none, none});
    for (int v = 1; v < size / 2; ++v) {
      const Complex re = scale * columns.load(v), im = scale * columns.load(size / 2 + v);
      z.store(plan.places[v], {re.re - im.im, re.im + im.re});
      z.store(plan.places[size - v], {re.re + im.im, re.im - im.re});
    }
    run_stage<false>(z, z, size, last_radix, last_radix, plan.twiddles_end);
    run_first_stages_back(plan, z, columns);
  }
}

// Forward and back, tiles of 256: with 8 rather than 4 51 instead of 63 us with AVX-512 (32 registers), 145 instead of
// 73 with AVX2, 136 instead of 146 with SSE (AMD Zen 5).
constexpr int kLargestRadix = kLanes == 8 ? 4 : 8;

}  // namespace

extern const FourierSimd kFourierSimd;
const FourierSimd kFourierSimd = {GYRO_DEBLUR_ISA_NAME, kLanes,     kLargestRadix,  transform_columns,
                                  filter_rows,          row_powers, restore_columns};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
