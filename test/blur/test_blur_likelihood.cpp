#include "blur/blur_likelihood.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "blur/blur_validation.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "paths_2d.hpp"
#include "validation_scores.hpp"

namespace gyro_deblur::blur_likelihood_test {
namespace {

constexpr int kWidthPx = 640, kHeightPx = 512;

ValidationOptions by_likelihood() {
  ValidationOptions options;
  options.rule = ValidationRule::LIKELIHOOD;
  return options;
}
const ValidationOptions kLikelihood = by_likelihood();

/// Share of the field's blocks that validation leaves DEBLURRED.
double accepted(const FrameBlur& field, const cv::Mat& image, const ValidationOptions& options = kLikelihood) {
  return static_cast<double>(validate_blur_field(field, image, options).count(BlockStatus::DEBLURRED)) /
         static_cast<double>(field.blocks.size());
}

struct Scene {
  double extent_px, angle_rad;
  test::Exposed how;
};

class BlurLikelihoodTest : public testing::TestWithParam<Scene> {};

TEST_P(BlurLikelihoodTest, DistinguishesTheBlurFromNoneAndFromAThird) {
  const auto& [extent_px, angle_rad, how] = GetParam();
  const test::PredictedBlur images =
      test::predict_blur(test::textured_image(kWidthPx + 64, kHeightPx + 64, 31), angle_rad, extent_px);
  EXPECT_GE(accepted(images.field, test::expose(images.blurred, how, 1)), 0.98);
  EXPECT_LE(accepted(images.field, test::expose(images.sharp, how, 2)), 0.02);
  EXPECT_LE(accepted(images.field, test::expose(images.third, how, 3)), 0.05);
}

INSTANTIATE_TEST_SUITE_P(Scenes, BlurLikelihoodTest,
                         testing::Values(Scene{5, 0.3, {1}}, Scene{5, 1.9, {4}}, Scene{10, 0, {4}},
                                         Scene{10, 2.5, {4, 0.35}}, Scene{20, 1.0, {8}}, Scene{20, 1.57, {4, 0.35}},
                                         Scene{40, 2.0, {1}}, Scene{40, 0.7, {8}}, Scene{90, 0.2, {2}},
                                         Scene{20, 1.0, {2, 1, 1000}}));

TEST(BlurLikelihood, HotPixelsDoNotChangeTheStatus) {
  for (const double extent_px : {5.0, 20.0}) {
    const test::PredictedBlur images =
        test::predict_blur(test::textured_image(kWidthPx + 64, kHeightPx + 64, 32), 0.8, extent_px);
    for (const cv::Mat& image : {images.blurred, images.sharp, images.third}) {
      // The same noise with and without.
      const FrameBlur without = validate_blur_field(images.field, test::expose(image, {1, 1, 0}, 4), kLikelihood);
      const FrameBlur with = validate_blur_field(images.field, test::expose(image, {1, 1, 1000}, 4), kLikelihood);
      int changed = 0;
      for (int i = 0; i < images.field.grid.size(); ++i) changed += with.blocks[i].status != without.blocks[i].status;
      EXPECT_LE(changed, images.field.grid.size() / 100);
    }
  }
}

TEST(BlurLikelihood, OneRateIsOneThreshold) {
  const test::PredictedBlur images =
      test::predict_blur(test::textured_image(kWidthPx + 64, kHeightPx + 64, 33), 0.5, 6);
  const cv::Mat third = test::expose(images.third, {8, 0.35}, 5), blurred = test::expose(images.blurred, {8, 0.35}, 6);
  double last_false = 0, last_true = 0;
  for (const double rate : {0.001, 0.01, 0.1, 0.5}) {
    ValidationOptions options = kLikelihood;
    options.false_accept_rate = rate;
    const double now_false = accepted(images.field, third, options),
                 now_true = accepted(images.field, blurred, options);
    EXPECT_GE(now_false, last_false);
    EXPECT_GE(now_true, last_true);
    last_false = now_false;
    last_true = now_true;
  }
  ValidationOptions strict = kLikelihood;
  strict.false_accept_rate = 0.001;
  EXPECT_LT(accepted(images.field, blurred, strict), last_true) << "the rate has an effect";
}

TEST(BlurLikelihood, AWrongDirectionIsRejected) {
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 34);
  const cv::Mat image = test::expose(test::blur_along_line(sharp, 0.4, 15), 2, 7);
  const FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.4 + CV_PI / 2, 15, {});
  EXPECT_LE(accepted(field, image), 0.05);
}

TEST(BlurLikelihood, SaturatedLightsDoNotContradict) {
  // Truly blurred, and clipped by the sensor: edges of what is clipped are sharp.
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 35);
  cv::Mat blurred = test::blur_along_line(sharp, 1.1, 20);
  blurred = 2 * blurred - 60;
  ASSERT_GE(cv::countNonZero(blurred > 255), 0.05 * static_cast<double>(blurred.total()));
  const FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 1.1, 20, {});
  EXPECT_GE(accepted(field, test::expose(blurred, 2, 8)), 0.95);
}

