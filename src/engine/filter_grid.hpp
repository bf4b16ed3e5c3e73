// What every engine asks of an image and its grid.
#pragma once

#include <opencv2/core.hpp>

#include "gyro_deblur/engine.hpp"

namespace gyro_deblur {

/// Throws std::invalid_argument unless `src` is a non-empty CV_8U or CV_16U with 1 to 4 channels, and `grid` covers it.
void require_filterable(const cv::Mat& src, const FilterGrid& grid);

}  // namespace gyro_deblur
