#include "gyro_deblur/pixel_mask.hpp"

#include <array>
#include <cmath>
#include <stdexcept>

#include <gtest/gtest.h>
#include <Eigen/Core>
#include <opencv2/imgproc.hpp>

#include "blur/frame_quality.hpp"
#include "blur/image_noise.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::pixel_mask_test {
namespace {

constexpr int kWidthPx = 330, kHeightPx = 250;

/// A round window, as a fisheye lens leaves.
cv::Mat round_window(int radius_px) {
  cv::Mat used(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(0));
  cv::circle(used, {kWidthPx / 2, kHeightPx / 2}, radius_px, cv::Scalar(1), cv::FILLED);
  return used;
}

FrameBlur field_of(double angle_rad, double extent_px, int block_px = 32) {
  BlurFieldOptions options;
  options.block_size_px = block_px;
  return uniform_blur_field(kWidthPx, kHeightPx, angle_rad, extent_px, options);
}

TEST(PixelMask, CountsMaskedPixels) {
  const cv::Mat used = round_window(100);
  const PixelMask mask(used);
  cv::RNG rng(1);
  for (int i = 0; i < 200; ++i) {
    const int x = rng.uniform(-20, kWidthPx), y = rng.uniform(-20, kHeightPx);
    const cv::Rect rect(x, y, rng.uniform(0, 120), rng.uniform(0, 120));
    const cv::Rect inside = rect & cv::Rect(0, 0, kWidthPx, kHeightPx);
    const int expected = inside.empty() ? 0 : inside.area() - cv::countNonZero(used(inside));
    EXPECT_EQ(mask.masked_in(rect), expected) << rect;
  }
  EXPECT_EQ(cv::norm(mask.pixels(), 255 * used, cv::NORM_INF), 0);
  EXPECT_TRUE(mask.uses({kWidthPx / 2, kHeightPx / 2}));
  EXPECT_FALSE(mask.uses({0, 0}));
  EXPECT_TRUE(PixelMask().uses({0, 0}));
  EXPECT_TRUE(PixelMask().with_used_window(3).empty());
  const cv::Mat windows = mask.with_used_window(10);
  for (const cv::Point at : {cv::Point(kWidthPx / 2, 25 + 5), cv::Point(kWidthPx / 2, 25 + 15)}) {
    const cv::Rect window(at.x - 10, at.y - 10, 21, 21);
    EXPECT_EQ(windows.at<uchar>(at) != 0, mask.masked_in(window) == 0) << at;
  }
}

TEST(PixelMask, IsRefusedWhereItCannotBeOne) {
  EXPECT_THROW(PixelMask{cv::Mat()}, std::invalid_argument);
  EXPECT_THROW(PixelMask(cv::Mat::zeros(4, 4, CV_8UC1)), std::invalid_argument);
  EXPECT_THROW(PixelMask(cv::Mat::ones(4, 4, CV_16UC1)), std::invalid_argument);
  EXPECT_THROW(PixelMask(cv::Mat(4, 4, CV_8UC3, cv::Scalar::all(1))), std::invalid_argument);
  FrameBlur field = field_of(0, 10);
  EXPECT_THROW(mark_masked(PixelMask(cv::Mat::ones(4, 4, CV_8UC1)), &field), std::invalid_argument);
  EXPECT_THROW(mark_static_edges(PixelMask(cv::Mat::ones(4, 4, CV_8UC1)), {}, &field), std::invalid_argument);
}

TEST(PixelMask, MarksBlocksWithoutAUsedPixel) {
  const PixelMask mask(round_window(100));
  FrameBlur field = field_of(0.3, 10);
  field.blocks[1].status = BlockStatus::SHARP;
  mark_masked(mask, &field);
  std::size_t masked = 0;
  for (int i = 0; i < field.grid.size(); ++i) {
    const cv::Rect rect = field.grid.rect(i);
    const bool is_masked = field.blocks[i].status == BlockStatus::MASKED;
    EXPECT_EQ(is_masked, mask.masked_in(rect) == rect.area()) << i;
    masked += is_masked;
  }
  EXPECT_GT(masked, 10u);
  FrameBlur unknown = field_of(0.3, 10);
  for (BlockBlur& block : unknown.blocks) block.status = BlockStatus::NO_GYRO;
  mark_masked(mask, &unknown);
  EXPECT_EQ(unknown.count(BlockStatus::MASKED), 0u) << "nothing is known of the image";
}

/// Whether a pixel of the block, moved to either side by as much as its filter is long, is masked.
bool reads_masked(const PixelMask& mask, const cv::Rect& rect, double angle_rad, double half_px) {
  for (double along_px = -half_px; along_px <= half_px; along_px += 0.5) {
    const cv::Rect moved = rect + cv::Point(static_cast<int>(std::lround(along_px * std::cos(angle_rad))),
                                            static_cast<int>(std::lround(along_px * std::sin(angle_rad))));
    const cv::Rect inside = moved & cv::Rect({}, mask.size());
    if (!inside.empty() && cv::countNonZero(mask.pixels()(inside)) < inside.area()) return true;
  }
  return false;
}

TEST(PixelMask, KeepsFiltersOffMaskedPixels) {
  const PixelMask mask(round_window(120));
  for (const double extent_px : {4.0, 10.0, 25.0}) {
    for (const double angle_rad : {0.0, 0.4, 1.3, 2.5}) {
      for (const double length_factor : {2.0, 4.0}) {
        SCOPED_TRACE(testing::Message() << extent_px << " px " << angle_rad << " rad " << length_factor);
        FrameBlur field = field_of(angle_rad, extent_px, 16);
        mark_static_edges(mask, {length_factor, false}, &field);
        const double half_px = 0.5 * length_factor * extent_px;
        for (int i = 0; i < field.grid.size(); ++i) {
          const cv::Rect rect = field.grid.rect(i);
          // Up to twice the width of a seam is left out around what has to be.
          constexpr int kMarginPx = 9;
          const cv::Rect wide(rect.x - kMarginPx, rect.y - kMarginPx, rect.width + 2 * kMarginPx,
                              rect.height + 2 * kMarginPx);
          if (reads_masked(mask, rect, angle_rad, half_px)) {
            EXPECT_EQ(field.blocks[i].status, BlockStatus::STATIC_EDGE) << i;
          } else if (!reads_masked(mask, wide, angle_rad, half_px)) {
            EXPECT_EQ(field.blocks[i].status, BlockStatus::DEBLURRED) << i;
          }
        }
        EXPECT_GT(field.count(BlockStatus::DEBLURRED), 0u);
      }
    }
  }
}

TEST(PixelMask, Keeps2dInversesFartherOff) {
  const PixelMask mask(round_window(120));
  FrameBlur lines = field_of(0.4, 6), planes = lines;
  mark_static_edges(mask, {4, false}, &lines);
  mark_static_edges(mask, {4, true}, &planes);
  EXPECT_LT(planes.count(BlockStatus::DEBLURRED), lines.count(BlockStatus::DEBLURRED));
  for (int i = 0; i < planes.grid.size(); ++i) {
    const cv::Rect rect = planes.grid.rect(i), wide(rect.x - 32, rect.y - 32, rect.width + 64, rect.height + 64);
    if (mask.masked_in(wide) > 0) {
      EXPECT_EQ(planes.blocks[i].status, BlockStatus::STATIC_EDGE);
    }
  }
}

// A 1-D filter serves them, and it reads less around a block.
TEST(PixelMask, SlightlyCurvedBlocksGet1dFiltersNearMaskedPixels) {
  constexpr double kExtentPx = 30;
  constexpr double kLimitPx = kMaxStraightDeviationPx + kStraightPathShare * kExtentPx;
  const PixelMask mask(round_window(120));
  const auto marked = [&mask](double deviation_px) {
    std::array<Eigen::Vector2d, kPathInstants> arc_px;
    for (int k = 0; k < kPathInstants; ++k) {
      const double t = k / (kPathInstants - 1.0) - 0.5;
      arc_px[k] = {kExtentPx * t, 8 * deviation_px * t * t};
    }
    FrameBlur field = field_of(0, kExtentPx);
    for (BlockBlur& block : field.blocks) block = classify_path(arc_px, {});
    EXPECT_EQ(field.blocks.front().curved_path_px.has_value(), deviation_px > 0);
    mark_static_edges(mask, {2, false}, &field);
    return field;
  };
  const FrameBlur straight = marked(0), slight = marked(0.99 * kLimitPx), strong = marked(1.01 * kLimitPx);
  int served = 0;
  for (int i = 0; i < straight.grid.size(); ++i) {
    EXPECT_EQ(slight.blocks[i].status, straight.blocks[i].status) << i;
    if (straight.blocks[i].status != BlockStatus::DEBLURRED) continue;
    const bool is_near = strong.blocks[i].status == BlockStatus::STATIC_EDGE;
    EXPECT_EQ(slight.blocks[i].curved_path_px.has_value(), !is_near) << i;
    served += is_near;
  }
  EXPECT_GT(served, 0);
  EXPECT_GT(strong.count(BlockStatus::DEBLURRED), 0u);
}

TEST(PixelMask, OnlyWhatWouldBeFilteredIsAtAStaticEdge) {
  const PixelMask mask(round_window(60));
  for (const BlockStatus status : kBlockStatuses) {
    FrameBlur field = field_of(0.3, 10);
    for (BlockBlur& block : field.blocks) block.status = status;
    mark_static_edges(mask, {}, &field);
    EXPECT_EQ(field.count(BlockStatus::STATIC_EDGE) > 0,
              status == BlockStatus::DEBLURRED || status == BlockStatus::STATIC_EDGE);
  }
}

// Quality is that of the pixels that are used.
TEST(PixelMask, MaskedBlocksDoNotCount) {
  const PixelMask mask(round_window(90));
  FrameBlur field = field_of(0, 10), whole = field;
  mark_masked(mask, &field);
  ASSERT_GT(assess_quality(field).share(BlockStatus::MASKED), 0.2);
  EXPECT_EQ(assess_quality(field).grade, QualityGrade::DEBLURRED);
  EXPECT_NEAR(*assess_quality(field).score, *assess_quality(whole).score, 1e-9);
  const cv::Mat trust = trust_mask(field, mask);
  EXPECT_EQ(cv::countNonZero(trust & (mask.pixels() == 0)), 0);
  EXPECT_GT(cv::countNonZero(trust), 1000);
}

TEST(PixelMask, MaskedPixelsDoNotChangeTheNoise) {
  const cv::Mat scene = test::textured_image(kWidthPx, kHeightPx, 5);
  const cv::Mat used = round_window(110);
  cv::Mat noisy = test::expose(64 + 0.4 * scene, 4, 2), rim = noisy.clone(), bright = noisy.clone();
  rim.setTo(30, used == 0);
  bright.setTo(200, used == 0);
  const PixelMask mask(used);
  for (const int mean_of : {1, 2}) {
    const double expected = image_noise(noisy, PixelLayout::GRAY, 8, mean_of, mask).value_or(0);
    EXPECT_GT(expected, 2);
    EXPECT_EQ(image_noise(rim, PixelLayout::GRAY, 8, mean_of, mask), expected);
    EXPECT_LT(image_noise(rim, PixelLayout::GRAY, 8, mean_of).value_or(0), 0.5 * expected) << "as it was without";
  }
  EXPECT_EQ(image_contrast(bright, PixelLayout::GRAY, 8, mask), image_contrast(rim, PixelLayout::GRAY, 8, mask));
  EXPECT_NE(image_contrast(bright, PixelLayout::GRAY, 8), image_contrast(rim, PixelLayout::GRAY, 8));
  cv::Mat color;
  cv::merge(std::vector<cv::Mat>{rim, rim, rim}, color);
  EXPECT_EQ(image_noise(color, PixelLayout::BGR, 8, 1, mask), image_noise(rim, PixelLayout::GRAY, 8, 1, mask));
}

}  // namespace
}  // namespace gyro_deblur::pixel_mask_test
