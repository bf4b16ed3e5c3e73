#include "blur/image_noise.hpp"

#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "base/parallel.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::image_noise_test {
namespace {

constexpr double kLevels[] = {0.5, 1, 2, 4, 8, 12};  // [grey levels]

/// `light` [grey levels of 8 bits] with noise, in whole steps of 2^bits - 1.
cv::Mat expose_as(const cv::Mat& light, double noise, int bits, std::uint64_t seed) {
  cv::Mat random(light.size(), CV_64F), real, image;
  cv::RNG(seed).fill(random, cv::RNG::NORMAL, 0.0, noise);
  light.convertTo(real, CV_64F);
  const double steps = ((1 << bits) - 1) / 255.0;
  cv::Mat((real + random) * steps).convertTo(image, bits == 8 ? CV_8U : CV_16U);
  return bits == 8 ? image : cv::Mat(cv::min(image, (1 << bits) - 1));
}

/// Noise and rounding.
double truth(double noise, int bits) { return std::hypot(noise, 255.0 / ((1 << bits) - 1) / std::sqrt(12.0)); }

void expect_found(const cv::Mat& light, double tolerance, const std::string& what) {
  std::uint64_t seed = 0;
  for (const double noise : kLevels) {
    for (const int bits : {8, 12}) {
      const auto found = image_noise(expose_as(light, noise, bits, ++seed), PixelLayout::GRAY, bits);
      ASSERT_TRUE(found) << what;
      EXPECT_NEAR(*found / truth(noise, bits), 1, tolerance) << what << ", noise " << noise << ", " << bits << " bits";
    }
  }
}

cv::Mat ramp(int width, int height) {
  cv::Mat light(height, width, CV_64F);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) light.at<double>(y, x) = 60 + 120.0 * x / width + 10.0 * y / height;
  }
  return light;
}

TEST(ImageNoise, IsFoundOnFlatAndOnTexturedImages) {
  expect_found(cv::Mat(480, 752, CV_64F, cv::Scalar(100)), 0.1, "even");
  expect_found(ramp(752, 480), 0.1, "ramp");
  expect_found(ramp(160, 120), 0.15, "small");
  // Contrast as photographs have it; texture everywhere, as fine as pixels.
  cv::Mat texture = test::textured_image(752, 480, 1);
  texture.convertTo(texture, CV_64F, 0.5, 64);
  expect_found(test::blur_along_line(texture, 0.4, 10), 0.1, "blurred texture");
}

TEST(ImageNoise, IsThatOfAMosaicsAndAColourImagesGreen) {
  const double noise = 3;
  for (const PixelLayout layout :
       {PixelLayout::BAYER_RGGB, PixelLayout::BAYER_BGGR, PixelLayout::BAYER_GBRG, PixelLayout::BAYER_GRBG}) {
    // Green is much brighter than what is between it.
    const bool green_first = layout == PixelLayout::BAYER_GBRG || layout == PixelLayout::BAYER_GRBG;
    cv::Mat light = ramp(752, 480);
    for (int y = 0; y < light.rows; ++y) {
      for (int x = 0; x < light.cols; ++x) {
        if (((x + y) % 2 == 0) != green_first) light.at<double>(y, x) *= 0.3;
      }
    }
    EXPECT_NEAR(*image_noise(expose_as(light, noise, 8, 3), layout, 8), noise, 0.15 * noise);
    EXPECT_NEAR(*image_noise(expose_as(light, noise, 12, 4), layout, 12), noise, 0.15 * noise);
  }
  const cv::Mat quiet = expose_as(ramp(752, 480), 1, 8, 5), loud = expose_as(ramp(752, 480), 9, 8, 6);
  cv::Mat color;
  cv::merge(std::vector<cv::Mat>{loud, quiet, loud}, color);
  EXPECT_NEAR(*image_noise(color, PixelLayout::BGR), truth(1, 8), 0.1);
}

