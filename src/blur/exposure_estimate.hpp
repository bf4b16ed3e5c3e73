// How long an image was exposed, from its blur.
#pragma once

#include <optional>

#include <opencv2/core.hpp>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Estimates the exposure from one image: the transfer function of a block's path, scaled by the ratio, has to match
/// the block's power spectrum, whose zeros are where whole numbers of waves fit into a straight path. Texture is a
/// smooth function of the frequency, common to all blocks, times a factor for each. Not known (nothing) where there is
/// too little blur (below 5 px) or texture, too much noise, where blocks contradict each other, and where several
/// ratios fit nearly as well.
/// @param field              of the image, for field.exposure_ns; blocks of every status but NO_GYRO, MASKED and
///                           STATIC_EDGE are used whose extent is at least 2 px. Validation is not needed
/// @param luminance          CV_8UC1 of the field's size; not an image that was filtered or equalized, see
///                           doc/reports/exposure.md
/// @param noise_grey_levels  image_noise() of the luminance where that is known already
/// @param threads            at most; 0: one for each core
/// @param limit_ns           longest possible exposure (to a tenth), such as the frame period; 0: not known
/// Throws std::invalid_argument when luminance is not CV_8UC1 of the field's size.
std::optional<ExposureEstimate> estimate_exposure(const FrameBlur& field, const cv::Mat& luminance,
                                                  std::optional<double> noise_grey_levels = {}, int threads = 0,
                                                  TimeNs limit_ns = 0);

}  // namespace gyro_deblur
