// A camera that rolls during the exposure: every block has its own angle and extent of blur.
#pragma once

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::test {

/// Rotation of the image about a pivot from start to end of the exposure.
struct Roll {
  cv::Point2d pivot_px;
  double rotation_rad = 0;

  /// About the image centre, with the given mean extent over the image's blocks.
  static Roll about_center(int width_px, int height_px, double mean_extent_px, int block_size_px = 64) {
    Roll roll{{(width_px - 1) / 2.0, (height_px - 1) / 2.0}, 0};
    const BlockGrid grid(width_px, height_px, block_size_px);
    double radius_sum = 0;
    for (int i = 0; i < grid.size(); ++i) radius_sum += roll.radius_px(grid.center(i).x(), grid.center(i).y());
    roll.rotation_rad = mean_extent_px * grid.size() / radius_sum;
    return roll;
  }

  double radius_px(double x, double y) const { return std::hypot(x - pivot_px.x, y - pivot_px.y); }

  /// The blur of every block, tangential to the circle about the pivot.
  FrameBlur field(int width_px, int height_px, const BlurFieldOptions& options) const {
    FrameBlur field;
    field.grid = BlockGrid(width_px, height_px, options.block_size_px);
    for (int i = 0; i < field.grid.size(); ++i) {
      const Eigen::Vector2d c = field.grid.center(i);
      field.blocks.push_back(
          classify_blur(-rotation_rad * (c.y() - pivot_px.y), rotation_rad * (c.x() - pivot_px.x), options));
    }
    return field;
  }

  /// What the camera records: the mean of `sharp` (CV_8UC1) over the exposure, centred in time, in steps of at most one
  /// pixel at the far corner. CV_32F; mirrored outside the image.
  cv::Mat blur(const cv::Mat& sharp) const {
    double farthest = 0;
    for (const int x : {0, sharp.cols - 1}) {
      for (const int y : {0, sharp.rows - 1}) farthest = std::max(farthest, radius_px(x, y));
    }
    const int steps = std::max(1, static_cast<int>(std::ceil(farthest * std::abs(rotation_rad))));
    cv::Mat real, sum(sharp.size(), CV_32F, cv::Scalar(0)), rotated;
    sharp.convertTo(real, CV_32F);
    for (int i = 0; i < steps; ++i) {
      const double angle_deg = rotation_rad * ((i + 0.5) / steps - 0.5) * 180 / CV_PI;
      const cv::Mat map = cv::getRotationMatrix2D(cv::Point2f(pivot_px), angle_deg, 1);
      cv::warpAffine(real, rotated, map, real.size(), cv::INTER_CUBIC, cv::BORDER_REFLECT_101);
      sum += rotated;
    }
    return sum / steps;
  }
};

/// Mean gradient [grey levels / px] across the block borders of `grid` over that across all other pairs of neighbours.
/// `image` has one channel. 1 where blocks leave no trace.
inline double border_contrast(const cv::Mat& image, const BlockGrid& grid) {
  cv::Mat real;
  image.convertTo(real, CV_32F);
  double border_sum = 0, inside_sum = 0;
  double border_count = 0, inside_count = 0;
  const auto add = [&](double sum, int count, bool is_border) {
    (is_border ? border_sum : inside_sum) += sum;
    (is_border ? border_count : inside_count) += count;
  };
  for (int x = 1; x < real.cols; ++x) {
    add(cv::norm(real.col(x), real.col(x - 1), cv::NORM_L1), real.rows, x % grid.block_size_px() == 0);
  }
  for (int y = 1; y < real.rows; ++y) {
    add(cv::norm(real.row(y), real.row(y - 1), cv::NORM_L1), real.cols, y % grid.block_size_px() == 0);
  }
  return (border_sum / border_count) / (inside_sum / inside_count);
}

}  // namespace gyro_deblur::test
