// How strong the noise of an image is.
#pragma once

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// Standard deviation [grey levels] of the noise where the image is smoothest: the least tenth of what small cells have
/// left after the operator of J. Immerkaer, Computer Vision and Image Understanding 64 (2), 1996, which takes planes
/// away. Cells at the ends of the range of grey levels, where noise is clipped, do not count; 0 where no cell does.
/// @param luminance  CV_8UC1
double frame_noise(const cv::Mat& luminance);

}  // namespace gyro_deblur
