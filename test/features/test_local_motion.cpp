#include "features/local_motion.hpp"

#include <algorithm>
#include <limits>
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

/// @param outliers  the first, that move otherwise
std::vector<DisplacedPoint> neighbours(int outliers, double noise_px, int count = 12) {
  cv::RNG rng(4);
  std::vector<DisplacedPoint> points;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2d away_px(rng.uniform(-60.0, 60.0), rng.uniform(-60.0, 60.0)),
        noise(rng.gaussian(noise_px), rng.gaussian(noise_px));
    const Eigen::Vector2d other_px = i < outliers ? Eigen::Vector2d(5, 3) : Eigen::Vector2d(0, 0);
    points.push_back({kMiddle + away_px, kDisplacement + slope() * away_px + noise + other_px});
  }
  return points;
}

LocalMotion motion_of(const std::vector<DisplacedPoint>& points) { return LocalMotions(points).at(kMiddle).value(); }

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
  EXPECT_FALSE(LocalMotions(points).at(kMiddle));
  EXPECT_FALSE(LocalMotions({}).at(kMiddle, slope()));
}

TEST(LocalMotion, OfSixIsKnown) {
  for (const int count : {6, 7, 11}) {
    const LocalMotion motion = motion_of(neighbours(1, 0, count));
    EXPECT_LT((motion.displacement_px - kDisplacement).norm(), 0.1) << count;
    EXPECT_LT((motion.slope - slope()).norm(), 0.01) << count;
  }
}

TEST(LocalMotion, IsThatOfTheNearestPoints) {
  cv::RNG rng(5);
  const auto closer_to = [](const Eigen::Vector2d& place_px) {
    return [place_px](const DisplacedPoint& a, const DisplacedPoint& b) {
      return (a.place_px - place_px).squaredNorm() < (b.place_px - place_px).squaredNorm();
    };
  };
  for (const int count : {13, 40, 150, 600}) {
    std::vector<DisplacedPoint> points;
    for (int i = 0; i < count; ++i) {
      const double side_px = i % 2 ? 30 : 700;  // a cluster, and points around it
      points.push_back({{rng.uniform(0.0, side_px), rng.uniform(0.0, side_px)}, {rng.gaussian(1), rng.gaussian(1)}});
    }
    points.push_back({{1e5, 1e5}, {0, 0}});
    const LocalMotions motions(points);
    for (int i = 0; i < 50; ++i) {
      const Eigen::Vector2d place_px(rng.uniform(-50.0, 750.0), rng.uniform(-50.0, 750.0));
      std::vector<DisplacedPoint> nearest = points;
      std::sort(nearest.begin(), nearest.end(), closer_to(place_px));
      nearest.resize(12);
      const LocalMotion expected = LocalMotions(nearest).at(place_px).value(), found = motions.at(place_px).value();
      EXPECT_LT((found.displacement_px - expected.displacement_px).norm(), 1e-3);
      EXPECT_LT((found.slope - expected.slope).norm(), 1e-5);
    }
  }
}

TEST(LocalMotion, OfPointsAtOnePlaceHasTheExpectedSlope) {
  const Eigen::Vector2d away_px(20, -10);
  const std::vector<DisplacedPoint> points(40, {kMiddle + away_px, kDisplacement + slope() * away_px});
  const LocalMotion motion = LocalMotions(points).at(kMiddle, slope()).value();
  EXPECT_LT((motion.displacement_px - kDisplacement).norm(), 1e-6);
  EXPECT_LT((motion.slope - slope()).norm(), 1e-6);
}

TEST(LocalMotion, OfAPlaceThatIsNotFiniteIsNotKnown) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(LocalMotions(neighbours(0, 0, 40)).at({nan, 0}));
}

TEST(LocalMotion, KeepsTheExpectedSlopeAcrossARowOfPoints) {
  std::vector<DisplacedPoint> points;
  for (int i = -4; i <= 4; ++i) {
    const Eigen::Vector2d away_px(15 * i, 0);
    points.push_back({kMiddle + away_px, kDisplacement + slope() * away_px});
  }
  EXPECT_LT((LocalMotions(points).at(kMiddle, slope()).value().slope - slope()).norm(), 1e-6);
  const Eigen::Matrix2d other = motion_of(points).slope;
  EXPECT_LT((other.col(0) - slope().col(0)).norm(), 1e-3);
  EXPECT_LT(other.col(1).norm(), 1e-6);
}

}  // namespace
}  // namespace gyro_deblur::local_motion_test
