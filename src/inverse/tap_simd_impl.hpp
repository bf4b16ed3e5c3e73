// Body of the loops that make weights, once per instruction set (see base/vectors_impl.hpp).
#include "base/vectors_impl.hpp"
#include "inverse/tap_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

void resample_kernel(const float* taps, int radius, double step, int steps, float* on_axis) {
  // kLanes steps lie between at most 1.5 times as many taps, and the outermost see one more before and two behind.
  constexpr int kWindow = 2 * kLanes + 4;
  const double taps_a_step = 1 / step;
  const float s = static_cast<float>(step);
  const Vector zero = {};
  Vector in_taps;
  for (int i = 0; i < kLanes; ++i) in_taps[i] = static_cast<float>(i * taps_a_step);
  for (int m = 0; m <= steps; m += kLanes) {
    const double first = m * taps_a_step;
    const int begin = static_cast<int>(first);
    const float* window = taps + begin - 1;
    const int available = radius - begin + 2;
    float copy[kWindow];
    if (available < kWindow) {
      for (int i = 0; i < kWindow; ++i) copy[i] = i < available ? window[i] : 0.0f;
      window = copy;
    }
    const Vector position = in_taps + static_cast<float>(first - begin);
    const IntVector index = __builtin_convertvector(position, IntVector);
    const Vector before = (position - __builtin_convertvector(index, Vector)) * s, after = s - before;
    const Vector far_before = 1 - s - before, far_after = 1 - s - after;
    const Vector sum = pick(window, index + 1) * (1 - before) + pick(window, index + 2) * (1 - after) +
                       pick(window, index) * (far_before > zero ? far_before : zero) +
                       pick(window, index + 3) * (far_after > zero ? far_after : zero);
    store(on_axis + m, sum);
  }
}

void combine_columns(const float* columns, const float* factors, int count, float* sums) {
  constexpr int kVectors = kRowGroup / kLanes;
  constexpr int kChains = 4;  // independent sums, to hide the latency of an FMA
  Vector acc[kChains][kVectors] = {};
  const auto add = [&](int m, Vector* chain) {
    for (int v = 0; v < kVectors; ++v) chain[v] += factors[m] * load(columns + m * kRowGroup + v * kLanes);
  };
  int m = 0;
  for (; m + kChains <= count; m += kChains) {
    for (int c = 0; c < kChains; ++c) add(m + c, acc[c]);
  }
  for (; m < count; ++m) add(m, acc[0]);
  for (int v = 0; v < kVectors; ++v) {
    store(sums + v * kLanes, (acc[0][v] + acc[1][v]) + (acc[2][v] + acc[3][v]));
  }
}

// The forward vector solves the leading m equations for an error in the first, the backward vector, the same
// reversed, for one in the last. The backward vector begins an element earlier each time, so that all are contiguous.
// Behind their ends all are 0, as far as whole vectors reach.
void solve_toeplitz(const double* lags, int band, int n, const double* sides, double* work, double* solved) {
  static_assert(2 * kDoubleLanes <= kToeplitzRoom, "the room behind a vector is for two of these");
  const int room = n + kToeplitzRoom;
  double* forward = work;
  double* backward = work + room;
  double *x = work + 2 * room, *y = work + 3 * room;
  double* to_next = work + 4 * room;  // r(band - 1) .. r(1)
  for (int i = 0; i < 5 * room + band; ++i) work[i] = 0;
  for (int i = 0; i + 1 < band; ++i) to_next[i] = lags[i];
  double error = lags[band - 1];
  forward[0] = backward[n - 1] = 1;
  x[0] = sides[0] / error;
  y[0] = sides[n] / error;
  for (int m = 1; m < n; ++m) {
    // r(k), .., r(1): the last k of the first m unknowns in the next equation; the others are not in it.
    const int k = m < band - 1 ? m : band - 1, from = m - k;
    DoubleVector in_forward[2] = {}, in_x[2] = {}, in_y[2] = {};
    for (int i = 0; i < k; i += 2 * kDoubleLanes) {
      for (int v = 0; v < 2; ++v) {
        const int at = i + v * kDoubleLanes;
        const DoubleVector lag = load(to_next + band - 1 - k + at);
        in_forward[v] += lag * load(forward + from + at);
        in_x[v] += lag * load(x + from + at);
        in_y[v] += lag * load(y + from + at);
      }
    }
    const double reflection = -reduce_add(in_forward[0] + in_forward[1]) / error;
    error *= 1 - reflection * reflection;
    const double add_to_x = (sides[m] - reduce_add(in_x[0] + in_x[1])) / error;
    const double add_to_y = (sides[n + m] - reduce_add(in_y[0] + in_y[1])) / error;
    double* shifted = backward + n - 1 - m;
    for (int i = 0; i <= m; i += kDoubleLanes) {
      const DoubleVector ahead = load(forward + i), behind = load(shifted + i);
      const DoubleVector new_behind = behind + reflection * ahead;
      store(forward + i, ahead + reflection * behind);
      store(shifted + i, new_behind);
      store(x + i, load(x + i) + add_to_x * new_behind);
      store(y + i, load(y + i) + add_to_y * new_behind);
    }
  }
  std::memcpy(solved, x, n * sizeof(double));
  std::memcpy(solved + n, y, n * sizeof(double));
}

}  // namespace

extern const TapSimd kTapSimd;
const TapSimd kTapSimd = {GYRO_DEBLUR_ISA_NAME, resample_kernel, combine_columns, solve_toeplitz};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
