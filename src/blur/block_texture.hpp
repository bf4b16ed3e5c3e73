// How much texture there is in a block to be restored.
#pragma once

#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// The strength c [grey levels^2 cycles/px] of a block's texture, whose power along the line of its blur is taken to be
/// c / f^2 at f cycles/px before it was blurred: from its gradients across the line, which blur has left as they were,
/// and from those along it, of which blur has left a known part. What noise adds to them is taken out. >= 0.
/// @param luminance       CV_8UC1
/// @param block           inside the image
/// @param noise_variance  of the luminance [grey levels^2]
double texture_along_line(const cv::Mat& luminance, const cv::Rect& block, double angle_rad, double extent_px,
                          double noise_variance);

}  // namespace gyro_deblur
