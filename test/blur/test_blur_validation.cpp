#include "blur/blur_validation.hpp"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::blur_validation_test {
namespace {

double radians(double degrees) { return degrees * CV_PI / 180; }

ValidationOptions by(ValidationRule rule) {
  ValidationOptions options;
  options.rule = rule;
  return options;
}
const ValidationOptions kGradient = by(ValidationRule::GRADIENT);

/// A plane that rises by `slope` grey levels a pixel in direction `angle`, 128 in the middle.
cv::Mat ramp(double angle_rad, double slope) {
  cv::Mat image(64, 64, CV_8UC1);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double along = (x - 31.5) * std::cos(angle_rad) + (y - 31.5) * std::sin(angle_rad);
      image.at<uchar>(y, x) = cv::saturate_cast<uchar>(128 + slope * along);
    }
  }
  return image;
}

TEST(MaxGradientAlong, IsTheSlopeOfARamp) {
  const cv::Rect inner(10, 10, 40, 40);
  EXPECT_FLOAT_EQ(max_gradient_along(ramp(0, 2), inner, 0), 2);
  EXPECT_FLOAT_EQ(max_gradient_along(ramp(radians(90), 1), inner, radians(90)), 1);
  EXPECT_NEAR(max_gradient_along(ramp(0, 2), inner, radians(90)), 0, 1e-5);
  for (const double slope_deg : {0, 30, 120}) {
    for (double degrees = 0; degrees < 180; degrees += 15) {
      // Rounding to 8 bit moves a difference over two pixels by at most one grey level.
      EXPECT_NEAR(max_gradient_along(ramp(radians(slope_deg), 2), inner, radians(degrees)),
                  2 * std::abs(std::cos(radians(degrees - slope_deg))), 0.5);
    }
  }
}

TEST(MaxGradientAlong, IsBlindToTheSignOfDirectionAndSlope) {
  const cv::Mat image = test::textured_image(64, 64, 3);
  const cv::Rect inner(3, 5, 40, 40);
  for (const double degrees : {0, 37, 90, 141}) {
    const float gradient = max_gradient_along(image, inner, radians(degrees));
    EXPECT_NEAR(max_gradient_along(image, inner, radians(degrees + 180)), gradient, 1e-4);
    EXPECT_NEAR(max_gradient_along(cv::Mat(255 - image), inner, radians(degrees)), gradient, 1e-4);
  }
}

TEST(MaxGradientAlong, AgreesWithSobelOverTheWholeImage) {
  const cv::Mat textured = test::textured_image(90, 70, 3);
  cv::Mat few_lights(textured.size(), CV_8UC1);  // the strongest gradient may be anywhere in a row
  cv::theRNG().state = 3;
  cv::randu(few_lights, 0, 255);
  few_lights = few_lights > 250;
  for (const cv::Mat& image : {textured, few_lights}) {
    cv::Mat gx, gy;
    cv::Sobel(image, gx, CV_32F, 1, 0, 3, 1.0 / 8, 0, cv::BORDER_REPLICATE);
    cv::Sobel(image, gy, CV_32F, 0, 1, 3, 1.0 / 8, 0, cv::BORDER_REPLICATE);
    // Corners, edges, single pixels and the whole image, and every width.
    std::vector<cv::Rect> blocks = {cv::Rect(0, 0, 90, 70), cv::Rect(0, 0, 8, 8),   cv::Rect(82, 62, 8, 8),
                                    cv::Rect(0, 30, 1, 1),  cv::Rect(89, 69, 1, 1), cv::Rect(20, 20, 33, 17)};
    for (int width = 1; width <= 67; ++width) blocks.emplace_back(width % 23, width % 5, width, 1 + width % 33);
    for (const double degrees : {0.0, 20.0, 75.0, 90.0, 160.0}) {
      const cv::Mat along = gx * std::cos(radians(degrees)) + gy * std::sin(radians(degrees));
      for (const cv::Rect& block : blocks) {
        EXPECT_NEAR(max_gradient_along(image, block, radians(degrees)), cv::norm(along(block), cv::NORM_INF), 1e-3)
            << block << " at " << degrees << " degrees";
      }
    }
  }
  EXPECT_EQ(max_gradient_along(cv::Mat(1, 1, CV_8UC1, cv::Scalar(200)), cv::Rect(0, 0, 1, 1), 1.0), 0);
}

