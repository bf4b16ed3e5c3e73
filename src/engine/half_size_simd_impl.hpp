// Body of the loops that make an image of half the size, and back, once per instruction set (see
// base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "engine/half_size_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

constexpr int kPairs = kHalvingTapCount / 2;

// In integers, as far as they go, the compiler's own vectors take half the time of load_pixels().
template <typename Pixel>
void lowpass_rows(const Pixel* const* rows, int width, float* __restrict to) {
  const Pixel *a = rows[0], *b = rows[1], *c = rows[2], *d = rows[3], *e = rows[4], *f = rows[5], *g = rows[6],
              *h = rows[7];
  for (int x = 0; x < width; ++x) {
    to[x] = kHalvingTaps[0] * static_cast<float>(a[x] + h[x]) + kHalvingTaps[1] * static_cast<float>(b[x] + g[x]) +
            kHalvingTaps[2] * static_cast<float>(c[x] + f[x]) + kHalvingTaps[3] * static_cast<float>(d[x] + e[x]);
  }
}

void decimate(const float* from, int count, float* to) {
  // `first` and `second` are the even and odd pixels from `from` on: neighbouring outputs are two pixels apart.
  const auto each = [](auto first, auto second) {
    decltype(first[0] + first[0]) sum = {};
    for (int k = 0; k < kPairs; k += 2) {
      sum += kHalvingTaps[k] * (first[k / 2] + second[(kHalvingTapCount - 1 - k) / 2]);
      sum += kHalvingTaps[k + 1] * (second[k / 2] + first[(kHalvingTapCount - 2 - k) / 2]);
    }
    return sum;
  };
  from -= kHalvingReach;
  int x = 0;
  for (; x + kLanes <= count; x += kLanes) {
    Vector first[kPairs], second[kPairs];
    for (int k = 0; k < kPairs; ++k) load_interleaved(from + 2 * (x + k), first[k], second[k]);
    store(to + x, each(first, second));
  }
  for (; x < count; ++x) {
    float first[kPairs], second[kPairs];
    for (int k = 0; k < kPairs; ++k) {
      first[k] = from[2 * (x + k)];
      second[k] = from[2 * (x + k) + 1];
    }
    to[x] = each(first, second);
  }
}

// Twice the taps, for the zeros between the pixels of the half.
constexpr float kFar = 2 * kHalvingTaps[0], kBehind = 2 * kHalvingTaps[1], kBefore = 2 * kHalvingTaps[2],
                kNearest = 2 * kHalvingTaps[3];

template <typename Value>
inline Value between(Value nearest, Value before, Value behind, Value far) {
  return kNearest * nearest + kBefore * before + kBehind * behind + kFar * far;
}

void interpolate_down(const float* const* rows, int width, float* to) {
  int x = 0;
  for (; x + kLanes <= width; x += kLanes) {
    store(to + x, between(load(rows[0] + x), load(rows[1] + x), load(rows[2] + x), load(rows[3] + x)));
  }
  for (; x < width; ++x) to[x] = between(rows[0][x], rows[1][x], rows[2][x], rows[3][x]);
}

void interpolate_across(const float* from, int count, float* to) {
  int x = 0;
  for (; x + kLanes <= count; x += kLanes) {
    const float* at = from + x;
    const Vector own = load(at), left = load(at - 1), right = load(at + 1);
    store_interleaved(to + 2 * x, between(own, left, right, load(at - 2)), between(own, right, left, load(at + 2)));
  }
  for (; x < count; ++x) {
    const float* at = from + x;
    to[2 * x] = between(at[0], at[-1], at[1], at[-2]);
    to[2 * x + 1] = between(at[0], at[1], at[-1], at[2]);
  }
}

}  // namespace

extern const HalfSizeSimd kHalfSizeSimd;
const HalfSizeSimd kHalfSizeSimd = {
    GYRO_DEBLUR_ISA_NAME, lowpass_rows<std::uint8_t>, lowpass_rows<std::uint16_t>, decimate,
    interpolate_down,     interpolate_across};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
