#include "feature_files.hpp"

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <stdexcept>

#include "gyro_deblur/keypoints.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr int kSiftLength = 128;

const char* numpy_type(int type) {
  switch (type) {
    case CV_8UC1:
      return "|u1";
    case CV_32FC1:
      return "<f4";  // this project's processors are little-endian
    case CV_64FC1:
      return "<f8";
    default:
      throw std::invalid_argument("write_npy: OpenCV type " + std::to_string(type) + " is not 8U, 32F or 64F");
  }
}

}  // namespace

void write_npy(const std::string& path, const cv::Mat& matrix) {
  constexpr std::size_t kAlignment = 64;     // of the data, by the format
  constexpr std::size_t kPreambleSize = 10;  // magic, version and the header's length
  std::string header = std::string("{'descr': '") + numpy_type(matrix.type()) +
                       "', 'fortran_order': False, 'shape': (" + std::to_string(matrix.rows) + ", " +
                       std::to_string(matrix.cols) + "), }";
  while ((kPreambleSize + header.size() + 1) % kAlignment != 0) header += ' ';
  header += '\n';
  std::ofstream file(path, std::ios::binary);
  file.write("\x93NUMPY\x01\x00", 8);
  const auto length = static_cast<std::uint16_t>(header.size());
  file.put(static_cast<char>(length & 0xff));
  file.put(static_cast<char>(length >> 8));
  file << header;
  const std::streamsize row_bytes = static_cast<std::streamsize>(matrix.cols * matrix.elemSize());
  for (int y = 0; y < matrix.rows; ++y) file.write(reinterpret_cast<const char*>(matrix.ptr(y)), row_bytes);
  if (!file) throw std::runtime_error(path + ": cannot be written");
}

void write_features(const std::string& prefix, const Features& features, const std::vector<RectifiedPoint>& points) {
  const int count = static_cast<int>(features.keypoints.size());
  if (points.size() != features.keypoints.size() || features.descriptors.rows != count) {
    throw std::invalid_argument("write_features: " + std::to_string(count) + " keypoints, " +
                                std::to_string(points.size()) + " points and " +
                                std::to_string(features.descriptors.rows) + " descriptors");
  }
  if (count > 0 && features.descriptors.cols != kSiftLength) {
    throw std::invalid_argument("write_features: descriptors of " + std::to_string(features.descriptors.cols) +
                                " values are not SIFT's");
  }
  constexpr int kColumns = 6;
  cv::Mat keypoints(count, kColumns, CV_32F), descriptors(count, kSiftLength, CV_8U);
  if (count > 0) features.descriptors.convertTo(descriptors, CV_8U);
  for (int i = 0; i < count; ++i) {
    const cv::KeyPoint& k = features.keypoints[i];
    const Eigen::Vector2d& rectified = points[i].rectified_px;
    const float values[kColumns] = {
        k.pt.x, k.pt.y, k.size, k.angle, static_cast<float>(rectified.x()), static_cast<float>(rectified.y())};
    std::copy(values, values + kColumns, keypoints.ptr<float>(i));
  }
  write_npy(prefix + "_keypoints.npy", keypoints);
  write_npy(prefix + "_descriptors.npy", descriptors);
}

}  // namespace gyro_deblur::experiments
