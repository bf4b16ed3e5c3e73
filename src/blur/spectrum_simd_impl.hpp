// Body of the loops that validation by likelihood spends its time in, once per instruction set (see
// base/vectors_impl.hpp).
#include <math.h>

#include "base/logarithms_impl.hpp"
#include "blur/spectrum_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

constexpr int kHalf = kSpectrumWindow / 2;

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

void multiply_gain(const SpectrumOrder& order, const float* gain, float bins_x, float bins_y, float* model) {
  for (int i = 0; i < kSpectrumPlaces; i += kLanes) {
    const Vector along = load(order.across + i) * bins_x + load(order.down + i) * bins_y;
    const IntVector bin = __builtin_convertvector((along < 0 ? -along : along) + 0.5f, IntVector);
    Vector picked;
    for (int k = 0; k < kLanes; ++k) picked[k] = gain[bin[k]];
    store(model + i, load(order.texture + i) * picked);
  }
}

void multiply_path_gain(const SpectrumOrder& order, const PathPhases& path, float left, float* model) {
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
  float gain[kSpectrumSize];
  for (int row = 0; row < 2 * kSpectrumWaves; ++row) {
    const int at = kSpectrumWaves + (row < kSpectrumWaves ? row : kSpectrumWaves - row);
    for (int x = 0; x < kSpectrumWaves; x += kLanes) {
      store(gain + row * kSpectrumWaves + x,
            (4 * load(smeared[at] + x) + load(smeared[at - 1] + x) + load(smeared[at + 1] + x)) * (1 / 6.0f) + left);
    }
  }
  for (int i = 0; i < kSpectrumPlaces; ++i) model[i] = order.texture[i] * gain[order.at[i]];
}

/// A product as a mantissa and a power of two for each lane.
struct Product {
  Vector mantissa = Vector{} + 1;
  IntVector exponent = {};

