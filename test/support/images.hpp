// Small helpers for tests that compare images.
#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

namespace gyro_deblur::test {

/// Even distribution over the whole range of CV_8U or CV_16U.
inline cv::Mat random_image(int width, int height, int type, std::uint64_t seed) {
  cv::Mat image(height, width, type);
  cv::RNG rng(seed);
  rng.fill(image, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_8U ? 256 : 65536);
  return image;
}

inline bool equal(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0;
}

}  // namespace gyro_deblur::test
