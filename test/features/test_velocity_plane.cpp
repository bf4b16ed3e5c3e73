#include "features/velocity_plane.hpp"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace gyro_deblur::velocity_plane_test {
namespace {

constexpr int kIterations = 3;
constexpr double kReachPx = 300;

Eigen::Vector2d truth_px_s(const Eigen::Vector2d& at_px) {
  return {40 + 0.2 * at_px.x() - 0.1 * at_px.y(), -25 + 0.05 * at_px.x() + 0.3 * at_px.y()};
}

/// Corners all around the centre, whose velocities have normal errors, with a standard deviation of `noise_px_s`.
NearbyVelocities corners(std::size_t count, double noise_px_s, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> place(-kReachPx, kReachPx);
  std::normal_distribution<double> normal;
  NearbyVelocities velocities;
  velocities.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector2d at_px(place(random), place(random));
    const Eigen::Vector2d error_px_s(normal(random), normal(random));
    velocities.set(i, at_px, truth_px_s(at_px) + noise_px_s * error_px_s);
  }
  return velocities;
}

TEST(VelocityPlane, OfVelocitiesOnAPlaneIsThatPlane) {
  const NearbyVelocities velocities = corners(20, 0, 1);
  // Where corners have no errors, their spread becomes small in a few steps.
  constexpr int kManySteps = 20;
  const VelocityPlane plane = fit_plane(velocities, kManySteps, 0);
  for (const Eigen::Vector2d& at_px : {Eigen::Vector2d(0, 0), Eigen::Vector2d(200, -100), Eigen::Vector2d(-50, 250)}) {
    EXPECT_LT((plane.at(at_px) - truth_px_s(at_px)).norm(), 1e-2) << at_px.transpose();
  }
  EXPECT_LT(plane.stddev_px_s, 1e-2);
}

TEST(VelocityPlane, DoesNotFollowAnObject) {
  NearbyVelocities velocities = corners(20, 0.5, 2);
  for (std::size_t i = 0; i < 5; ++i) {
    const Eigen::Vector2d at_px(velocities.x_px[i], velocities.y_px[i]);
    velocities.set(i, at_px, truth_px_s(at_px) + Eigen::Vector2d(90, -60));
  }
  const VelocityPlane plane = fit_plane(velocities, kIterations, 0.02);
  EXPECT_LT((plane.at({0, 0}) - truth_px_s({0, 0})).norm(), 2);
}

TEST(VelocityPlane, KnowsItsError) {
  constexpr int kTries = 400;
  double squares = 0, expected = 0;
  for (unsigned seed = 0; seed < kTries; ++seed) {
    const VelocityPlane plane = fit_plane(corners(20, 2, seed), kIterations, 0);
    squares += (plane.at({0, 0}) - truth_px_s({0, 0})).squaredNorm() / 2;
    expected += plane.stddev_px_s * plane.stddev_px_s;
  }
  EXPECT_NEAR(std::sqrt(squares / expected), 1, 0.25) << "error over stddev_px_s";
}

TEST(VelocityPlane, IsLevelWhereCornersDoNotShowASlope) {
  NearbyVelocities velocities;
  velocities.resize(3);
  velocities.set(0, {10, 0}, {5, 1});
  velocities.set(1, {10.01, 0}, {5, 1});
  velocities.set(2, {9.99, 0}, {5, 1});
  const VelocityPlane plane = fit_plane(velocities, kIterations, 0.02);
  EXPECT_LT((plane.at({0, 0}) - Eigen::Vector2d(5, 1)).norm(), 0.2);
}

TEST(SeenFrom, IsTheThirdCornerThatShowsTheVelocity) {
  NearbyVelocities velocities;
  velocities.resize(6);
  for (int i = 0; i < 6; ++i) {
    velocities.set(static_cast<std::size_t>(i), {10.0 * (i + 1), 0}, {i == 1 ? 500.0 : 3.0 + 0.01 * (i % 2), 0});
  }
  VelocityPlane plane;
  plane.coefficients(0, 0) = 3;
  plane.spread_px_s = 0.1;
  EXPECT_NEAR(seen_from_px(plane, velocities), 40, 1e-4) << "of corners at 10, 30, 40, 50 and 60 px";
  plane.coefficients(0, 0) = 500;
  EXPECT_NEAR(seen_from_px(plane, velocities), 60, 1e-4) << "the farthest, where fewer than three show it";
}

}  // namespace
}  // namespace gyro_deblur::velocity_plane_test
