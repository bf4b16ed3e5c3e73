#include "features/local_motion.hpp"

#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

namespace gyro_deblur::local_motion_test {
namespace {

const Eigen::Vector2d kMiddle(300, 200), kDisplacement(0.7, -0.4);

Eigen::Matrix2d slope() {
  Eigen::Matrix2d result;
  result << 0.02, -0.01, 0.015, 0.03;
  return result;
}

/// @param outliers  of 12, that move otherwise
std::vector<DisplacedPoint> neighbours(int outliers, double noise_px) {
  cv::RNG rng(4);
  std::vector<DisplacedPoint> points;
  for (int i = 0; i < 12; ++i) {
    const Eigen::Vector2d away_px(rng.uniform(-60.0, 60.0), rng.uniform(-60.0, 60.0)),
        noise(rng.gaussian(noise_px), rng.gaussian(noise_px));
    const Eigen::Vector2d other_px = i < outliers ? Eigen::Vector2d(5, 3) : Eigen::Vector2d(0, 0);
    points.push_back({kMiddle + away_px, kDisplacement + slope() * away_px + noise + other_px});
  }
  return points;
}

LocalMotion motion_of(const std::vector<DisplacedPoint>& points) { return local_motion(points, kMiddle).value(); }

TEST(LocalMotion, IsThePlaneThroughItsNeighbours) {
  const LocalMotion motion = motion_of(neighbours(0, 0));
  EXPECT_LT((motion.displacement_px - kDisplacement).norm(), 0.01);
  EXPECT_LT((motion.slope - slope()).norm(), 1e-3);  // less what the prior of no motion takes
  EXPECT_LT((motion_of(neighbours(0, 0.1)).slope - slope()).norm(), 0.005);
}

TEST(LocalMotion, DoesNotFollowOutliers) {
  const LocalMotion motion = motion_of(neighbours(3, 0.05));
  EXPECT_LT((motion.displacement_px - kDisplacement).norm(), 0.1);
  EXPECT_LT((motion.slope - slope()).norm(), 0.01);
}

TEST(LocalMotion, OfTooFewIsNotKnown) {
  std::vector<DisplacedPoint> points = neighbours(0, 0);
  points.resize(5);
  EXPECT_FALSE(local_motion(points, kMiddle));
  EXPECT_FALSE(local_motion({}, kMiddle, slope()));
}

TEST(LocalMotion, KeepsTheExpectedSlopeAcrossARowOfPoints) {
  std::vector<DisplacedPoint> points;
  for (int i = -4; i <= 4; ++i) {
    const Eigen::Vector2d away_px(15 * i, 0);
    points.push_back({kMiddle + away_px, kDisplacement + slope() * away_px});
  }
  EXPECT_LT((local_motion(points, kMiddle, slope()).value().slope - slope()).norm(), 1e-6);
  const Eigen::Matrix2d other = motion_of(points).slope;
  EXPECT_LT((other.col(0) - slope().col(0)).norm(), 1e-3);
  EXPECT_LT(other.col(1).norm(), 1e-6);
}

}  // namespace
}  // namespace gyro_deblur::local_motion_test
