// Comparison of the predicted blur with the image (paper section III-D).
#pragma once

#include <optional>

#include <opencv2/core.hpp>

#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur {

/// Strongest response [grey levels / px] of the Sobel filter rotated to `angle_rad` inside `block`. The Sobel pair is
/// normalised by 1/8, so a ramp of one grey level a pixel along the angle gives 1.
/// @param luminance  CV_8UC1; neighbours outside the image are replicated
/// @param block      non-empty, inside the image
float max_gradient_along(const cv::Mat& luminance, const cv::Rect& block, double angle_rad);

/// Extent [px] of the box that blurs a step as little as the slowest part of this path does: extent_px at uniform
/// speed, less at non-uniform speed.
double steepest_box_px(const BlockBlur& blur);

/// Returns `field` with those DEBLURRED blocks set to REJECTED that the image contradicts, by options.rule. LIKELIHOOD:
/// those whose log likelihood ratio, with what the neighbours and the frame say, is below the threshold for
/// options.false_accept_rate; without evidence the prediction holds; and those below 5 px that GRADIENT
/// rejects, asked of them alone. GRADIENT: those whose gradient along the predicted motion exceeds
/// options.threshold(steepest_box_px), and those more than half of whose validated neighbours were rejected so; all of
/// them when more than four in five were. NONE: no block. On at most `threads` threads (0: one for each core).
/// @param noise_grey_levels  image_noise() of the luminance where that is known already
/// Throws std::invalid_argument when luminance is not CV_8UC1 of the field's size.
FrameBlur validate_blur_field(const FrameBlur& field, const cv::Mat& luminance, const ValidationOptions& options,
                              int threads = 0, std::optional<double> noise_grey_levels = {});

}  // namespace gyro_deblur