TEST(ImageNoise, IsTheSameOnAnyNumberOfThreads) {
  const EagerHelpers eager_helpers;
  const cv::Mat image = expose_as(ramp(752, 480), 3, 8, 11);
  for (const int mean_of : {1, 2}) {
    EXPECT_EQ(image_noise(image, PixelLayout::GRAY, 8, mean_of, {}, 4),
              image_noise(image, PixelLayout::GRAY, 8, mean_of, {}, 1));
  }
}

TEST(ImageNoise, IsNotThatOfSaturatedPartsOrHotPixels) {
  cv::Mat light = ramp(752, 480);
  light(cv::Rect(0, 0, 300, 480)).setTo(400);
  light(cv::Rect(300, 0, 200, 480)).setTo(-200);
  EXPECT_NEAR(*image_noise(expose_as(light, 2, 8, 7), PixelLayout::GRAY), 2, 0.15 * 2);
  cv::Mat hot = expose_as(ramp(752, 480), 2, 8, 8);
  cv::RNG rng(9);
  for (int i = 0; i < 361; ++i) {  // 1000 in a million
    const int x = rng.uniform(0, 752), y = rng.uniform(0, 480);
    hot.at<uchar>(y, x) = 250;
  }
  EXPECT_NEAR(*image_noise(hot, PixelLayout::GRAY), 2, 0.15 * 2);
}

TEST(ImageContrast, IsTheStandardDeviationOfATexture) {
  cv::Mat texture(480, 752, CV_8UC1);
  cv::RNG rng(5);
  rng.fill(texture, cv::RNG::NORMAL, 128, 25);
  // Of 1410 samples: 1.9 % off, on the mean.
  EXPECT_NEAR(image_contrast(texture, PixelLayout::GRAY), 25, 0.06 * 25);
}

TEST(ImageContrast, IsThatOfWideMosaicAndColourImagesToo) {
  // Halves of two grey levels.
  cv::Mat gray(240, 320, CV_8UC1, cv::Scalar(50));
  gray(cv::Rect(160, 0, 160, 240)) = 90;
  EXPECT_NEAR(image_contrast(gray, PixelLayout::GRAY), 20, 1e-9);
  cv::Mat wide;
  gray.convertTo(wide, CV_16U, 4095.0 / 255);
  EXPECT_NEAR(image_contrast(wide, PixelLayout::GRAY, 12), 20, 0.02);
  cv::Mat colour;
  cv::merge(std::vector<cv::Mat>{gray * 0, gray, gray * 2}, colour);
  EXPECT_NEAR(image_contrast(colour, PixelLayout::BGR), 20, 1e-9);
  // Red of another brightness everywhere does not count.
  cv::Mat mosaic = gray.clone();
  for (int y = 0; y < mosaic.rows; y += 2) {
    for (int x = 0; x < mosaic.cols; x += 2) mosaic.at<uchar>(y, x) = 255;
  }
  EXPECT_NEAR(image_contrast(mosaic, PixelLayout::BAYER_RGGB), 20, 1e-9);
  EXPECT_EQ(image_contrast(cv::Mat(1, 1, CV_8UC1, cv::Scalar(7)), PixelLayout::GRAY), 0);
}

TEST(ImageNoise, IsNotKnownWithoutPixelsToSeeItOn) {
  EXPECT_FALSE(image_noise(cv::Mat(480, 752, CV_8U, cv::Scalar(255)), PixelLayout::GRAY));
  EXPECT_FALSE(image_noise(cv::Mat(480, 752, CV_8U, cv::Scalar(0)), PixelLayout::GRAY));
  EXPECT_FALSE(image_noise(cv::Mat(30, 40, CV_8U, cv::Scalar(90)), PixelLayout::GRAY));
  EXPECT_FALSE(image_noise(cv::Mat(1, 1, CV_8U, cv::Scalar(90)), PixelLayout::BAYER_RGGB));
  EXPECT_FALSE(image_noise(cv::Mat(3, 5000, CV_16U, cv::Scalar(90)), PixelLayout::GRAY));
  EXPECT_EQ(image_noise(cv::Mat(480, 752, CV_8U, cv::Scalar(90)), PixelLayout::GRAY), 0);
}

}  // namespace
}  // namespace gyro_deblur::image_noise_test
