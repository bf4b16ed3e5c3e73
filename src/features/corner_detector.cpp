// Finds new corners by their strength.
#include "features/corner_detector.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>

namespace gyro_deblur {
namespace {

/// A row has as many blocks at most as a word has bits. They are wide by multiples of the longest vector.
constexpr int kBlocks = 64, kBlockStep = 16;

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

void CornerDetector::mark_free(const CornerRequest& request) {
  // Strengths are known from the third row on, and peaks have neighbours.
  constexpr int kLeastMargin = 4;
  const int margin = std::max(kLeastMargin, (request.margin_px + 2) / 2);
  block_width_ = kBlockStep * std::max(1, (width_ + kBlockStep * kBlocks - 1) / (kBlockStep * kBlocks));
  const int blocks = (width_ + block_width_ - 1) / block_width_;
  free_.create(height_, blocks * block_width_);
  free_.setTo(0);
  if (2 * margin < std::min(width_, height_)) {
    free_(cv::Rect(margin, margin, width_ - 2 * margin, height_ - 2 * margin)).setTo(1);
  }
  for (const Eigen::Vector2d& at_px : request.taken) clear_around(at_px, request.min_distance_px, &free_);
  blocks_with_free_.assign(static_cast<std::size_t>(height_), 0);
  for (int y = 0; y < height_; ++y) {
    for (int block = 0; block < blocks; ++block) {
      std::uint64_t any = 0, eight;
      for (int i = 0; i < block_width_; i += static_cast<int>(sizeof eight)) {
        std::memcpy(&eight, free_.ptr(y) + block * block_width_ + i, sizeof eight);
        any |= eight;
      }
      blocks_with_free_[static_cast<std::size_t>(y)] |= std::uint64_t{any != 0} << block;
    }
  }
}

template <typename Body>
void CornerDetector::for_each_free_run(int y, int around, Body&& body) const {
  std::uint64_t blocks = 0;
  for (int row = std::max(0, y - around); row <= std::min(height_ - 1, y + around); ++row) {
    blocks |= blocks_with_free_[static_cast<std::size_t>(row)];
  }
  while (blocks != 0) {
    const int first = __builtin_ctzll(blocks);
    const std::uint64_t beyond = ~blocks & (~std::uint64_t{0} << first);
    const int end = beyond != 0 ? __builtin_ctzll(beyond) : kBlocks;
    body(std::max(0, block_width_ * first - around), std::min(width_, block_width_ * end + around));
    blocks = end < kBlocks ? blocks & (~std::uint64_t{0} << end) : 0;
  }
}

void CornerDetector::rate(const cv::Mat& luminance) {
  strengths_.rate(
      width_, height_, [this](int y, int around, const auto& body) { for_each_free_run(y, around, body); },
      [&](int y, int first, int end, float* to) {
        simd_.downsample2x(luminance.ptr(2 * y) + 2 * first, luminance.ptr(2 * y + 1) + 2 * first, to, end - first);
      });
}

void CornerDetector::find_peaks() {
  peaks_.clear();
  columns_.resize(static_cast<std::size_t>(width_));
  for (int y = 1; y + 1 < height_; ++y) {
    for_each_free_run(y, 0, [&](int first, int end) {
      const float* strengths = strengths_.row(y);
      const int count = strengths_.find_peaks(y, first, end, columns_.data());
      for (int i = 0; i < count; ++i) {
        const int x = columns_[static_cast<std::size_t>(i)];
        if (free_(y, x) != 0) peaks_.push_back({strengths[x], x, y});
      }
    });
  }
}

std::vector<Eigen::Vector2d> CornerDetector::detect(const cv::Mat& luminance, const CornerRequest& request) {
  constexpr float kQuality = 0.01f;  // of the strongest; VINS-Mono has 0.01 as well
  width_ = luminance.cols / 2;
  height_ = luminance.rows / 2;
  mark_free(request);
  rate(luminance);
  find_peaks();
  const auto is_masked = [&](const Peak& peak) {
    return !request.allowed.empty() && request.allowed.at<uchar>(2 * peak.y, 2 * peak.x) == 0;
  };
  peaks_.erase(std::remove_if(peaks_.begin(), peaks_.end(), is_masked), peaks_.end());
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
