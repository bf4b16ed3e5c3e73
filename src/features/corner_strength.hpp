// How strong a corner each pixel of an image is: what all searches for corners share.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "features/corner_simd.hpp"

namespace gyro_deblur {

/// Strengths of corners (CornerSimd::rate). Keeps its buffers. Not thread-safe.
class CornerStrengths {
 public:
  /// Rates pixels in runs of columns. Strengths are known two pixels away from the image's edge.
  /// @param for_each_run  (y, around, body): calls body(first, end) for the runs of all rows within `around` of y, each
  ///                      wider by `around` columns on both sides, inside the image, from left to right
  /// @param make_row      (y, first, end, to): writes pixels [first, end) of row y, and up to kCornerRoom more behind
  template <typename ForEachRun, typename MakeRow>
  void rate(int width, int height, ForEachRun&& for_each_run, MakeRow&& make_row);

  /// Of row y, 2 <= y < height - 2.
  const float* row(int y) const { return strengths_.row(y); }

  /// See CornerSimd::find_peaks().
  int find_peaks(int y, int first, int end, int* columns) const {
    return simd_.find_peaks(row(y - 1), row(y), row(y + 1), first, end, columns);
  }

 private:
  /// Rows with room on both sides.
  struct Plane {
    std::vector<float> pixels;
    int stride = 0;
    void resize(int width, int height) {
      stride = width + 2 * kCornerRoom;
      pixels.resize(static_cast<std::size_t>(stride * height + kCornerRoom));
    }
    float* row(int y) { return pixels.data() + y * stride + kCornerRoom; }
    const float* row(int y) const { return pixels.data() + y * stride + kCornerRoom; }
  };

  Plane pixels_, products_, strengths_;
  const CornerSimd& simd_ = select_for_cpu<CornerSimd>();
};

template <typename ForEachRun, typename MakeRow>
void CornerStrengths::rate(int width, int height, ForEachRun&& for_each_run, MakeRow&& make_row) {
  constexpr int kRows = 3;
  pixels_.resize(width, kRows);
  products_.resize(width, 3 * kRows);  // one after the other
  strengths_.resize(width, height);
  const auto pixels = [this](int y) { return pixels_.row(y % kRows); };
  const auto products = [this](int y, int x) {
    const int first = 3 * (y % kRows);
    return GradientProducts{products_.row(first) + x, products_.row(first + 1) + x, products_.row(first + 2) + x};
  };
  // A kernel may write beyond the end of its run, into the one to the right: that is made after it.
  for (int y = 0; y < height; ++y) {
    for_each_run(y, 3, [&](int first, int end) { make_row(y, first, end, pixels(y) + first); });
    if (y < 2) continue;
    for_each_run(y - 1, 2, [&](int first, int end) {
      simd_.multiply(pixels(y - 2) + first, pixels(y - 1) + first, pixels(y) + first, products(y - 1, first),
                     end - first);
    });
    if (y < 4) continue;
    for_each_run(y - 2, 1, [&](int first, int end) {
      const std::array<GradientProducts, kRows> rows{products(y - 3, first), products(y - 2, first),
                                                     products(y - 1, first)};
      simd_.rate(rows.data(), strengths_.row(y - 2) + first, end - first);
    });
  }
}

}  // namespace gyro_deblur