  void multiply(Vector by) {
    IntVector bits = load_as<IntVector>(&by);
    exponent += (bits >> 23) - 127;
    bits = (bits & 0x7fffff) | 0x3f800000;
    mantissa *= load_as<Vector>(&bits);
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

/// One value for each sector, summed over its places.
struct OfSectors {
  static constexpr int kParts = kLanes < kSpectrumSectors ? kSpectrumSectors / kLanes : 1;
  Vector parts[kParts] = {};

  void to(double* sectors) const {
    for (int k = 0; k < kSpectrumSectors; ++k) sectors[k] = 0;
    for (int part = 0; part < kParts; ++part) {
      for (int i = 0; i < kLanes; ++i) sectors[(part * kLanes + i) % kSpectrumSectors] += parts[part][i];
    }
  }
};

/// The texture that `fit` makes of |f|^-2.5, as factors.
class Texture {
 public:
  Texture(const SpectrumOrder& order, const TextureFit& fit)
      : log_frequency_(order.log_frequency), exponent_(static_cast<float>(fit.exponent)) {
    for (int part = 0; part < OfSectors::kParts; ++part) {
      Vector log_factor;
      for (int i = 0; i < kLanes; ++i) {
        log_factor[i] = static_cast<float>(fit.log_power + fit.log_of_sector[(part * kLanes + i) % kSpectrumSectors]);
      }
      of_sectors_.parts[part] = exp_of(log_factor);
    }
  }
  Vector at(int place, int part) const {
    return of_sectors_.parts[part] * exp_of(exponent_ * load(log_frequency_ + place));
  }

 private:
  const float* log_frequency_;
  float exponent_;
  OfSectors of_sectors_;
};

inline double limited(double value, double most) { return value > most ? most : value < -most ? -most : value; }

// Standard deviations of the logarithm of a sector's power and of the exponent: half as much and one and a half times
// as much distinguish blur worse on the 18 photographs of doc/reports/validation.md.
constexpr double kSectorStddev = 1, kExponentStddev = 0.5;

/// One step of Fisher's scoring. The derivative of the cost by the logarithm of S - 1 is g = s (S - P) / (S + P),
/// s = (S - 1) / S, and its variance under the model s^2 / 3.
void improve(const SpectrumOrder& order, const float* power, const float* model, TextureFit* fit) {
  const Texture texture(order, *fit);
  OfSectors gradient, gradient_exponent, information, mixed, information_exponent;
  for (int i = 0; i < kSpectrumPlaces; i += kLanes * OfSectors::kParts) {
    for (int part = 0; part < OfSectors::kParts; ++part) {
      const int place = i + part * kLanes;
      const Vector above = texture.at(place, part) * load(model + place), p = load(power + place),
                   log_f = load(order.log_frequency + place), spectrum = above + 1, both = spectrum + p;
      const Vector scale = above / (spectrum * both);
      const Vector g = scale * (spectrum - p), share = scale * both;
      const Vector weight = share * share, weight_f = weight * log_f;
      gradient.parts[part] += g;
      gradient_exponent.parts[part] += g * log_f;
      information.parts[part] += weight;
      mixed.parts[part] += weight_f;
      information_exponent.parts[part] += weight_f * log_f;
    }
  }
  double g[kSpectrumSectors], g_exponent[kSpectrumSectors], info[kSpectrumSectors], mix[kSpectrumSectors],
      info_exponent[kSpectrumSectors];
  gradient.to(g);
  gradient_exponent.to(g_exponent);
  information.to(info);
  mixed.to(mix);
  information_exponent.to(info_exponent);

  // The sectors' equations contain nothing of one another: they are solved for their own unknown, and the two for all
  // remain.
  constexpr double kOfSector = 1 / (kSectorStddev * kSectorStddev),
                   kOfExponent = 1 / (kExponentStddev * kExponentStddev), kVariance = 1.0 / 3, kTiny = 1e-6;
  double rhs_power = 0, rhs_exponent = kOfExponent * fit->exponent, power_power = kTiny, power_exponent = 0,
         exponent_exponent = kOfExponent;
  for (int k = 0; k < kSpectrumSectors; ++k) {
    info[k] *= kVariance;
    mix[k] *= kVariance;
    const double own = info[k] + kOfSector, own_rhs = g[k] + kOfSector * fit->log_of_sector[k];
    rhs_power += g[k] - info[k] / own * own_rhs;
    rhs_exponent += g_exponent[k] - mix[k] / own * own_rhs;
    power_power += info[k] - info[k] / own * info[k];
    power_exponent += mix[k] - info[k] / own * mix[k];
    exponent_exponent += kVariance * info_exponent[k] - mix[k] / own * mix[k];
  }
  // Each unknown is limited before the next one is solved for, which makes up for what the limit has left.
  constexpr double kLongestStep = 2, kLongestExponentStep = 0.7, kLargestExponent = 1.4;
  const double determinant = power_power * exponent_exponent - power_exponent * power_exponent;
  double step_exponent = -(power_power * rhs_exponent - power_exponent * rhs_power) / determinant;
  step_exponent =
      limited(fit->exponent + limited(step_exponent, kLongestExponentStep), kLargestExponent) - fit->exponent;
  const double step_power = limited(-(rhs_power + power_exponent * step_exponent) / power_power, kLongestStep);
  for (int k = 0; k < kSpectrumSectors; ++k) {
    const double step = -(g[k] + kOfSector * fit->log_of_sector[k] + info[k] * step_power + mix[k] * step_exponent) /
                        (info[k] + kOfSector);
    fit->log_of_sector[k] += limited(step, kLongestStep);
  }
  fit->log_power += step_power;
  fit->exponent += step_exponent;
}

double cost_of(const SpectrumOrder& order, const float* power, const float* model, const TextureFit& fit) {
  const Texture texture(order, fit);
  double cost = 0.5 * fit.exponent * fit.exponent / (kExponentStddev * kExponentStddev);
  for (const double log_of_sector : fit.log_of_sector) {
    cost += 0.5 * log_of_sector * log_of_sector / (kSectorStddev * kSectorStddev);
  }
  Product product;
  int factors = 0;
  constexpr int kMostFactors = 60;  // mantissas are below 2, and a float holds 2^127
  for (int i = 0; i < kSpectrumPlaces; i += kLanes) {
    const Vector spectrum = texture.at(i, i / kLanes % OfSectors::kParts) * load(model + i) + 1,
                 both = spectrum + load(power + i);
    product.multiply(both * both / spectrum);
    if (++factors == kMostFactors) {
      cost += product.log();
      product = {};
      factors = 0;
    }
  }
  return cost + product.log();
}

double least_cost(const SpectrumOrder& order, const float* power, const float* model, int steps, TextureFit* fit) {
  for (int step = 0; step < steps; ++step) improve(order, power, model, fit);
  return cost_of(order, power, model, *fit);
}

void halve(const std::uint8_t* upper, const std::uint8_t* lower, int count, std::uint8_t* __restrict out) {
  for (int x = 0; x < count; ++x) {
    const int sum = upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1];
    out[x] = static_cast<std::uint8_t>((sum + 2) >> 2);
  }
}

}  // namespace

extern const SpectrumSimd kSpectrumSimd;
const SpectrumSimd kSpectrumSimd = {GYRO_DEBLUR_ISA_NAME, clip_outliers,      halve,     power_spectrum,
                                    multiply_gain,        multiply_path_gain, least_cost};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
