// The blur field as a picture. Colours by status are decided here, for overlay and rviz markers alike.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur {

/// Colour of a status as (r, g, b), each 0..255.
cv::Vec3b status_color_rgb(BlockStatus status);

/// End points [px] of the segment that stands for a block's blur: its path, centred on the block.
struct BlurSegment {
  Eigen::Vector2d from_px, to_px;
};
BlurSegment blur_segment(const BlurField& field, int index);

/// `luminance` (CV_8UC1, the field's size) as CV_8UC3 BGR with the blur path of every block drawn in its status's
/// colour, and a legend: the median extent, what became of how many blocks, and a bar of 50 px for scale. Too small
/// images have no legend.
cv::Mat draw_overlay(const cv::Mat& luminance, const BlurField& field);

}  // namespace gyro_deblur