class ValidationRules : public testing::TestWithParam<ValidationRule> {};
INSTANTIATE_TEST_SUITE_P(Both, ValidationRules, testing::Values(ValidationRule::LIKELIHOOD, ValidationRule::GRADIENT));

TEST_P(ValidationRules, AcceptTrueBlurAndRejectSharpBlocks) {
  const cv::Mat sharp = test::textured_image(640, 512, 21);
  for (const double extent : {10.0, 20.0, 40.0, 90.0}) {
    for (const double degrees : {0.0, 35.0, 110.0}) {
      const FrameBlur field = uniform_blur_field(640, 512, radians(degrees), extent, {});
      const cv::Mat blurred = test::expose(test::blur_along_line(sharp, radians(degrees), extent), 2.0, 4);
      const FrameBlur of_blurred = validate_blur_field(field, blurred, by(GetParam())),
                      of_sharp = validate_blur_field(field, sharp, by(GetParam()));
      EXPECT_GE(of_blurred.count(BlockStatus::DEBLURRED), 0.97 * field.blocks.size()) << extent << " px " << degrees;
      EXPECT_GE(of_sharp.count(BlockStatus::REJECTED), 0.9 * field.blocks.size()) << extent << " px " << degrees;
    }
  }
}

TEST(ValidateBlurField, UsesAThresholdThatFallsWithTheExtent) {
  const cv::Mat image = ramp(0, 3);
  FrameBlur field = uniform_blur_field(64, 64, 0, 10, {});
  ValidationOptions options = kGradient;
  options.tau = 2;
  options.tau_contrast = 11;  // 3.1 at 10 px, 2.9 at 12.2 px
  EXPECT_EQ(validate_blur_field(field, image, options).blocks[0].status, BlockStatus::DEBLURRED);
  field.blocks[0].extent_px = 12.2f;
  EXPECT_EQ(validate_blur_field(field, image, options).blocks[0].status, BlockStatus::REJECTED);
  // The paper's constant threshold.
  options.tau_contrast = 0;
  options.tau = 3.01;
  EXPECT_EQ(validate_blur_field(field, image, options).blocks[0].status, BlockStatus::DEBLURRED);
  options.tau = 2.99;
  EXPECT_EQ(validate_blur_field(field, image, options).blocks[0].status, BlockStatus::REJECTED);
  options.rule = ValidationRule::NONE;
  EXPECT_EQ(validate_blur_field(field, image, options).blocks[0].status, BlockStatus::DEBLURRED);
}

TEST(SteepestBox, IsTheExtentOfAUniformPathAndShortWhereThePointLingers) {
  BlockBlur blur;
  blur.extent_px = 16;
  EXPECT_EQ(steepest_box_px(blur), 16);
  // Half of the exposure on 4 px, the other half on 12: a box of 8 px is as dense as the first half.
  blur.nonuniform_path_px = Path1d{-4, -3, -2, -1, 0, 3, 6, 9, 12};
  EXPECT_NEAR(steepest_box_px(blur), 8, 1e-9);
  // There and back: two eighths of the exposure on the last pixel but one from the reversal, as on each before.
  blur.nonuniform_path_px = Path1d{-8, -6, -4, -2, 0, -2, -4, -6, -8};
  blur.extent_px = 8;
  EXPECT_NEAR(steepest_box_px(blur), 8, 1e-9);
  // Half of the exposure at rest.
  blur.nonuniform_path_px = Path1d{0, 0, 0, 0, 0, 2, 4, 6, 8};
  EXPECT_NEAR(steepest_box_px(blur), 2 / 0.625, 1e-9);
}

