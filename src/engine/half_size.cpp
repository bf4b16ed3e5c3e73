// Downsamples an image by two and upsamples the result.
#include "engine/half_size.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/parallel.hpp"

namespace gyro_deblur {
namespace {

/// One row of downsample2x(). `lowpass_rows` is of HalfSizeSimd.
template <typename Pixel, typename LowpassRows>
void downsample2x_row(const cv::Mat& src, int row, LowpassRows lowpass_rows, const HalfSizeSimd& simd,
                      std::vector<float>& scratch, float* to) {
  const int width = src.cols, half_width = (width + 1) / 2;
  const Pixel* rows[kHalvingTapCount];
  for (int k = 0; k < kHalvingTapCount; ++k) {
    rows[k] = src.ptr<Pixel>(std::clamp(2 * row - kHalvingReach + k, 0, src.rows - 1));
  }
  scratch.resize(2 * half_width + 2 * kHalvingReach);
  float* sums = scratch.data() + kHalvingReach;
  lowpass_rows(rows, width, sums);
  std::fill(sums - kHalvingReach, sums, sums[0]);
  std::fill(sums + width, sums + 2 * half_width + kHalvingReach, sums[width - 1]);
  simd.decimate(sums, half_width, to);
}

}  // namespace

double lowpass_response(double f) {
  double sum = 0;
  for (int k = 0; k <= kHalvingReach; ++k) {
    sum += 2 * kHalvingTaps[k] * std::cos(2 * CV_PI * f * (kHalvingReach + 0.5 - k));
  }
  return sum;
}

void downsample2x(const cv::Mat& src, int threads, cv::Mat& half, const HalfSizeSimd& simd) {
  half.create((src.rows + 1) / 2, (src.cols + 1) / 2, CV_32F);
  constexpr int kRowsAtATime = 16;
  parallel_for(half.rows, threads, kRowsAtATime, [&](int row) {
    thread_local std::vector<float> scratch;
    float* to = half.ptr<float>(row);
    if (src.depth() == CV_8U) {
      downsample2x_row<std::uint8_t>(src, row, simd.lowpass_bytes, simd, scratch, to);
    } else {
      downsample2x_row<std::uint16_t>(src, row, simd.lowpass_words, simd, scratch, to);
    }
  });
}

cv::Rect needed_of_half(const cv::Rect& rect, cv::Size half) {
  const cv::Point begin(rect.x / 2 - kDoublingReach, rect.y / 2 - kDoublingReach);
  const cv::Point end((rect.br().x + 1) / 2 + kDoublingReach, (rect.br().y + 1) / 2 + kDoublingReach);
  return cv::Rect(begin, end) & cv::Rect({}, half);
}

void double_size(const cv::Rect& part, const float* pixels, const cv::Rect& rect, std::vector<float>& scratch,
                 float* result, const HalfSizeSimd& simd) {
  const int first = rect.x / 2 - kDoublingReach, count = (rect.br().x + 1) / 2 + kDoublingReach - first;
  // One row of the result at half its width, between what its ends repeat, and at its whole width.
  scratch.resize(3 * static_cast<std::size_t>(count));
  float *row = scratch.data(), *wide = row + count;
  const int begin = part.x - first;
  const auto pixels_at = [&](int y) {
    return pixels + static_cast<std::ptrdiff_t>(std::clamp(y - part.y, 0, part.height - 1)) * part.width;
  };
  // A rectangle that begins and ends between pairs has no pixel to leave out.
  const bool is_whole = rect.x % 2 == 0 && rect.width % 2 == 0;
  for (int y = 0; y < rect.height; ++y, result += rect.width) {
    const int at = (rect.y + y) / 2, behind = (rect.y + y) % 2 != 0 ? -1 : 1;  // to the row away from which it lies
    const float* rows[] = {pixels_at(at), pixels_at(at - behind), pixels_at(at + behind), pixels_at(at - 2 * behind)};
    simd.interpolate_down(rows, part.width, row + begin);
    std::fill(row, row + begin, row[begin]);
    std::fill(row + begin + part.width, row + count, row[begin + part.width - 1]);
    simd.interpolate_across(row + kDoublingReach, count - 2 * kDoublingReach, is_whole ? result : wide);
    if (!is_whole) std::copy_n(wide + rect.x % 2, rect.width, result);
  }
}

}  // namespace gyro_deblur