TEST(BlurLikelihood, AnNonuniformPathHasItsOwnSpectrum) {
  // Two thirds of the exposure on a quarter of the way: a box of 24 px is no fit for it.
  const Path1d path_px = {-8, -7, -6, -5, -4, -3, -2, 7, 16};
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 36);
  const cv::Mat image = test::expose(test::blur_along_path(sharp, 0.9, path_px), 1, 9);
  FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.9, 24, {});
  const auto mean_ratio = [&] {
    const std::vector<double> ratios = log_ratios(field, BlurLikelihood(image, 1));
    return std::accumulate(ratios.begin(), ratios.end(), 0.0) / static_cast<double>(ratios.size());
  };
  const double as_box = mean_ratio();
  for (BlockBlur& block : field.blocks) block.nonuniform_path_px = path_px;
  EXPECT_GT(mean_ratio(), as_box + 5);
  EXPECT_GE(accepted(field, image), 0.98);
  EXPECT_LE(accepted(field, test::expose(sharp, 1, 10)), 0.02);
}

TEST(BlurLikelihood, APathOfUniformSpeedIsABox) {
  const cv::Mat image = test::expose(test::blur_along_line(test::textured_image(128, 128, 37), 0.6, 12), 2, 11);
  const BlurLikelihood likelihood(image, 2);
  BlockBlur blur{0.6f, 12, BlockStatus::DEBLURRED};
  const double box = likelihood.log_ratio({64, 0, 64, 64}, blur);
  Path1d path_px;
  for (int k = 0; k < kPathInstants; ++k) path_px[k] = 12.0f * static_cast<float>(k) / (kPathInstants - 1) - 6;
  blur.nonuniform_path_px = path_px;
  EXPECT_NEAR(likelihood.log_ratio({64, 0, 64, 64}, blur), box, 1e-3 * std::abs(box));
  EXPECT_GT(box, 5);
}

TEST(BlurLikelihood, AStraight2dPathIsABox) {
  const cv::Mat image = test::expose(test::blur_along_line(test::textured_image(256, 256, 37), 0.6, 20), 2, 11);
  const BlurLikelihood likelihood(image, 2);
  BlockBlur blur{0.6f, 20, BlockStatus::DEBLURRED};
  const double box = likelihood.log_ratio({64, 64, 64, 64}, blur);
  blur.curved_path_px = test::arc_path(20, 0, 0.6);
  // The line is smeared along itself alone, and looked up in bins.
  EXPECT_NEAR(likelihood.log_ratio({64, 64, 64, 64}, blur), box, 0.1 * std::abs(box));
  EXPECT_GT(box, 5);
}

TEST(BlurLikelihood, ACurvedPathHasItsOwnSpectrum) {
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 42);
  for (const auto& [extent_px, sagitta_px] : {std::pair(12.0, 4.0), std::pair(24.0, 10.0), std::pair(80.0, 30.0)}) {
    const Path2d path_px = test::arc_path(extent_px, sagitta_px, 0.9);
    const cv::Mat image = test::expose(test::blur_in_2d(sharp, path_px), 2, 9);
    FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.9, extent_px, {});
    for (BlockBlur& block : field.blocks) block.curved_path_px = path_px;
    EXPECT_GE(accepted(field, image), 0.98) << extent_px << " px";
    EXPECT_LE(accepted(field, test::expose(sharp, 2, 10)), 0.02) << extent_px << " px";
    for (BlockBlur& block : field.blocks) block.curved_path_px = test::arc_path(extent_px, sagitta_px, 0.9 + M_PI / 2);
    EXPECT_LE(accepted(field, image), 0.02) << extent_px << " px across";
  }
}

// It changes a spectrum little: an edge that is too sharp for it is better evidence. Hot pixels are no such edges.
TEST(BlurLikelihood, ShortBlurHasNoSharpEdges) {
  constexpr double kExtentPx = 3.5;
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 43);
  const FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.5, kExtentPx, {});
  EXPECT_EQ(accepted(field, test::expose(sharp, 1, 15)), 0);
  cv::Mat blurred = test::expose(test::blur_along_line(sharp, 0.5, kExtentPx), 1, 16);
  EXPECT_GE(accepted(field, blurred), 0.98);
  cv::RNG rng(17);
  for (std::size_t i = 0; i < blurred.total() / 1000; ++i) {
    const int y = rng.uniform(0, blurred.rows), x = rng.uniform(0, blurred.cols);
    blurred.at<uchar>(y, x) = 255;
  }
  EXPECT_GE(accepted(field, blurred), 0.97);
}

