#include "features/gyro_unit_watch.hpp"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur::gyro_unit_watch_test {
namespace {

constexpr TimeNs kPeriod = 50'000'000;
constexpr double kDegrees = 180 / M_PI;

/// Images that rotate to and fro, seen with an error of 5 %, while the gyroscope measures `scale` times as much.
/// @param seen_from_translation  the residual velocities look like a translation rather than a rotation
GyroUnitWatch watched(int frames, double scale, double amplitude_rad_s = 1.5, bool seen_from_translation = false) {
  std::mt19937 random(3);
  std::normal_distribution<double> error(0, 0.05);
  GyroUnitWatch watch;
  for (int i = 0; i < frames; ++i) {
    ResidualRotation seen;
    const double rate_rad_s = amplitude_rad_s * std::sin(0.4 * i + 0.3);
    seen.rate_rad_s = {0.2 * rate_rad_s, rate_rad_s * (1 + error(random)), 0};
    seen.known_rad_s = Eigen::Vector3d(0.2, 1, 0) * scale * rate_rad_s;
    seen.energy_px2_s2 = 1e4 * rate_rad_s * rate_rad_s;
    seen.energy_less_rotation_px2_s2 = (seen_from_translation ? 0.4 : 0.1) * seen.energy_px2_s2;
    seen.energy_less_translation_px2_s2 = (seen_from_translation ? 0.1 : 0.4) * seen.energy_px2_s2;
    watch.add(1'000'000'000 + i * kPeriod, seen);
  }
  return watch;
}

TEST(GyroUnitWatch, FindsDegreesWithinASecond) {
  const auto fault = watched(20, kDegrees).find(false);
  ASSERT_TRUE(fault);
  EXPECT_EQ(fault->kind, GyroUnitFault::Kind::DEGREES);
  EXPECT_NEAR(fault->gyro_rad_s, 1.5 * kDegrees, 10);
  EXPECT_NEAR(fault->seen_rad_s, 1.5, 0.2);
  EXPECT_FALSE(watched(20, kDegrees).is_confirmed());
}

TEST(GyroUnitWatch, RatesThatAreRightAreConfirmed) {
  for (const double scale : {0.5, 1.0, 2.0}) {
    const GyroUnitWatch watch = watched(100, scale);
    EXPECT_FALSE(watch.find(false)) << scale;
    EXPECT_TRUE(watch.is_confirmed()) << scale;
  }
  EXPECT_FALSE(watched(2, 1).is_confirmed());
}

TEST(GyroUnitWatch, UncertaintyEndsWithConfirmationOrAfterFiveSeconds) {
  GyroUnitWatch dark;  // images that measure nothing
  for (int i = 0; i < 200; ++i) EXPECT_EQ(dark.is_uncertain(1'000'000'000 + i * kPeriod), i < 100) << i;
  EXPECT_FALSE(watched(20, 1).is_uncertain(2'000'000'000));
  EXPECT_TRUE(watched(20, kDegrees).is_uncertain(2'000'000'000));
}

// Corners on a rim that does not move with the scene, while the camera rotates fast.
TEST(GyroUnitWatch, ImagesThatSeemToStandStillAreNoUnit) {
  EXPECT_FALSE(watched(100, 1e4, 0.001).find(false));
  EXPECT_FALSE(watched(100, 500, 0.05).find(false));
  EXPECT_FALSE(watched(100, 10, 1).find(false)) << "nor ones that are followed badly";
}

TEST(GyroUnitWatch, FindsAGyroscopeWithoutRatesWhereImagesRotate) {
  const auto fault = watched(20, 0).find(true);
  ASSERT_TRUE(fault);
  EXPECT_EQ(fault->kind, GyroUnitFault::Kind::NO_RATES);
  EXPECT_NEAR(fault->seen_rad_s, 1.5, 0.2);
  EXPECT_FALSE(watched(20, 0).find(false)) << "a gyroscope's rates are never exactly 0";
  EXPECT_FALSE(watched(20, 0, 1.5, true).find(true)) << "the camera is carried along";
  EXPECT_FALSE(watched(20, 0, 0.05).find(true)) << "the camera stands";
}

TEST(GyroUnitWatch, OldImagesAreForgotten) {
  GyroUnitWatch watch = watched(20, kDegrees);
  ResidualRotation still;
  for (int i = 1; i <= 110; ++i) watch.add(1'000'000'000 + (20 + i) * kPeriod, still);
  EXPECT_FALSE(watch.find(false));
  watch = watched(20, kDegrees);
  watch.clear();
  EXPECT_FALSE(watch.find(false));
}

}  // namespace
}  // namespace gyro_deblur::gyro_unit_watch_test
