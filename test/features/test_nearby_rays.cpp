#include "features/nearby_rays.hpp"

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::nearby_rays_test {
namespace {

class NearbyRaysTest : public testing::TestWithParam<std::pair<const char*, std::vector<double>>> {
 protected:
  Camera camera() const {
    CameraCalibration calibration;
    calibration.width_px = 752;
    calibration.height_px = 480;
    calibration.fx_px = 458.7;
    calibration.fy_px = 457.3;
    calibration.cx_px = 367.2;
    calibration.cy_px = 248.4;
    calibration.model = GetParam().first;
    calibration.coefficients = GetParam().second;
    return Camera(calibration);
  }
};

TEST_P(NearbyRaysTest, AreThoseOfTheCamera) {
  const Camera lens = camera();
  for (const Eigen::Vector2d& at_px : {Eigen::Vector2d(370, 250), {30, 440}, {700, 20}}) {
    const NearbyRays rays(lens, at_px, lens.ray(at_px));
    for (const Eigen::Vector2d& away_px : {Eigen::Vector2d(0, 0), {0.5, -1}, {-7, 3}, {25, 18}, {-300, 100}}) {
      const Eigen::Vector2d pixel_px = at_px + away_px;
      const Eigen::Vector3d expected = lens.ray(pixel_px), ray = rays.ray(pixel_px);
      if (!expected.allFinite()) continue;
      EXPECT_LT((lens.project(ray) - pixel_px).norm(), 1e-5) << pixel_px.transpose();
      EXPECT_LT((ray - expected).norm(), 1e-7) << pixel_px.transpose();
    }
  }
}

TEST_P(NearbyRaysTest, WithoutADirectionTheyAreUndistortedFromScratch) {
  const Camera lens = camera();
  const NearbyRays rays(lens, {100, 100}, Eigen::Vector3d::Constant(std::nan("")));
  for (const Eigen::Vector2d& at_px : {Eigen::Vector2d(102, 99), {100, 100}}) {
    EXPECT_LT((rays.ray(at_px) - lens.ray(at_px)).norm(), 1e-9);
  }
  EXPECT_FALSE(rays.ray({std::nan(""), 99}).allFinite());
}

INSTANTIATE_TEST_SUITE_P(Lenses, NearbyRaysTest,
                         testing::Values(std::pair("none", std::vector<double>{}),
                                         std::pair("plumb_bob",
                                                   std::vector<double>{-0.2834, 0.0740, 0.0002, 0.0000176, 0}),
                                         std::pair("equidistant", std::vector<double>{-0.01, 0.02, -0.01, 0.002})),
                         [](const auto& lens) { return std::string(lens.param.first); });

}  // namespace
}  // namespace gyro_deblur::nearby_rays_test
