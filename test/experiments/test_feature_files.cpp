// Feature files as NumPy defines them; test_reconstruction.py reads them with NumPy itself.
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>

#include "feature_files.hpp"
#include "gyro_deblur/keypoints.hpp"

namespace gyro_deblur::experiments {
namespace {

class FeatureFiles : public ::testing::Test {
 protected:
  void SetUp() override { std::filesystem::create_directories(folder_); }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string read(const std::string& name) const {
    std::ifstream file(folder_ / name, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("gyro_deblur_feature_files_" + std::to_string(getpid()));
};

TEST_F(FeatureFiles, HeaderAndValuesAreThoseOfTheFormat) {
  const cv::Mat matrix = (cv::Mat_<float>(2, 3) << 1, 2, 3, 4, 5, 6.5);
  write_npy((folder_ / "a.npy").string(), matrix);
  const std::string bytes = read("a.npy");
  ASSERT_GT(bytes.size(), 10u);
  EXPECT_EQ(bytes.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const std::size_t length = static_cast<unsigned char>(bytes[8]) + 256 * static_cast<unsigned char>(bytes[9]);
  EXPECT_EQ((10 + length) % 64, 0u);
  const std::string header = bytes.substr(10, length);
  EXPECT_EQ(header.back(), '\n');
  EXPECT_EQ(header.substr(0, header.find('}') + 1), "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }");
  ASSERT_EQ(bytes.size(), 10 + length + 6 * sizeof(float));
  EXPECT_EQ(std::memcmp(bytes.data() + 10 + length, matrix.data, 6 * sizeof(float)), 0);
}

TEST_F(FeatureFiles, WritesRowsOfARegionOnly) {
  const cv::Mat whole = (cv::Mat_<uchar>(2, 4) << 1, 2, 3, 4, 5, 6, 7, 8);
  write_npy((folder_ / "a.npy").string(), whole.colRange(1, 3));
  const std::string bytes = read("a.npy");
  EXPECT_EQ(bytes.substr(bytes.size() - 4), std::string("\x02\x03\x06\x07"));
}

TEST_F(FeatureFiles, RefusesWhatDoesNotFit) {
  EXPECT_THROW(write_npy((folder_ / "a.npy").string(), cv::Mat(1, 1, CV_32FC3)), std::invalid_argument);
  EXPECT_THROW(write_npy((folder_ / "absent" / "a.npy").string(), cv::Mat(1, 1, CV_8U)), std::runtime_error);
  Features features;
  features.keypoints.emplace_back(1.f, 2.f, 3.f);
  features.descriptors = cv::Mat::zeros(1, 128, CV_32F);
  EXPECT_THROW(write_features((folder_ / "f").string(), features, {}), std::invalid_argument);
  features.descriptors = cv::Mat::zeros(1, 32, CV_8U);
  RectifiedPoint at_origin;
  at_origin.rectified_px = at_origin.normalized = Eigen::Vector2d::Zero();
  EXPECT_THROW(write_features((folder_ / "f").string(), features, {at_origin}), std::invalid_argument);
}

TEST_F(FeatureFiles, WritesFramesWithoutKeypoints) {
  write_features((folder_ / "f").string(), Features{}, {});
  EXPECT_NE(read("f_keypoints.npy").find("(0, 6)"), std::string::npos);
  EXPECT_NE(read("f_descriptors.npy").find("(0, 128)"), std::string::npos);
}

}  // namespace
}  // namespace gyro_deblur::experiments
