// Marks the blocks that a mask covers, and those whose filter would read masked pixels.
#include "gyro_deblur/pixel_mask.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>

#include <opencv2/imgproc.hpp>

#include "base/format.hpp"
#include "blur/path_2d.hpp"
#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur {
namespace {

/// Seams between filters are up to 4 px wide (src/engine/seam_blender.hpp), and a filter at half the size reads as much
/// beyond its taps.
constexpr int kMarginPx = 8;

cv::Rect widened(const cv::Rect& rect, int x_px, int y_px) {
  return {rect.x - x_px, rect.y - y_px, rect.width + 2 * x_px, rect.height + 2 * y_px};
}

/// Whether a pixel that the block's filter reads is masked.
bool reads_masked(const PixelMask& mask, const cv::Rect& rect, const BlockBlur& blur, int block_size_px,
                  const FilterReach& reach) {
  const double half_px = 0.5 * reach.length_factor * blur.extent_px;
  if (blur.curved_path_px || reach.in_2d) {
    // Windows of the Fourier transform end with the neighbouring blocks (src/engine/fourier_filter.hpp).
    const int around_px = std::max(static_cast<int>(std::ceil(half_px)), block_size_px) + kMarginPx;
    return mask.masked_in(widened(rect, around_px, around_px)) > 0;
  }
  const cv::Rect with_seams = widened(rect, kMarginPx, kMarginPx);
  const double dx = std::cos(blur.angle_rad), dy = std::sin(blur.angle_rad);
  const int steps = static_cast<int>(std::ceil(half_px / kMarginPx));
  for (int i = -steps; i <= steps; ++i) {
    const double along_px = steps == 0 ? 0 : i * half_px / steps;
    const cv::Point shift(static_cast<int>(std::lround(along_px * dx)), static_cast<int>(std::lround(along_px * dy)));
    if (mask.masked_in(with_seams + shift) > 0) return true;
  }
  return false;
}

/// Whether a 1-D filter still gains on a block of a curved path.
bool is_slightly_curved(const BlockBlur& blur) {
  if (!blur.curved_path_px) return false;
  const Eigen::Vector2f extent_px = extent_along(*blur.curved_path_px, blur.angle_rad);
  return excess_deviation_px(extent_px.x(), extent_px.y()) <= kMaxStraightDeviationPx;
}

void require_size(const PixelMask& mask, const FrameBlur& field) {
  if (mask.size() == cv::Size(field.grid.width_px(), field.grid.height_px())) return;
  throw std::invalid_argument(format("mask of %dx%d px does not fit a blur field of %dx%d px", mask.size().width,
                                     mask.size().height, field.grid.width_px(), field.grid.height_px()));
}

}  // namespace

PixelMask::PixelMask(const cv::Mat& used) {
  if (used.empty() || used.type() != CV_8UC1) throw std::invalid_argument("a mask is CV_8UC1 and not empty");
  used_ = used != 0;
  if (cv::countNonZero(used_) == 0) throw std::invalid_argument("a mask without a pixel that is used");
  cv::Mat masked;
  cv::threshold(used_, masked, 0, 1, cv::THRESH_BINARY_INV);
  cv::integral(masked, masked_sums_, CV_32S);
}

cv::Mat PixelMask::with_used_window(int half_px) const {
  cv::Mat whole;
  if (empty()) return whole;
  const int side_px = 2 * half_px + 1;
  cv::erode(used_, whole, cv::getStructuringElement(cv::MORPH_RECT, {side_px, side_px}));
  return whole;
}

int PixelMask::masked_in(const cv::Rect& rect) const {
  const cv::Rect inside = rect & cv::Rect({}, size());
  if (inside.empty()) return 0;
  const auto sum = [this](int x, int y) { return masked_sums_.at<std::int32_t>(y, x); };
  const cv::Point end = inside.br();
  return sum(end.x, end.y) - sum(inside.x, end.y) - sum(end.x, inside.y) + sum(inside.x, inside.y);
}

void mark_masked(const PixelMask& mask, FrameBlur* field) {
  if (mask.empty()) return;
  require_size(mask, *field);
  if (field->count(BlockStatus::NO_GYRO) == field->blocks.size()) return;
  for (int i = 0; i < field->grid.size(); ++i) {
    const cv::Rect rect = field->grid.rect(i);
    if (mask.masked_in(rect) == rect.area()) field->blocks[static_cast<std::size_t>(i)].status = BlockStatus::MASKED;
  }
}

void mark_static_edges(const PixelMask& mask, const FilterReach& reach, FrameBlur* field) {
  if (mask.empty()) return;
  require_size(mask, *field);
  for (int i = 0; i < field->grid.size(); ++i) {
    BlockBlur& block = field->blocks[static_cast<std::size_t>(i)];
    if (block.status != BlockStatus::DEBLURRED) continue;
    const auto reads = [&](const BlockBlur& blur) {
      return reads_masked(mask, field->grid.rect(i), blur, field->grid.block_size_px(), reach);
    };
    if (!reads(block)) continue;
    BlockBlur straight = block;
    straight.curved_path_px.reset();
    if (is_slightly_curved(block) && !reads(straight)) {
      block = straight;
    } else {
      block.status = BlockStatus::STATIC_EDGE;
    }
  }
}

}  // namespace gyro_deblur
