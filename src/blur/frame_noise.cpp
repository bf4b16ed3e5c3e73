#include "blur/frame_noise.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

namespace gyro_deblur {
namespace {

constexpr int kCell = 16;  // px; side of what is taken as even
constexpr int kEvery = 4;  // of the cells of a row and of a column one is measured

/// Sum of |operator| over a cell whose pixels are all inside the image, or -1 where noise may be clipped.
int sum_of_differences(const cv::Mat& luminance, int left, int top) {
  int sum = 0, grey = 0;
  for (int y = top; y < top + kCell; ++y) {
    const std::uint8_t* above = luminance.ptr<std::uint8_t>(y - 1);
    const std::uint8_t* row = luminance.ptr<std::uint8_t>(y);
    const std::uint8_t* below = luminance.ptr<std::uint8_t>(y + 1);
    for (int x = left; x < left + kCell; ++x) {
      const int corners = above[x - 1] + above[x + 1] + below[x - 1] + below[x + 1];
      const int sides = above[x] + below[x] + row[x - 1] + row[x + 1];
      sum += std::abs(corners - 2 * sides + 4 * row[x]);
      grey += row[x];
    }
  }
  constexpr int kPixels = kCell * kCell, kFromTheEnds = 16;  // two standard deviations of strong noise
  return grey < kFromTheEnds * kPixels || grey > (255 - kFromTheEnds) * kPixels ? -1 : sum;
}

}  // namespace

double frame_noise(const cv::Mat& luminance) {
  CV_Assert(luminance.type() == CV_8UC1);
  std::vector<int> sums;
  for (int top = 1; top + kCell < luminance.rows; top += kEvery * kCell) {
    for (int left = 1; left + kCell < luminance.cols; left += kEvery * kCell) {
      const int sum = sum_of_differences(luminance, left, top);
      if (sum >= 0) sums.push_back(sum);
    }
  }
  if (sums.empty()) return 0;
  const auto tenth = sums.begin() + static_cast<std::ptrdiff_t>(sums.size() / 10);
  std::nth_element(sums.begin(), tenth, sums.end());
  // The weights' squares sum to 36; of noise of variance 1 the mean magnitude is sqrt(2 / pi), and the tenth of the
  // cells where it comes out least has 9 % less (measured on white noise).
  constexpr double kOfTheTenth = 0.91;
  return *tenth * std::sqrt(CV_PI / 2) / (kOfTheTenth * 6 * kCell * kCell);
}

}  // namespace gyro_deblur
