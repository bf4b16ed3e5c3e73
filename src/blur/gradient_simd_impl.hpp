// Body of the loop that validation spends its time in, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "blur/gradient_simd.hpp"

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

// As many elements as an IntVector has.
typedef std::int16_t ShortVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES / 2)));
typedef std::uint8_t ByteVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES / 4)));

inline ShortVector load(const std::uint8_t* from) {
  ByteVector v;
  std::memcpy(&v, from, sizeof v);
  return __builtin_convertvector(v, ShortVector);
}
inline int to_ints(std::int16_t v) { return v; }
inline IntVector to_ints(ShortVector v) { return __builtin_convertvector(v, IntVector); }

template <typename T>
T load_as(const std::uint8_t* from);
template <>
inline std::int16_t load_as<std::int16_t>(const std::uint8_t* from) {
  return *from;
}
template <>
inline ShortVector load_as<ShortVector>(const std::uint8_t* from) {
  return load(from);
}

/// Of one row, what the Sobel pair is made of.
template <typename T>
struct RowParts {
  T across, along;  // differences, and sums with weights 1, 2 and 1

  explicit RowParts(const std::uint8_t* from) {
    const T left = load_as<T>(from), middle = load_as<T>(from + 1), right = load_as<T>(from + 2);
    across = static_cast<T>(right - left);
    along = static_cast<T>(left + middle + middle + right);
  }
};

/// The largest |dx gx + dy gy| of a column of elements, or of as many columns as a vector has.
template <typename T>
inline auto strongest_of_columns(const std::uint8_t* around, std::ptrdiff_t stride, int height, int dx, int dy) {
  RowParts<T> above(around), here(around + stride);
  auto strongest = to_ints(T{});
  for (int y = 0; y < height; ++y) {
    const RowParts<T> below(around + (y + 2) * stride);
    const auto gx = to_ints(static_cast<T>(above.across + here.across + here.across + below.across));
    const auto gy = to_ints(static_cast<T>(below.along - above.along));
    const auto along = dx * gx + dy * gy;
    const auto size = along < 0 ? -along : along;
    strongest = size > strongest ? size : strongest;
    above = here;
    here = below;
  }
  return strongest;
}

int strongest_gradient(const std::uint8_t* around, std::ptrdiff_t stride, int width, int height, int dx, int dy) {
  if (width < kLanes) {
    int strongest = 0;
    for (int x = 0; x < width; ++x) {
      const int of_column = strongest_of_columns<std::int16_t>(around + x, stride, height, dx, dy);
      if (of_column > strongest) strongest = of_column;
    }
    return strongest;
  }
  IntVector strongest = {};
  for (int begin = 0; begin < width; begin += kLanes) {
    // The last vector begins earlier: a maximum may see an element twice.
    const int x = begin + kLanes <= width ? begin : width - kLanes;
    const IntVector of_columns = strongest_of_columns<ShortVector>(around + x, stride, height, dx, dy);
    strongest = of_columns > strongest ? of_columns : strongest;
  }
  int of_all = 0;
  for (int i = 0; i < kLanes; ++i) {
    if (strongest[i] > of_all) of_all = strongest[i];
  }
  return of_all;
}

}  // namespace

extern const GradientSimd kGradientSimd;
const GradientSimd kGradientSimd = {GYRO_DEBLUR_ISA_NAME, strongest_gradient};

}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