TEST(ValidateBlurField, TouchesOnlyBlocksThatWouldBeDeblurred) {
  cv::Mat noise(100, 200, CV_8UC1);
  cv::RNG rng(1);
  rng.fill(noise, cv::RNG::UNIFORM, 0, 256);
  FrameBlur field = uniform_blur_field(200, 100, 0.3, 30, {});
  field.exposure_ns = 7;
  const BlockStatus statuses[] = {BlockStatus::SHARP, BlockStatus::REJECTED, BlockStatus::TOO_LARGE,
                                  BlockStatus::NO_GYRO, BlockStatus::DEBLURRED};
  for (std::size_t i = 0; i < field.blocks.size(); ++i) field.blocks[i].status = statuses[i % 5];
  const FrameBlur validated = validate_blur_field(field, noise, kGradient);
  EXPECT_EQ(validated.exposure_ns, 7);
  for (std::size_t i = 0; i < field.blocks.size(); ++i) {
    EXPECT_EQ(validated.blocks[i].status, i % 5 == 4 ? BlockStatus::REJECTED : statuses[i % 5]);
    EXPECT_EQ(validated.blocks[i].extent_px, field.blocks[i].extent_px);
    EXPECT_EQ(validated.blocks[i].angle_rad, field.blocks[i].angle_rad);
  }
}

// Grey, but for noise in the columns from `first_col` on: those contradict any blur along x.
cv::Mat grey_next_to_noise(int first_col, int cols = 8, int rows = 8) {
  cv::Mat image(rows * 64, cols * 64, CV_8UC1, cv::Scalar(128));
  cv::RNG rng(1);
  // Not at the border, where the gradient looks across.
  if (first_col < cols) rng.fill(image.colRange(first_col * 64 + 2, cols * 64), cv::RNG::UNIFORM, 0, 256);
  return image;
}

TEST(ValidateBlurField, ByThePaperABlockWithoutTextureFollowsItsNeighbours) {
  FrameBlur field = uniform_blur_field(512, 512, 0, 10, {});
  cv::Mat image = grey_next_to_noise(4);

  image(cv::Rect(6 * 64 - 8, 5 * 64 - 8, 80, 80)) = 128;  // nothing in the block itself does
  const FrameBlur validated = validate_blur_field(field, image, kGradient);
  for (int i = 0; i < field.grid.size(); ++i) {
    // The border between the halves stays where it is, its corners included: no side outvotes the other.
    const int col = i % 8;
    EXPECT_EQ(validated.blocks[i].status, col < 4 ? BlockStatus::DEBLURRED : BlockStatus::REJECTED) << i;
  }
}

TEST(ValidateBlurField, ByThePaperAFrameWhosePredictionsHardlyEverHoldIsUnchanged) {
  const FrameBlur field = uniform_blur_field(512, 512, 0, 10, {});
  // One grey column of eight, and two.
  EXPECT_EQ(validate_blur_field(field, grey_next_to_noise(1), kGradient).count(BlockStatus::DEBLURRED), 0u);
  EXPECT_EQ(validate_blur_field(field, grey_next_to_noise(2), kGradient).count(BlockStatus::DEBLURRED), 16u);
  EXPECT_EQ(validate_blur_field(field, grey_next_to_noise(8), kGradient).count(BlockStatus::DEBLURRED), 64u);
}

TEST(ValidateBlurField, RefusesImagesThatDoNotFit) {
  const FrameBlur field = uniform_blur_field(64, 64, 0, 10, {});
  EXPECT_THROW(validate_blur_field(field, cv::Mat(64, 63, CV_8UC1), {}), std::invalid_argument);
  EXPECT_THROW(validate_blur_field(field, cv::Mat(64, 64, CV_8UC3), {}), std::invalid_argument);
  EXPECT_THROW(validate_blur_field(field, cv::Mat(64, 64, CV_16UC1), {}), std::invalid_argument);
  EXPECT_THROW(validate_blur_field(field, cv::Mat(), {}), std::invalid_argument);
  ValidationOptions bad;
  bad.tau = -1;
  EXPECT_THROW(validate_blur_field(field, cv::Mat(64, 64, CV_8UC1, cv::Scalar(0)), bad), OptionError);
}

}  // namespace
}  // namespace gyro_deblur::blur_validation_test
