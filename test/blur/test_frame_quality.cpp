#include "blur/frame_quality.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::frame_quality_test {
namespace {

constexpr double kNoise = 2, kContrast = 50;
const double kRelative = kNoise / std::sqrt(kContrast * kContrast - kNoise * kNoise);

/// 10 x 4 blocks of 64 px, blurred along x.
FrameBlur field_of(double extent_px, BlockStatus status) {
  FrameBlur field = uniform_blur_field(640, 256, 0, extent_px, {});
  field.noise = kNoise;
  field.contrast = kContrast;
  for (BlockBlur& block : field.blocks) block.status = status;
  return field;
}

BlockBlur block_of(double extent_px, BlockStatus status) {
  BlockBlur block;
  block.extent_px = static_cast<float>(extent_px);
  block.status = status;
  return block;
}

TEST(ExpectedRepeatability, FallsWithBlurAndNoise) {
  for (const BlockStatus status : kBlockStatuses) {
    if (status == BlockStatus::NO_GYRO || status == BlockStatus::MASKED) continue;
    double before = 1;
    for (double extent_px = 0; extent_px <= 500; extent_px = 1.2 * extent_px + 0.5) {
      const auto expected = expected_repeatability(block_of(extent_px, status), kRelative);
      ASSERT_TRUE(expected);
      EXPECT_LE(*expected, before) << to_string(status) << ' ' << extent_px << " px";
      EXPECT_GE(*expected, 0);
      before = *expected;
      EXPECT_LE(*expected_repeatability(block_of(extent_px, status), 4 * kRelative), *expected);
    }
  }
  EXPECT_FALSE(expected_repeatability(block_of(10, BlockStatus::NO_GYRO), kRelative));
  EXPECT_FALSE(expected_repeatability(block_of(10, BlockStatus::MASKED), kRelative));
}

TEST(ExpectedRepeatability, IsHigherWhereBlurHasBeenUndone) {
  for (const double extent_px : {5.0, 10.0, 20.0, 50.0, 100.0}) {
    EXPECT_GT(*expected_repeatability(block_of(extent_px, BlockStatus::DEBLURRED), kRelative),
              *expected_repeatability(block_of(extent_px, BlockStatus::REJECTED), kRelative))
        << extent_px;
  }
}

TEST(NoiseToContrast, IsThatOfWhatIsNotNoise) {
  FrameBlur field = field_of(1, BlockStatus::SHARP);
  EXPECT_DOUBLE_EQ(noise_to_contrast(field), kRelative);
  field.noise = field.contrast;  // an image of nothing else
  EXPECT_EQ(noise_to_contrast(field), 1);
  field.noise = std::nullopt;
  EXPECT_EQ(noise_to_contrast(field), 0);
  field.noise = kNoise;
  field.contrast = 0;
  EXPECT_EQ(noise_to_contrast(field), 0);
}

TEST(AssessQuality, OfAWholeImage) {
  const FrameQuality sharp = assess_quality(field_of(1, BlockStatus::SHARP));
  EXPECT_STREQ(to_string(sharp.grade), "SHARP");
  EXPECT_NEAR(*sharp.score, *expected_repeatability(block_of(1, BlockStatus::SHARP), kRelative), 1e-9);
  EXPECT_EQ(sharp.noise, kNoise);
  EXPECT_EQ(sharp.before.median_px, 1);
  EXPECT_EQ(sharp.after.p95_px, 1);
  EXPECT_NEAR(sharp.share(BlockStatus::SHARP), 1, 1e-9);

  const FrameQuality deblurred = assess_quality(field_of(20, BlockStatus::DEBLURRED));
  EXPECT_STREQ(to_string(deblurred.grade), "DEBLURRED");
  EXPECT_EQ(deblurred.before.median_px, 20);
  EXPECT_EQ(deblurred.after.p95_px, 0);

  const FrameQuality blurred = assess_quality(field_of(80, BlockStatus::TOO_LARGE));
  EXPECT_STREQ(to_string(blurred.grade), "POOR");
  EXPECT_EQ(blurred.after.median_px, 80);
  EXPECT_LT(*blurred.score, *deblurred.score);
  EXPECT_LT(*deblurred.score, *sharp.score);
}

TEST(AssessQuality, CountsBlocksByTheirPixels) {
  // 3 columns of 64 px and one of 8, 2 rows.
  FrameBlur field = uniform_blur_field(200, 128, 0, 10, {});
  ASSERT_EQ(field.blocks.size(), 8u);
  for (const std::size_t narrow : {3u, 7u}) {
    field.blocks[narrow].status = BlockStatus::TOO_CURVED;
    field.blocks[narrow].extent_px = 90;
  }
  FrameQuality quality = assess_quality(field);
  EXPECT_NEAR(quality.share(BlockStatus::TOO_CURVED), 0.04, 1e-9);
  EXPECT_EQ(quality.before.p95_px, 10);
  EXPECT_EQ(quality.after.p95_px, 0);
  EXPECT_STREQ(to_string(quality.grade), "DEBLURRED");
  field.blocks[0].status = BlockStatus::REJECTED;  // 16 % more
  quality = assess_quality(field);
  EXPECT_STREQ(to_string(quality.grade), "PARTLY_DEBLURRED");
  EXPECT_EQ(quality.after.median_px, 0);
  EXPECT_EQ(quality.after.p95_px, 10);
}

TEST(AssessQuality, SaysNothingOfAnImageOfWhichMostIsNotKnown) {
  FrameBlur field = field_of(10, BlockStatus::DEBLURRED);
  for (int i = 0; i < 19; ++i) field.blocks[static_cast<std::size_t>(i)].status = BlockStatus::NO_GYRO;
  EXPECT_STREQ(to_string(assess_quality(field).grade), "PARTLY_DEBLURRED");
  EXPECT_NEAR(*assess_quality(field).score, *assess_quality(field_of(10, BlockStatus::DEBLURRED)).score, 1e-9);
  field.blocks[19].status = BlockStatus::NO_GYRO;
  EXPECT_STREQ(to_string(assess_quality(field).grade), "UNKNOWN");
  EXPECT_FALSE(assess_quality(field).score);
  EXPECT_STREQ(to_string(assess_quality(FrameBlur{}).grade), "UNKNOWN");
}

TEST(TrustMask, IsWhereTheImageIsSharpOrRestored) {
  FrameBlur field = field_of(1, BlockStatus::SHARP);
  for (const BlockStatus status : kBlockStatuses) field.blocks[static_cast<std::size_t>(status)].status = status;
  const cv::Mat mask = trust_mask(field);
  ASSERT_EQ(mask.type(), CV_8UC1);
  ASSERT_EQ(mask.size(), cv::Size(640, 256));
  for (int i = 0; i < static_cast<int>(field.blocks.size()); ++i) {
    const BlockStatus status = field.blocks[static_cast<std::size_t>(i)].status;
    const bool trusted = status == BlockStatus::SHARP || status == BlockStatus::DEBLURRED;
    const Eigen::Vector2d center_px = field.grid.center(i);
    EXPECT_EQ(mask.at<uchar>(static_cast<int>(center_px.y()), static_cast<int>(center_px.x())), trusted ? 255 : 0)
        << to_string(status);
  }
}

TEST(TrustMask, LeavesOutWhatBlurHasMixedWithWhatIsNotInTheImage) {
  // 100 px along (3, 4): 30 px to the left and right, 40 px up and down.
  FrameBlur field = uniform_blur_field(640, 256, std::atan2(4, 3), 100, {});
  const cv::Mat mask = trust_mask(field);
  EXPECT_EQ(cv::countNonZero(mask), cv::countNonZero(mask(cv::Rect(30, 40, 580, 176))));
  EXPECT_GE(cv::countNonZero(mask), 578 * 174);
  field = uniform_blur_field(640, 256, 0, 2000, {});
  for (BlockBlur& block : field.blocks) block.status = BlockStatus::DEBLURRED;
  EXPECT_EQ(cv::countNonZero(trust_mask(field)), 0) << "none of it";
}

TEST(TrustMask, GoesByTheWholeOfACurvedPath) {
  FrameBlur field = uniform_blur_field(640, 256, 0, 40, {});
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const float t = static_cast<float>(k) / (kPathInstants - 1) - 0.5f;
    path_px[k] = {40 * t, 80 * t * t};  // 40 px wide, 20 px high
  }
  for (BlockBlur& block : field.blocks) block.curved_path_px = path_px;
  const cv::Mat mask = trust_mask(field);
  EXPECT_EQ(cv::countNonZero(mask), cv::countNonZero(mask(cv::Rect(20, 10, 600, 236))));
  EXPECT_GE(cv::countNonZero(mask), 598 * 234);
}

}  // namespace
}  // namespace gyro_deblur::frame_quality_test
