// Names of block statuses, and geometry of the grid of blocks.
#include "gyro_deblur/frame_blur.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <stdexcept>

#include "base/format.hpp"

namespace gyro_deblur {

const char* to_string(BlockStatus status) {
  static constexpr const char* kNames[]{"SHARP",      "DEBLURRED", "REJECTED", "TOO_LARGE",  "NO_GYRO",
                                        "TOO_CURVED", "NOISY",     "MASKED",   "STATIC_EDGE"};
  static_assert(std::size(kNames) == kBlockStatuses.size());
  const auto i = static_cast<std::size_t>(status);
  return i < std::size(kNames) ? kNames[i] : "UNKNOWN";
}

BlockGrid::BlockGrid(int width_px, int height_px, int block_size_px)
    : width_px_(width_px), height_px_(height_px), block_size_px_(block_size_px) {
  if (width_px < 1 || height_px < 1 || block_size_px < 1) {
    throw std::invalid_argument(format("BlockGrid: %d x %d px in blocks of %d px: sizes must be at least 1", width_px,
                                       height_px, block_size_px));
  }
  cols_ = (width_px - 1) / block_size_px + 1;
  rows_ = (height_px - 1) / block_size_px + 1;
}

cv::Rect BlockGrid::rect(int index) const {
  const int x = index % cols_ * block_size_px_;
  const int y = index / cols_ * block_size_px_;
  return {x, y, std::min(block_size_px_, width_px_ - x), std::min(block_size_px_, height_px_ - y)};
}

Eigen::Vector2d BlockGrid::center(int index) const {
  const cv::Rect block = rect(index);
  return {block.x + 0.5 * (block.width - 1), block.y + 0.5 * (block.height - 1)};
}

int BlockGrid::index_at(double x_px, double y_px) const {
  // Pixel i covers [i - 0.5, i + 0.5). Clamped before the conversion: a large double has no int.
  const int x = static_cast<int>(std::clamp(std::floor(x_px + 0.5), 0.0, width_px_ - 1.0));
  const int y = static_cast<int>(std::clamp(std::floor(y_px + 0.5), 0.0, height_px_ - 1.0));
  return y / block_size_px_ * cols_ + x / block_size_px_;
}

std::array<BlockGrid::Neighbour, 4> BlockGrid::around(const Eigen::Vector2d& pixel_px) const {
  struct Between {
    int first, second;
    double share_of_second;
  };
  const auto between = [this](double place_px, int count, int length_px) -> Between {
    const auto center = [&](int i) {
      return 0.5 * (i * block_size_px_ + std::min((i + 1) * block_size_px_, length_px) - 1);
    };
    const double first = std::clamp((place_px - center(0)) / block_size_px_, 0.0, std::max(0, count - 2) * 1.0);
    const int i = static_cast<int>(first);
    if (i + 1 >= count) return {i, i, 0};
    return {i, i + 1, std::clamp((place_px - center(i)) / (center(i + 1) - center(i)), 0.0, 1.0)};
  };
  const Between col = between(pixel_px.x(), cols_, width_px_), row = between(pixel_px.y(), rows_, height_px_);
  const double u = col.share_of_second, v = row.share_of_second;
  return {{{row.first * cols_ + col.first, (1 - v) * (1 - u)},
           {row.first * cols_ + col.second, (1 - v) * u},
           {row.second * cols_ + col.first, v * (1 - u)},
           {row.second * cols_ + col.second, v * u}}};
}

void BlockGrid::require_luminance(const cv::Mat& luminance, const char* who) const {
  if (luminance.type() == CV_8UC1 && luminance.cols == width_px_ && luminance.rows == height_px_) return;
  throw std::invalid_argument(
      format("%s needs 8-bit luminance of the blur field's size, %dx%d px, not OpenCV type %d of %dx%d px", who,
             width_px_, height_px_, luminance.type(), luminance.cols, luminance.rows));
}

std::size_t FrameBlur::count(BlockStatus status) const {
  return std::count_if(blocks.begin(), blocks.end(), [status](const BlockBlur& b) { return b.status == status; });
}

void FrameBlur::reject_all() {
  for (BlockBlur& block : blocks) {
    if (block.status == BlockStatus::DEBLURRED) block.status = BlockStatus::REJECTED;
  }
}

Eigen::Vector2d BlockBlur::apparent_offset_px() const {
  const Eigen::Vector2d mean_px = mean_place_px.cast<double>();
  if (status != BlockStatus::DEBLURRED) return mean_px;
  if (curved_path_px) return Eigen::Vector2d::Zero();
  const Eigen::Vector2d line(std::cos(angle_rad), std::sin(angle_rad));
  // Extent at which a corner starts to follow the box: for shorter blur the blur's own centre remains. Measured on
  // corners at 10 to 60 px by experiments/optical_flow, whose slopes it brings to 1 within 0.05.
  constexpr double kCornerPx = 7.5;
  const Eigen::Vector2d middle_px =
      (1 - kCornerPx / std::max<double>(extent_px, kCornerPx)) * (chord_middle_px.cast<double>() - mean_px);
  const double along_px = nonuniform_path_px ? -line.dot(mean_px) : line.dot(middle_px);
  return mean_px + along_px * line;
}

double axial_angle(double dx, double dy) {
  double angle_rad = std::atan2(dy, dx);
  if (angle_rad < 0) angle_rad += CV_PI;
  return angle_rad < CV_PI ? angle_rad : 0;
}

}  // namespace gyro_deblur
