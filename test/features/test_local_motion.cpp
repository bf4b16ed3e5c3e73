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

TEST(LocalMotion, IsThePlaneThroughItsNeighbours) {
  const LocalMotion motion = local_motion(neighbours(0, 0), kMiddle);
  EXPECT_LT((motion.displacement_px - kDisplacement).norm(), 0.01);
  EXPECT_LT((motion.slope - slope()).norm(), 1e-3);  // less what the prior of no motion takes
  EXPECT_LT((local_motion(neighbours(0, 0.1), kMiddle).slope - slope()).norm(), 0.005);
}

TEST(LocalMotion, DoesNotFollowOutliers) {
  const LocalMotion motion = local_motion(neighbours(3, 0.05), kMiddle);
  EXPECT_LT((motion.displacement_px - kDisplacement).norm(), 0.1);
  EXPECT_LT((motion.slope - slope()).norm(), 0.01);
}

TEST(LocalMotion, OfTooFewIsNone) {
  std::vector<DisplacedPoint> points = neighbours(0, 0);
  points.resize(5);
  const LocalMotion motion = local_motion(points, kMiddle);
  EXPECT_TRUE(motion.displacement_px.isZero());
  EXPECT_TRUE(motion.slope.isZero());
  EXPECT_TRUE(local_motion({}, kMiddle).slope.isZero());
}

}  // namespace
}  // namespace gyro_deblur::local_motion_test
