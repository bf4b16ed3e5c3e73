// Images at half their size, and back.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "engine/half_size_simd.hpp"

namespace gyro_deblur {

/// Gain of the low pass at f cycles/px, along one axis.
double lowpass_response(double f);

/// Low pass, and every second pixel: pixel (x, y) of `half` is what is at (2 x + 1/2, 2 y + 1/2). Outside of the image
/// its edge goes on. On at most `threads` threads.
/// @param src   CV_8UC1 or CV_16UC1, not empty
/// @param half  CV_32FC1 with half of the columns and rows, rounded up; (re)allocated when needed
void downsample2x(const cv::Mat& src, int threads, cv::Mat& half,
                  const HalfSizeSimd& simd = select_for_cpu<HalfSizeSimd>());

/// What double_size() takes for `rect` of an image from its half, which has the size `half`.
cv::Rect needed_of_half(const cv::Rect& rect, cv::Size half);

/// What is in `rect` of an image at twice the size: zeros between the pixels, and the low pass.
/// @param part     needed_of_half(rect, ...), and its pixels, row by row
/// @param scratch  memory that is kept
/// @param result   rect.area() floats, row by row
void double_size(const cv::Rect& part, const float* pixels, const cv::Rect& rect, std::vector<float>& scratch,
                 float* result, const HalfSizeSimd& simd = select_for_cpu<HalfSizeSimd>());

}  // namespace gyro_deblur
