// Finds new corners by their strength.
#include "features/corner_detector.hpp"

#include <algorithm>
#include <array>
#include <cstddef>

namespace gyro_deblur {
namespace {

/// Points that keep a distance, found by squares of that side.
class Spacing {
 public:
  Spacing(const cv::Size& size, double distance_px)
      : distance_px_(distance_px),
        side_px_(std::max(kLeastSidePx, distance_px)),
        cols_(static_cast<int>(size.width / side_px_) + 1),
        rows_(static_cast<int>(size.height / side_px_) + 1),
        points_(static_cast<std::size_t>(cols_ * rows_)) {}

  bool is_free(const Eigen::Vector2d& at_px) const {
    const int col = col_of(at_px.x()), row = row_of(at_px.y());
    for (int y = std::max(0, row - 1); y <= std::min(rows_ - 1, row + 1); ++y) {
      for (int x = std::max(0, col - 1); x <= std::min(cols_ - 1, col + 1); ++x) {
        for (const Eigen::Vector2d& point_px : points_[static_cast<std::size_t>(y * cols_ + x)]) {
          if ((point_px - at_px).squaredNorm() < distance_px_ * distance_px_) return false;
        }
      }
    }
    return true;
  }
  void add(const Eigen::Vector2d& at_px) {
    points_[static_cast<std::size_t>(row_of(at_px.y()) * cols_ + col_of(at_px.x()))].push_back(at_px);
  }

 private:
  static constexpr double kLeastSidePx = 8;
  int col_of(double x_px) const { return std::clamp(static_cast<int>(x_px / side_px_), 0, cols_ - 1); }
  int row_of(double y_px) const { return std::clamp(static_cast<int>(y_px / side_px_), 0, rows_ - 1); }

  double distance_px_, side_px_;
  int cols_, rows_;
  std::vector<std::vector<Eigen::Vector2d>> points_;
};

/// Pixel of the whole image, of one of half the size.
Eigen::Vector2d full_size(int x, int y) { return {2 * x + 0.5, 2 * y + 0.5}; }

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
  columns_.resize(static_cast<std::size_t>(std::max(0, width_)));
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
  Spacing spacing(luminance.size(), request.min_distance_px);
  for (const Eigen::Vector2d& at_px : request.taken) spacing.add(at_px);
  const auto may_be = [&](const Peak& peak) {
    return (request.allowed.empty() || request.allowed.at<uchar>(2 * peak.y, 2 * peak.x) != 0) &&
           spacing.is_free(full_size(peak.x, peak.y));
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
    const Eigen::Vector2d at_px = full_size(end->x, end->y);
    if (!spacing.is_free(at_px)) continue;
    spacing.add(at_px);
    corners.push_back(at_px);
  }
  return corners;
}

}  // namespace gyro_deblur
