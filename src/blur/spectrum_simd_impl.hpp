// Body of the loops that validation by likelihood spends its time in, once per instruction set (see
// base/vectors_impl.hpp).
#include <math.h>

#include "base/vectors_impl.hpp"
#include "blur/spectrum_simd.hpp"

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

constexpr int kHalf = kSpectrumWindow / 2;

typedef std::uint8_t ByteVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));

template <typename T>
T load_as(const std::uint8_t* from) {
  T v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

template <typename T>
T smaller(T a, T b) {
  return a < b ? a : b;
}
template <typename T>
T larger(T a, T b) {
  return a > b ? a : b;
}

/// The two largest and the two smallest of what was added.
template <typename T>
struct Extremes {
  T largest, second_largest, smallest, second_smallest;

  Extremes(T a, T b)
      : largest(larger(a, b)), second_largest(smaller(a, b)), smallest(smaller(a, b)), second_smallest(larger(a, b)) {}
  void add(T value) {
    second_largest = larger(second_largest, smaller(largest, value));
    largest = larger(largest, value);
    second_smallest = smaller(second_smallest, larger(smallest, value));
    smallest = smaller(smallest, value);
  }
};

/// @param left, right  from x to its neighbours
template <typename T>
void clip(const std::uint8_t* above, const std::uint8_t* row, const std::uint8_t* below, int x, int left, int right,
          T margin, std::uint8_t* out) {
  Extremes<T> around(load_as<T>(above + x + left), load_as<T>(above + x));
  around.add(load_as<T>(above + x + right));
  around.add(load_as<T>(row + x + left));
  around.add(load_as<T>(row + x + right));
  around.add(load_as<T>(below + x + left));
  around.add(load_as<T>(below + x));
  around.add(load_as<T>(below + x + right));
  const T top = smaller(around.second_largest, static_cast<T>(255 - margin)) + margin;
  const T bottom = larger(around.second_smallest, margin) - margin;
  const T clipped = larger(smaller(load_as<T>(row + x), top), bottom);
  std::memcpy(out + x, &clipped, sizeof clipped);
}

void clip_outliers(const std::uint8_t* above, const std::uint8_t* row, const std::uint8_t* below, int width, int margin,
                   std::uint8_t* out) {
  constexpr int kBytes = GYRO_DEBLUR_VECTOR_BYTES;
  const auto one = static_cast<std::uint8_t>(margin);
  const auto clip_one = [&](int x) {
    clip<std::uint8_t>(above, row, below, x, x > 0 ? -1 : 0, x + 1 < width ? 1 : 0, one, out);
  };
  int x = 0;
  for (clip_one(x++); x + kBytes < width; x += kBytes) {
    clip<ByteVector>(above, row, below, x, -1, 1, ByteVector{} + one, out);
  }
  for (; x < width; ++x) clip_one(x);
}

/// out[r][c] = sum over j < kHalf of a[r][j] * b[j][c].
/// @param a  rows of kHalf
/// @param b  rows of `stride`, of which kSpectrumWaves count, as in `out`
void multiply(const float* a, int rows, const float* b, int b_stride, float* out, int out_stride) {
  constexpr int kVectors = kSpectrumWaves / kLanes;
  constexpr int kRows = 8 / kVectors;  // eight sums at a time hide the latency of an FMA and fit into the registers
  for (int r = 0; r < rows; r += kRows) {
    Vector sums[kRows][kVectors] = {};
    for (int j = 0; j < kHalf; ++j) {
      for (int v = 0; v < kVectors; ++v) {
        const Vector factor = load(b + j * b_stride + v * kLanes);
        for (int i = 0; i < kRows; ++i) sums[i][v] += a[(r + i) * kHalf + j] * factor;
      }
    }
    for (int i = 0; i < kRows; ++i) {
      for (int v = 0; v < kVectors; ++v) store(out + (r + i) * out_stride + v * kLanes, sums[i][v]);
    }
  }
}

void power_spectrum(const SpectrumTables& tables, const std::uint8_t* window, std::ptrdiff_t stride, float* power) {
  constexpr float kMiddleGrey = 128;  // the mean does not count, but costs digits
  constexpr int kColumns = 2 * kSpectrumWaves;
  float even[kSpectrumWindow * kHalf], odd[kSpectrumWindow * kHalf];
  for (int y = 0; y < kSpectrumWindow; ++y) {
    const std::uint8_t* row = window + y * stride;
    for (int j = 0; j < kHalf; ++j) {
      const float before = row[kHalf - 1 - j] - kMiddleGrey, behind = row[kHalf + j] - kMiddleGrey;
      even[y * kHalf + j] = behind + before;
      odd[y * kHalf + j] = behind - before;
    }
  }
  // Cosines and sines of every row, then of the columns of those.
  float of_rows[kSpectrumWindow * kColumns];
  multiply(even, kSpectrumWindow, tables.cosine[0], kSpectrumWaves, of_rows, kColumns);
  multiply(odd, kSpectrumWindow, tables.sine[0], kSpectrumWaves, of_rows + kSpectrumWaves, kColumns);
  float even_rows[kHalf * kColumns], odd_rows[kHalf * kColumns];
  for (int j = 0; j < kHalf; ++j) {
    const float* before = of_rows + (kHalf - 1 - j) * kColumns;
    const float* behind = of_rows + (kHalf + j) * kColumns;
    for (int c = 0; c < kColumns; c += kLanes) {
      store(even_rows + j * kColumns + c, load(behind + c) + load(before + c));
      store(odd_rows + j * kColumns + c, load(behind + c) - load(before + c));
    }
  }
  float cosines[kSpectrumWaves * kColumns], sines[kSpectrumWaves * kColumns];
  for (int c = 0; c < kColumns; c += kSpectrumWaves) {
    multiply(tables.cosine_of_wave[0], kSpectrumWaves, even_rows + c, kColumns, cosines + c, kColumns);
    multiply(tables.sine_of_wave[0], kSpectrumWaves, odd_rows + c, kColumns, sines + c, kColumns);
  }
  for (int y = 0; y < kSpectrumWaves; ++y) {
    for (int x = 0; x < kSpectrumWaves; x += kLanes) {
      const int at = y * kColumns + x;
      const Vector cos_cos = load(cosines + at), sin_cos = load(cosines + at + kSpectrumWaves);
      const Vector cos_sin = load(sines + at), sin_sin = load(sines + at + kSpectrumWaves);
      const Vector real = cos_cos - sin_sin, imaginary = sin_cos + cos_sin;
      const Vector real_down = cos_cos + sin_sin, imaginary_down = sin_cos - cos_sin;
      store(power + y * kSpectrumWaves + x, real * real + imaginary * imaginary);
      store(power + kSpectrumSize / 2 + y * kSpectrumWaves + x,
            real_down * real_down + imaginary_down * imaginary_down);
    }
  }
}

void multiply_gain(const float* texture, const float* gain, float bins_x, float bins_y, float* model) {
  Vector waves;
  for (int i = 0; i < kLanes; ++i) waves[i] = static_cast<float>(i);
  for (int row = 0; row < 2 * kSpectrumWaves; ++row) {
    const int y = row < kSpectrumWaves ? row : kSpectrumWaves - row;
    for (int x = 0; x < kSpectrumWaves; x += kLanes) {
      const Vector along = (waves + static_cast<float>(x)) * bins_x + y * bins_y;
      const IntVector bin = __builtin_convertvector((along < 0 ? -along : along) + 0.5f, IntVector);
      Vector picked;
      for (int i = 0; i < kLanes; ++i) picked[i] = gain[bin[i]];
      const int at = row * kSpectrumWaves + x;
      store(model + at, load(texture + at) * picked);
    }
  }
}

void multiply_path_gain(const float* texture, const PathPhases& path, float left, float* model) {
  constexpr int kAcross = PathPhases::kAcross, kDown = PathPhases::kDown;
  constexpr float kSegments = kPathInstants - 1;
  Vector wave;
  for (int i = 0; i < kLanes; ++i) wave[i] = static_cast<float>(i);
  float power[kDown][kAcross], smeared[kDown][kSpectrumWaves];
  for (int row = 0; row < kDown; ++row) {
    for (int x = 0; x <= kSpectrumWaves; x += kLanes) {
      Vector re = {}, im = {};
      for (const PathPhases::Segment& segment : path.segments) {
        const Vector across_re = load(segment.across_re + x), across_im = load(segment.across_im + x);
        const float down_re = segment.down_re[row], down_im = segment.down_im[row];
        const Vector half = (wave + static_cast<float>(x)) * segment.half_across +
                            static_cast<float>(row - kSpectrumWaves) * segment.half_down;
        // sin(t) / t to 2e-4 up to t = 3.1, of segments of three pixels at the highest frequencies; beyond, where
        // photographs hold least, nearly 0 instead of up to -0.2.
        constexpr float kFarthest = 9.7f;
        const Vector squared = half * half, t2 = squared < kFarthest ? squared : Vector{} + kFarthest;
        Vector mean = 1 / 362880.0f - t2 * (1 / 39916800.0f);
        mean = 1 / 5040.0f - t2 * mean;
        mean = 1 / 120.0f - t2 * mean;
        mean = 1 / 6.0f - t2 * mean;
        mean = 1 - t2 * mean;
        re += mean * (down_re * across_re - down_im * across_im);
        im += mean * (down_re * across_im + down_im * across_re);
      }
      store(power[row] + x, (re * re + im * im) * (1 / (kSegments * kSegments)));
    }
  }
  for (int row = 0; row < kDown; ++row) {
    const float before = power[kDown - 1 - row][1];  // the opposite frequency has the same power
    for (int x = 0; x < kSpectrumWaves; ++x) {
      smeared[row][x] = (4 * power[row][x] + (x > 0 ? power[row][x - 1] : before) + power[row][x + 1]) * (1 / 6.0f);
    }
  }
  for (int row = 0; row < 2 * kSpectrumWaves; ++row) {
    const int at = kSpectrumWaves + (row < kSpectrumWaves ? row : kSpectrumWaves - row);
    for (int x = 0; x < kSpectrumWaves; x += kLanes) {
      const Vector gain =
          (4 * load(smeared[at] + x) + load(smeared[at - 1] + x) + load(smeared[at + 1] + x)) * (1 / 6.0f) + left;
      const int to = row * kSpectrumWaves + x;
      store(model + to, load(texture + to) * gain);
    }
  }
}

/// A product as a mantissa and a power of two for each lane.
struct Product {
  Vector mantissa = Vector{} + 1;
  IntVector exponent = {};

  void multiply(Vector by) {
    IntVector bits;
    std::memcpy(&bits, &by, sizeof bits);
    exponent += (bits >> 23) - 127;
    bits = (bits & 0x7fffff) | 0x3f800000;
    std::memcpy(&by, &bits, sizeof by);
    mantissa *= by;
  }
  double log() const {
    double product = 1;
    int sum = 0;
    for (int i = 0; i < kLanes; ++i) {
      product *= mantissa[i];
      sum += exponent[i];
    }
    return ::log(product) + sum * M_LN2;
  }
};

inline float sum_of(Vector v) {
  float sum = 0;
  for (int i = 0; i < kLanes; ++i) sum += v[i];
  return sum;
}

double least_cost(const float* power, const float* model, double* log_factor) {
  // Fisher's scoring: the derivative of the cost by log a is the sum of g = s (S - P) / (S + P), s = (S - 1) / S, and
  // its variance under the model that of s^2 / 3. Three steps leave .02 of a log ratio.
  constexpr int kSteps = 3;
  constexpr double kLongestStep = 2;
  for (int step = 0; step < kSteps; ++step) {
    const auto factor = static_cast<float>(exp(*log_factor));
    Vector slope = {}, information = {};
    for (int i = 0; i < kSpectrumSize; i += kLanes) {
      const Vector texture = factor * load(model + i), p = load(power + i), both = texture + 1 + p;
      const Vector scale = 1 / ((texture + 1) * both);
      const Vector share = texture * both * scale;
      slope += texture * (texture + 1 - p) * scale;
      information += share * share;
    }
    const double newton = -3 * static_cast<double>(sum_of(slope)) / (static_cast<double>(sum_of(information)) + 1e-6);
    *log_factor += newton > kLongestStep ? kLongestStep : newton < -kLongestStep ? -kLongestStep : newton;
  }
  const auto factor = static_cast<float>(exp(*log_factor));
  // Mantissas are below 2, and a float holds 2^127.
  constexpr int kPart = 64 * kLanes < kSpectrumSize ? 64 * kLanes : kSpectrumSize;
  double cost = 0;
  for (int begin = 0; begin < kSpectrumSize; begin += kPart) {
    Product product;
    for (int i = begin; i < begin + kPart; i += kLanes) {
      const Vector spectrum = factor * load(model + i) + 1, both = spectrum + load(power + i);
      product.multiply(both * both / spectrum);
    }
    cost += product.log();
  }
  return cost;
}

}  // namespace

extern const SpectrumSimd kSpectrumSimd;
const SpectrumSimd kSpectrumSimd = {GYRO_DEBLUR_ISA_NAME, clip_outliers,      power_spectrum,
                                    multiply_gain,        multiply_path_gain, least_cost};

}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
