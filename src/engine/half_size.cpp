// Downsamples an image by two and upsamples the result.
#include "engine/half_size.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/parallel.hpp"

namespace gyro_deblur {
namespace {

constexpr int kPairs = kHalvingTapCount / 2;
// Pixels before an output of downsample2x(), and behind it, in addition to the two that it lies between.
constexpr int kReach = kPairs - 1;
// Pixels of the half on either side of its own, x, that double_size() reads: x - 2 to x + 1 for an even place, x - 1 to
// x + 2 for an odd one.
constexpr int kAround = 2;

/// One row of downsample2x().
template <typename Pixel>
void downsample2x_row(const cv::Mat& src, int row, std::vector<float>& scratch, float* to) {
  const int width = src.cols, half_width = (width + 1) / 2;
  const Pixel* rows[kHalvingTapCount];
  for (int k = 0; k < kHalvingTapCount; ++k) {
    rows[k] = src.ptr<Pixel>(std::clamp(2 * row - kReach + k, 0, src.rows - 1));
  }
  scratch.resize(2 * half_width + 2 * kReach);
  float* sums = scratch.data() + kReach;
#pragma omp simd
  for (int x = 0; x < width; ++x) {
    sums[x] = kHalvingTaps[0] * static_cast<float>(rows[0][x] + rows[7][x]) +
              kHalvingTaps[1] * static_cast<float>(rows[1][x] + rows[6][x]) +
              kHalvingTaps[2] * static_cast<float>(rows[2][x] + rows[5][x]) +
              kHalvingTaps[3] * static_cast<float>(rows[3][x] + rows[4][x]);
  }
  std::fill(sums - kReach, sums, sums[0]);
  std::fill(sums + width, sums + 2 * half_width + kReach, sums[width - 1]);
#pragma omp simd
  for (int x = 0; x < half_width; ++x) {
    const float* at = sums + 2 * x;
    to[x] = kHalvingTaps[0] * (at[-3] + at[4]) + kHalvingTaps[1] * (at[-2] + at[3]) +
            kHalvingTaps[2] * (at[-1] + at[2]) + kHalvingTaps[3] * (at[0] + at[1]);
  }
}

}  // namespace

double lowpass_response(double f) {
  double sum = 0;
  for (int k = 0; k < kPairs; ++k) sum += 2 * kHalvingTaps[k] * std::cos(2 * CV_PI * f * (kReach + 0.5 - k));
  return sum;
}

void downsample2x(const cv::Mat& src, int threads, cv::Mat& half) {
  half.create((src.rows + 1) / 2, (src.cols + 1) / 2, CV_32F);
  const auto make_row = src.depth() == CV_8U ? downsample2x_row<std::uint8_t> : downsample2x_row<std::uint16_t>;
  constexpr int kRowsAtATime = 16;
  parallel_for(half.rows, threads, kRowsAtATime, [&](int row) {
    thread_local std::vector<float> scratch;
    make_row(src, row, scratch, half.ptr<float>(row));
  });
}

cv::Rect needed_of_half(const cv::Rect& rect, cv::Size half) {
  const cv::Point begin(rect.x / 2 - kAround, rect.y / 2 - kAround);
  const cv::Point end((rect.br().x + 1) / 2 + kAround, (rect.br().y + 1) / 2 + kAround);
  return cv::Rect(begin, end) & cv::Rect({}, half);
}

void double_size(const cv::Rect& part, const float* pixels, const cv::Rect& rect, std::vector<float>& scratch,
                 float* result) {
  // Twice, for the zeros.
  constexpr float kFar = 2 * kHalvingTaps[0], kBehind = 2 * kHalvingTaps[1], kBefore = 2 * kHalvingTaps[2],
                  kNearest = 2 * kHalvingTaps[3];
  const int first = rect.x / 2 - kAround, count = (rect.br().x + 1) / 2 + kAround - first;
  // One row of the result at half its width, between what its ends repeat, and at its whole width.
  scratch.resize(3 * static_cast<std::size_t>(count));
  float *row = scratch.data(), *wide = row + count;
  const int begin = part.x - first;
  const auto pixels_at = [&](int y) {
    return pixels + static_cast<std::ptrdiff_t>(std::clamp(y - part.y, 0, part.height - 1)) * part.width;
  };
  for (int y = 0; y < rect.height; ++y) {
    const int at = (rect.y + y) / 2, behind = (rect.y + y) % 2 != 0 ? -1 : 1;  // to the row away from which it lies
    const float *far = pixels_at(at - 2 * behind), *before = pixels_at(at - behind), *own = pixels_at(at),
                *after = pixels_at(at + behind);
#pragma omp simd
    for (int x = 0; x < part.width; ++x) {
      row[begin + x] = kNearest * own[x] + kBefore * before[x] + kBehind * after[x] + kFar * far[x];
    }
    std::fill(row, row + begin, row[begin]);
    std::fill(row + begin + part.width, row + count, row[begin + part.width - 1]);
    for (int x = kAround; x < count - kAround; ++x) {
      wide[2 * (x - kAround)] = kNearest * row[x] + kBefore * row[x - 1] + kBehind * row[x + 1] + kFar * row[x - 2];
      wide[2 * (x - kAround) + 1] = kNearest * row[x] + kBefore * row[x + 1] + kBehind * row[x - 1] + kFar * row[x + 2];
    }
    std::copy_n(wide + rect.x % 2, rect.width, result + static_cast<std::ptrdiff_t>(y) * rect.width);
  }
}

}  // namespace gyro_deblur
