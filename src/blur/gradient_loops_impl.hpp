// Body of the loop that validation spends its time in, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "blur/gradient_loops.hpp"

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

// As many elements as an IntVector has.
typedef std::int16_t ShortVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES / 2)));

inline ShortVector load(const std::int16_t* from) {
  ShortVector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline int to_ints(std::int16_t v) { return v; }
inline IntVector to_ints(ShortVector v) { return __builtin_convertvector(v, IntVector); }

/// |dx gx + dy gy| at the element in the middle of those around `above`, `here` and `below`, or at all of a vector's.
template <typename T, typename Load>
inline auto gradient(const std::int16_t* above, const std::int16_t* here, const std::int16_t* below, int dx, int dy,
                     Load load_at) {
  const T diagonal_down = load_at(below + 2) - load_at(above), diagonal_up = load_at(above + 2) - load_at(below);
  const T across = load_at(here + 2) - load_at(here), down = load_at(below + 1) - load_at(above + 1);
  const auto gx = to_ints(static_cast<T>(across + across + diagonal_down + diagonal_up));
  const auto gy = to_ints(static_cast<T>(down + down + diagonal_down - diagonal_up));
  const auto along = dx * gx + dy * gy;
  return along < 0 ? -along : along;
}

int strongest_gradient(const std::int16_t* padded, int width, int height, int dx, int dy) {
  const int stride = width + 2;
  IntVector strongest = {};
  int strongest_of_few = 0;
  for (int y = 0; y < height; ++y) {
    const std::int16_t* above = padded + y * stride;
    const std::int16_t* here = above + stride;
    const std::int16_t* below = here + stride;
    if (width < kLanes) {
      for (int x = 0; x < width; ++x) {
        const int along = gradient<std::int16_t>(above + x, here + x, below + x, dx, dy,
                                                 [](const std::int16_t* from) { return *from; });
        if (along > strongest_of_few) strongest_of_few = along;
      }
      continue;
    }
    for (int begin = 0; begin < width; begin += kLanes) {
      // The last vector begins earlier: a maximum may see an element twice.
      const int x = begin + kLanes <= width ? begin : width - kLanes;
      const IntVector along = gradient<ShortVector>(above + x, here + x, below + x, dx, dy,
                                                    [](const std::int16_t* from) { return load(from); });
      strongest = along > strongest ? along : strongest;
    }
  }
  for (int i = 0; i < kLanes; ++i) {
    if (strongest[i] > strongest_of_few) strongest_of_few = strongest[i];
  }
  return strongest_of_few;
}

}  // namespace

extern const GradientLoops kGradientLoops;
const GradientLoops kGradientLoops = {GYRO_DEBLUR_ISA_NAME, strongest_gradient};

}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
