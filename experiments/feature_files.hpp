// Features of a frame as NumPy arrays, for programs outside this project.
#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/keypoints.hpp"

namespace gyro_deblur::experiments {

/// Writes a matrix as a NumPy array file, format version 1.0 (numpy.lib.format).
/// @param matrix  CV_8UC1, CV_32FC1 or CV_64FC1; any size, also without rows
/// Throws std::invalid_argument for other types, std::runtime_error with the path when it cannot be written.
void write_npy(const std::string& path, const cv::Mat& matrix);

/// Writes PREFIX_keypoints.npy, float32 (n, 6): x, y, size [px], angle [deg], rectified x, rectified y; and
/// PREFIX_descriptors.npy, uint8 (n, 128).
/// @param features  with SIFT's descriptors, whose values OpenCV rounds to integers in [0, 255]
/// @param points    one for each keypoint
/// Throws std::invalid_argument when these do not fit together.
void write_features(const std::string& prefix, const Features& features, const std::vector<RectifiedPoint>& points);

}  // namespace gyro_deblur::experiments
