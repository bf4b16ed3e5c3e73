#include "blur/block_texture.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "synthetic_blur.hpp"

namespace gyro_deblur::block_texture_test {
namespace {

/// A texture of which any line has the power `strength` / f^2: random waves whose power falls with the cube of the
/// frequency in two dimensions.
cv::Mat texture(double strength, std::uint64_t seed) {
  constexpr int kSize = 512;
  cv::Mat white(kSize, kSize, CV_64F), spectrum, plane;
  cv::RNG(seed).fill(white, cv::RNG::NORMAL, 0.0, 1.0);
  cv::dft(white, spectrum, cv::DFT_COMPLEX_OUTPUT);
  for (int v = 0; v < kSize; ++v) {
    for (int u = 0; u < kSize; ++u) {
      const double f = std::hypot(std::min(u, kSize - u), std::min(v, kSize - v)) / kSize;
      spectrum.at<cv::Vec2d>(v, u) *= f > 0 ? std::sqrt(strength / 2) * std::pow(f, -1.5) : 0;
    }
  }
  cv::dft(spectrum, plane, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  return plane + 128;
}

/// Found in the whole of a blurred image with noise.
double found(const cv::Mat& light, double angle_rad, double extent_px, double noise) {
  const cv::Mat image = test::expose(test::blur_along_line(light, angle_rad, extent_px), noise, 3);
  return texture_along_line(image, {64, 64, 384, 384}, angle_rad, extent_px, noise * noise + 1.0 / 12);
}

TEST(TextureAlongLine, IsWhatItWasBeforeBlurAndNoise) {
  for (const double strength : {0.3, 3.0}) {
    const cv::Mat light = texture(strength, 1);
    for (const double angle_rad : {0.0, 0.7, 2.0}) {
      for (const double extent_px : {3.0, 10.0, 40.0}) {
        for (const double noise : {0.5, 2.0, 4.0}) {
          // Where what blur has left along the line is below noise, only what is across it counts.
          const double share = found(light, angle_rad, extent_px, noise) / strength;
          EXPECT_GT(share, 0.45) << strength << ", " << angle_rad << " rad, " << extent_px << " px, noise " << noise;
          EXPECT_LT(share, 1.35) << strength << ", " << angle_rad << " rad, " << extent_px << " px, noise " << noise;
        }
      }
    }
  }
}

TEST(TextureAlongLine, IsNoneWhereThereIsNoiseAlone) {
  const cv::Mat even(512, 512, CV_64F, cv::Scalar(100));
  for (const double noise : {1.0, 8.0}) EXPECT_LT(found(even, 0.4, 10, noise), 2e-4 * noise * noise);
}

// Stripes have no gradient but along the motion that smears them.
TEST(TextureAlongLine, IsSeenWhereOnlyTheLineHasIt) {
  cv::Mat stripes(512, 512, CV_64F);
  cv::RNG rng(5);
  for (int x = 0; x < 512; x += 16) stripes.colRange(x, x + 16).setTo(rng.uniform(60, 200));
  EXPECT_GT(found(stripes, 0, 20, 2), 1.5);
  EXPECT_GT(found(stripes, CV_PI / 2, 20, 2), 1.5) << "along the stripes";
}

TEST(TextureAlongLine, TakesBlocksOfAnySize) {
  const cv::Mat image = test::textured_image(65, 37, 1);
  EXPECT_GT(texture_along_line(image, {0, 0, 65, 37}, 1, 5, 1), 0);
  EXPECT_GE(texture_along_line(image, {60, 30, 5, 7}, 1, 5, 1), 0);
  EXPECT_EQ(texture_along_line(image, {64, 36, 1, 1}, 1, 5, 1), 0);
  EXPECT_EQ(texture_along_line(image(cv::Rect(0, 0, 1, 1)), {0, 0, 1, 1}, 1, 5, 1), 0);
}

}  // namespace
}  // namespace gyro_deblur::block_texture_test