TEST(BlurLikelihood, WhatNothingIsKnownOfIsAccepted) {
  const FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.3, 20, {});
  EXPECT_EQ(accepted(field, cv::Mat(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(90))), 1);
  EXPECT_EQ(accepted(field, test::expose(cv::Mat(kHeightPx, kWidthPx, CV_64F, cv::Scalar(90)), 4, 12)), 1);
  // No window fits.
  const cv::Mat small = test::textured_image(60, 200, 38);
  const FrameBlur small_field = uniform_blur_field(60, 200, 0.3, 20, {});
  EXPECT_EQ(log_ratios(small_field, BlurLikelihood(small, 1)), std::vector<double>(small_field.blocks.size(), 0.0));
  EXPECT_EQ(accepted(small_field, small), 1);
}

TEST(BlurLikelihood, WindowsStayInsideTheImage) {
  // Narrow blocks at the border, and an image that holds one window of the coarser level, or none.
  for (const cv::Size& size : {cv::Size(193, 130), cv::Size(64, 64), cv::Size(127, 300), cv::Size(128, 128)}) {
    const cv::Mat sharp = test::textured_image(size.width, size.height, 39);
    for (const double extent_px : {8.0, 30.0, 100.0}) {
      const FrameBlur field = uniform_blur_field(size.width, size.height, 0.5, extent_px, {});
      EXPECT_LE(accepted(field, test::expose(sharp, 1, 13)), 0.01) << size << ", " << extent_px << " px";
    }
  }
}

TEST(BlurLikelihood, AnObjectIsDistinguishedFromItsSurroundings) {
  // A sharp object of 3 x 3 blocks before a blurred background.
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 40);
  cv::Mat scene = test::blur_along_line(sharp, 0.2, 15);
  const cv::Rect object(192, 192, 192, 192);
  sharp(object).convertTo(scene(object), CV_64F);
  const FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.2, 15, {});
  const FrameBlur validated = validate_blur_field(field, test::expose(scene, 2, 14), kLikelihood);
  for (int i = 0; i < field.grid.size(); ++i) {
    const cv::Rect block = field.grid.rect(i), shared = block & object;
    EXPECT_EQ(validated.blocks[i].status, shared.empty() ? BlockStatus::DEBLURRED : BlockStatus::REJECTED) << block;
  }
}

TEST(BlurLikelihood, TouchesOnlyBlocksThatWouldBeDeblurredWhateverTheThreads) {
  const cv::Mat sharp = test::textured_image(kWidthPx, kHeightPx, 41);
  FrameBlur field = uniform_blur_field(kWidthPx, kHeightPx, 0.3, 30, {});
  const BlockStatus statuses[] = {BlockStatus::SHARP, BlockStatus::DEBLURRED, BlockStatus::TOO_LARGE,
                                  BlockStatus::NO_GYRO, BlockStatus::TOO_CURVED};
  for (std::size_t i = 0; i < field.blocks.size(); ++i) field.blocks[i].status = statuses[i % 5];
  const std::vector<double> ratios = log_ratios(field, BlurLikelihood(sharp, 1), 1);
  EXPECT_EQ(log_ratios(field, BlurLikelihood(sharp, 1), 2), ratios);
  const FrameBlur validated = validate_blur_field(field, sharp, kLikelihood);
  for (std::size_t i = 0; i < field.blocks.size(); ++i) {
    EXPECT_EQ(validated.blocks[i].status, i % 5 == 1 ? BlockStatus::REJECTED : statuses[i % 5]);
    EXPECT_EQ(ratios[i] == 0, i % 5 != 1);
  }
}

TEST(WithNeighbours, LimitsWhatTheOthersSay) {
  const BlockGrid grid(4 * 64, 3 * 64, 64);
  std::vector<double> ratios(12, 0.9);  // nothing
  ratios[0] = 100;                      // a corner, which says 5
  ratios[11] = -3;                      // the opposite one, which says -2
  ratios[7] = 2;                        // above it, 1
  const std::vector<double> together = with_neighbours(grid, ratios);
  EXPECT_DOUBLE_EQ(together[0], 100 + 4);  // itself, and the frame: 5 - 2 + 1
  EXPECT_DOUBLE_EQ(together[5], 0.9 + 5 + 4);
  EXPECT_DOUBLE_EQ(together[6], 0.9 - 2 + 1 + 4);
  EXPECT_DOUBLE_EQ(together[11], -3 + 1 + 4);
  EXPECT_DOUBLE_EQ(together[8], 0.9 + 4);
  EXPECT_DOUBLE_EQ(with_neighbours(grid, std::vector<double>(12, 50.0))[5], 50 + 8 * 5 + 5);
}

}  // namespace
}  // namespace gyro_deblur::blur_likelihood_test
