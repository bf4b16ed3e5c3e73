// The blur field as a picture. Colours by status are decided here, for both overlay and rviz markers.
#pragma once

#include <optional>
#include <vector>

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
BlurSegment blur_segment(const FrameBlur& field, int index);

/// Colour of residual velocities as (r, g, b), each 0..255.
cv::Vec3b residual_color_rgb();

/// Displacement [px] by a block's residual velocity within the exposure, from the block's centre; nothing if the block
/// has none.
std::optional<BlurSegment> residual_segment(const FrameBlur& field, int index);

/// Which blocks' paths to draw so that none comes nearer to another than `gap_px` (>= 0): 1 for those, else 0, row by
/// row. Of paths that overlap the first is drawn. Where all are far enough apart all are drawn.
std::vector<char> paths_apart(const FrameBlur& field, double gap_px);

/// `luminance` (CV_8UC1, the field's size) as CV_8UC3 BGR with a dot in the colour of its status on every block, the
/// blur paths in true length of as many blocks as do not overlap, and a legend: the median extent, the number of blocks
/// by status, the number of drawn paths, and a bar of 50 px for scale. Too small images have no legend.
/// A ring marks a block with a residual velocity, a line from its dot the displacement by it, in true length and
/// direction. The legend has their number and median.
cv::Mat draw_overlay(const cv::Mat& luminance, const FrameBlur& field);

}  // namespace gyro_deblur
