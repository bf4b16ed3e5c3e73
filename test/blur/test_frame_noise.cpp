#include "blur/frame_noise.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "synthetic_blur.hpp"

namespace gyro_deblur {
namespace {

TEST(FrameNoise, IsThatOfASmoothScene) {
  // A plane and a step, which the operator takes away or few cells see.
  cv::Mat scene(480, 640, CV_64F);
  for (int y = 0; y < scene.rows; ++y) {
    for (int x = 0; x < scene.cols; ++x) scene.at<double>(y, x) = 60 + 0.1 * x + 0.05 * y + (x > 300 ? 30 : 0);
  }
  for (const double noise : {1.0, 2.0, 4.0, 8.0}) {
    const double with_rounding = std::sqrt(noise * noise + 1.0 / 12);
    EXPECT_NEAR(frame_noise(test::expose(scene, noise, 3)), with_rounding, 0.08 * with_rounding) << noise;
  }
}

TEST(FrameNoise, OfTextureIsThatOfItsSmoothestPart) {
  const cv::Mat blurred = test::blur_along_line(test::textured_image(640, 480, 4), 0.4, 20);
  for (const double noise : {2.0, 4.0, 8.0}) {
    EXPECT_NEAR(frame_noise(test::expose(blurred, noise, 5)), noise, 0.15 * noise) << noise;
  }
}

TEST(FrameNoise, DoesNotCountWhereNoiseIsClipped) {
  cv::Mat scene(480, 640, CV_64F, cv::Scalar(120));
  scene.rowRange(0, 400) = 270;
  EXPECT_NEAR(frame_noise(test::expose(scene, 4, 6)), 4, 0.8);
  scene = 0;
  EXPECT_EQ(frame_noise(test::expose(scene, 4, 7)), 0);
  EXPECT_EQ(frame_noise(cv::Mat(5, 5, CV_8UC1, cv::Scalar(100))), 0);
}

}  // namespace
}  // namespace gyro_deblur
