#include "features/corner_detector.hpp"

#include <algorithm>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

namespace gyro_deblur::corner_detector_test {
namespace {

const cv::Size kSize(321, 243);  // odd: the last column and row have no half
const cv::Mat kNoMask;
const std::vector<Eigen::Vector2d> kNone;

/// Bright squares of 20 px, 40 px apart; the darker ones on the right.
cv::Mat squares() {
  cv::Mat image(kSize, CV_8UC1, cv::Scalar(60));
  for (int y = 20; y + 20 < kSize.height; y += 40) {
    for (int x = 20; x + 20 < kSize.width; x += 40) {
      image(cv::Rect(x, y, 20, 20)) = cv::Scalar(x < 160 ? 200 : 120);
    }
  }
  return image;
}

/// From the nearest corner of a square.
double distance_px(const Eigen::Vector2d& at_px) {
  const auto away = [](double v) {
    const double from_edge = v - 19.5;  // between two pixels
    return std::abs(from_edge - 20 * std::round(from_edge / 20));
  };
  return std::hypot(away(at_px.x()), away(at_px.y()));
}

TEST(CornerDetector, FindsCornersTheStrongestFirst) {
  CornerDetector detector;
  const std::vector<Eigen::Vector2d> corners = detector.detect(squares(), {80, 10, 10, kNoMask, kNone});
  ASSERT_EQ(corners.size(), 80u);
  for (const Eigen::Vector2d& corner_px : corners) EXPECT_LT(distance_px(corner_px), 3) << corner_px.transpose();
  const auto of_bright =
      std::count_if(corners.begin(), corners.begin() + 60, [](const Eigen::Vector2d& c) { return c.x() < 165; });
  EXPECT_EQ(of_bright, 60);
}

TEST(CornerDetector, KeepsDistanceMarginAndMask) {
  CornerDetector detector;
  cv::RNG rng(7);
  cv::Mat image(kSize, CV_8UC1);
  rng.fill(image, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(image, image, {}, 2);
  cv::Mat mask(kSize, CV_8UC1, cv::Scalar(255));
  mask(cv::Rect(100, 0, 60, kSize.height)) = cv::Scalar(0);
  const std::vector<Eigen::Vector2d> taken{{50, 60}, {200, 120}, {300, 30}};
  const std::vector<Eigen::Vector2d> corners = detector.detect(image, {1000, 17, 21, mask, taken});
  EXPECT_GT(corners.size(), 60u);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector2d& at_px = corners[i];
    EXPECT_GT(std::min({at_px.x(), at_px.y(), 320 - at_px.x(), 242 - at_px.y()}), 21);
    EXPECT_TRUE(at_px.x() < 100 || at_px.x() > 160);
    for (const Eigen::Vector2d& other_px : taken) EXPECT_GE((at_px - other_px).norm(), 17);
    for (std::size_t k = 0; k < i; ++k) EXPECT_GE((at_px - corners[k]).norm(), 17);
  }
  EXPECT_EQ(detector.detect(image, {5, 17, 21, mask, taken}).size(), 5u);
  // What was taken before, and what lies on or beyond the edge, does not matter.
  const std::vector<Eigen::Vector2d> at_edge{{-3.2, 10}, {319.9, 241.7}, {0, 300}};
  EXPECT_EQ(detector.detect(image, {1000, 16.3, 21, mask, at_edge}),
            CornerDetector().detect(image, {1000, 16.3, 21, mask, kNone}));
}

TEST(CornerDetector, RatesAsIfAllWereRated) {
  CornerDetector detector;
  cv::RNG rng(11);
  for (const cv::Size size : {kSize, cv::Size(2310, 90), cv::Size(40, 300)}) {  // one wider than 64 blocks of 16
    cv::Mat image(size, CV_8UC1);
    rng.fill(image, cv::RNG::UNIFORM, 0, 256);
    cv::GaussianBlur(image, image, {}, 1.5);
    for (const int count : {3, 40, 400}) {
      constexpr double kDistancePx = 14;
      std::vector<Eigen::Vector2d> taken;
      for (int i = 0; i < count; ++i)
        taken.emplace_back(rng.uniform(0., 1. * size.width), rng.uniform(0., 1. * size.height));
      // The same pixels are left out after everything was rated.
      cv::Mat mask(size, CV_8UC1, cv::Scalar(255));
      for (int y = 0; y < size.height; ++y) {
        for (int x = 0; x < size.width; ++x) {
          const Eigen::Vector2d middle_px(2 * (x / 2) + 0.5, 2 * (y / 2) + 0.5);
          for (const Eigen::Vector2d& at_px : taken) {
            if ((middle_px - at_px).norm() < kDistancePx) mask.at<uchar>(y, x) = 0;
          }
        }
      }
      const std::vector<Eigen::Vector2d> corners = detector.detect(image, {1000, kDistancePx, 10, kNoMask, taken});
      EXPECT_EQ(corners, CornerDetector().detect(image, {1000, kDistancePx, 10, mask, kNone})) << size << count;
    }
  }
}

TEST(CornerDetector, FindsNoneWhereThereIsNone) {
  CornerDetector detector;
  EXPECT_TRUE(detector.detect(cv::Mat(kSize, CV_8UC1, cv::Scalar(90)), {100, 10, 10, kNoMask, kNone}).empty());
  cv::Mat edge(kSize, CV_8UC1, cv::Scalar(50));
  edge.colRange(160, 321) = cv::Scalar(200);
  EXPECT_TRUE(detector.detect(edge, {100, 10, 10, kNoMask, kNone}).empty());
  EXPECT_TRUE(detector.detect(cv::Mat(9, 7, CV_8UC1, cv::Scalar(90)), {100, 10, 10, kNoMask, kNone}).empty());
  // After a large image a small one.
  EXPECT_FALSE(detector.detect(squares(), {100, 10, 10, kNoMask, kNone}).empty());
  EXPECT_FALSE(detector.detect(squares()(cv::Rect(0, 0, 100, 90)), {100, 10, 10, kNoMask, kNone}).empty());
}

}  // namespace
}  // namespace gyro_deblur::corner_detector_test
