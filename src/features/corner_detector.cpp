// Finds new corners by their strength.
#include "features/corner_detector.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace gyro_deblur {
namespace {

/// Place in the whole image of the middle of a pixel of half the size, in x or y.
double full_size(int at) { return 2 * at + 0.5; }

/// Sets the pixels of the image at half the size to 0 that are nearer than `distance_px` to a place in the whole one.
void clear_around(const Eigen::Vector2d& at_px, double distance_px, cv::Mat1b* half) {
  // Rows or columns nearer than away_px to a place: the first of them, and the one after the last.
  const auto behind = [](double at, double away_px) {
    return std::max(0, static_cast<int>(std::floor((at - away_px - 0.5) / 2)) + 1);
  };
  const auto ahead = [](double at, double away_px, int size) {
    return std::min(size, static_cast<int>(std::ceil((at + away_px - 0.5) / 2)));
  };
  const int end_row = ahead(at_px.y(), distance_px, half->rows);
  for (int y = behind(at_px.y(), distance_px); y < end_row; ++y) {
    const double wide_px = std::sqrt(std::max(0.0, std::pow(distance_px, 2) - std::pow(full_size(y) - at_px.y(), 2)));
    const int first = behind(at_px.x(), wide_px), end = ahead(at_px.x(), wide_px, half->cols);
    if (first < end) std::fill(half->ptr(y) + first, half->ptr(y) + end, uchar{0});
  }
}

}  // namespace

void CornerDetector::Plane::resize(int width, int height) {
  stride = width + 2 * kCornerRoom;
  pixels.resize(static_cast<std::size_t>(stride * height + kCornerRoom));
}

void CornerDetector::rate(const cv::Mat& luminance) {
  width_ = luminance.cols / 2;
  height_ = luminance.rows / 2;
  half_.resize(width_, height_);
  strengths_.resize(width_, height_);
  constexpr int kRows = 3;
  products_.resize(width_, 3 * kRows);  // one after the other
  const auto products = [this](int y) {
    const int first = 3 * (y % kRows);
    return GradientProducts{products_.row(first), products_.row(first + 1), products_.row(first + 2)};
  };
  for (int y = 0; y < height_; ++y) {
    simd_.downsample2x(luminance.ptr(2 * y), luminance.ptr(2 * y + 1), half_.row(y), width_);
    if (y < 2) continue;
    simd_.multiply(half_.row(y - 2), half_.row(y - 1), half_.row(y), products(y - 1), width_);
    if (y < 4) continue;
    const std::array<GradientProducts, kRows> rows{products(y - 3), products(y - 2), products(y - 1)};
    simd_.rate(rows.data(), strengths_.row(y - 2), width_);
  }
}

void CornerDetector::find_peaks(int margin) {
  peaks_.clear();
  columns_.resize(static_cast<std::size_t>(width_));
  for (int y = margin; y < height_ - margin; ++y) {
    const float* strengths = strengths_.row(y);
    const int count = simd_.find_peaks(strengths_.row(y - 1), strengths, strengths_.row(y + 1), margin, width_ - margin,
                                       columns_.data());
    for (int i = 0; i < count; ++i) {
      const int x = columns_[static_cast<std::size_t>(i)];
      peaks_.push_back({strengths[x], x, y});
    }
  }
}

std::vector<Eigen::Vector2d> CornerDetector::detect(const cv::Mat& luminance, const CornerRequest& request) {
  constexpr float kQuality = 0.01f;  // of the strongest; VINS-Mono has 0.01 as well
  // Strengths are known from the third row on, and peaks have neighbours.
  constexpr int kLeastMargin = 4;
  rate(luminance);
  find_peaks(std::max(kLeastMargin, (request.margin_px + 2) / 2));
  free_.create(height_, width_);
  free_.setTo(1);
  for (const Eigen::Vector2d& at_px : request.taken) clear_around(at_px, request.min_distance_px, &free_);
  const auto may_be = [&](const Peak& peak) {
    return free_(peak.y, peak.x) != 0 &&
           (request.allowed.empty() || request.allowed.at<uchar>(2 * peak.y, 2 * peak.x) != 0);
  };
  peaks_.erase(std::remove_if(peaks_.begin(), peaks_.end(), [&](const Peak& peak) { return !may_be(peak); }),
               peaks_.end());
  // Few are taken: a heap need not sort the others. Of equal ones the first in the image is first.
  const auto is_weaker = [](const Peak& a, const Peak& b) {
    if (a.strength != b.strength) return a.strength < b.strength;
    return a.y != b.y ? a.y > b.y : a.x > b.x;
  };
  std::make_heap(peaks_.begin(), peaks_.end(), is_weaker);
  std::vector<Eigen::Vector2d> corners;
  if (peaks_.empty()) return corners;
  const float least = kQuality * peaks_.front().strength;
  for (auto end = peaks_.end(); end != peaks_.begin() && static_cast<int>(corners.size()) < request.count;) {
    std::pop_heap(peaks_.begin(), end, is_weaker);
    --end;
    if (!(end->strength > 0) || end->strength < least) break;
    if (free_(end->y, end->x) == 0) continue;
    const Eigen::Vector2d at_px(full_size(end->x), full_size(end->y));
    clear_around(at_px, request.min_distance_px, &free_);
    corners.push_back(at_px);
  }
  return corners;
}

}  // namespace gyro_deblur
