#include "blur/exposure_estimate.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "paths_2d.hpp"
#include "validation_scores.hpp"

namespace gyro_deblur::exposure_estimate_test {
namespace {

constexpr int kWidthPx = 640, kHeightPx = 480;

cv::Mat texture(std::uint64_t seed) { return test::textured_image(kWidthPx, kHeightPx, seed); }

/// A field for `exposure` times the true one.
FrameBlur assumed_field(double angle_rad, double true_px, double exposure) {
  return uniform_blur_field(kWidthPx, kHeightPx, angle_rad, exposure * true_px, {});
}

/// Expects a ratio that is right to a share, and an uncertainty that says so.
void expect_ratio(const std::optional<ExposureEstimate>& estimate, double ratio, double share = 0.03) {
  ASSERT_TRUE(estimate);
  EXPECT_NEAR(std::log(estimate->ratio), std::log(ratio), share);
  EXPECT_LT(std::abs(std::log(estimate->ratio / ratio)), 3 * estimate->log_stddev);
  EXPECT_LT(estimate->log_stddev, 0.06);
}

struct Scene {
  double extent_px, angle_rad;
  test::Exposed how;
};
class ExposureEstimateTest : public testing::TestWithParam<Scene> {};

TEST_P(ExposureEstimateTest, IsRightFromAnyAssumption) {
  const auto& [extent_px, angle_rad, how] = GetParam();
  const cv::Mat image = test::expose(test::blur_along_line(texture(51), angle_rad, extent_px), how, 1);
  for (const double assumption : {0.35, 0.6, 1.0, 1.6, 3.0}) {
    SCOPED_TRACE(assumption);
    expect_ratio(estimate_exposure(assumed_field(angle_rad, extent_px, assumption), image), 1 / assumption);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, ExposureEstimateTest,
                         testing::Values(Scene{7, 0.4, {1}}, Scene{10, 0, {2}}, Scene{13, 1.57, {4}},
                                         Scene{16, 2.2, {3, 0.35}}, Scene{25, 1.0, {2, 1, 500}}, Scene{50, 2.8, {2}}));

TEST(ExposureEstimate, FollowsPathsOfNonuniformSpeed) {
  // Three quarters of the exposure in half of the line.
  Path1d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const float s = static_cast<float>(k) / (kPathInstants - 1);
    path_px[k] = 16 * (s < 0.75F ? s * 2 / 3 : 0.5F + 2 * (s - 0.75F)) - 16.0F / 3;
  }
  const cv::Mat image = test::expose(test::blur_along_path(texture(52), 0.7, path_px), 1.5, 2);
  for (const float assumption : {0.5F, 1.0F, 1.8F}) {
    SCOPED_TRACE(assumption);
    FrameBlur field = assumed_field(0.7, 16, assumption);
    for (BlockBlur& block : field.blocks) {
      block.nonuniform_path_px = path_px;
      for (float& place : *block.nonuniform_path_px) place *= assumption;
    }
    expect_ratio(estimate_exposure(field, image), 1 / assumption);
  }
}

TEST(ExposureEstimate, FollowsCurvedPaths) {
  const Path2d path_px = test::arc_path(22, 4, 0.5);
  const cv::Mat image = test::expose(test::blur_in_2d(texture(53), path_px), 1.5, 3);
  for (const float assumption : {0.5F, 1.0F, 1.8F}) {
    SCOPED_TRACE(assumption);
    FrameBlur field = assumed_field(0.5, 22, assumption);
    for (BlockBlur& block : field.blocks) {
      block.curved_path_px = path_px;
      for (Eigen::Vector2f& place : *block.curved_path_px) place *= assumption;
    }
    expect_ratio(estimate_exposure(field, image), 1 / assumption);
  }
}

/// Displacement within the exposure of a camera that turns and approaches what it sees.
Eigen::Vector2d approaching_px(const Eigen::Vector2d& pixel_px) {
  constexpr double kGrowth = 0.05;
  return Eigen::Vector2d(14, 4) + kGrowth * (pixel_px - Eigen::Vector2d(0.5 * kWidthPx, 0.5 * kHeightPx));
}

cv::Mat approached(const cv::Mat& scene) {
  constexpr int kInstants = 96;
  cv::Mat sum = cv::Mat::zeros(scene.size(), CV_32F), x(scene.size(), CV_32F), y(scene.size(), CV_32F), seen;
  for (int k = 0; k < kInstants; ++k) {
    const double part = (k + 0.5) / kInstants - 0.5;
    for (int row = 0; row < scene.rows; ++row) {
      for (int col = 0; col < scene.cols; ++col) {
        const Eigen::Vector2d from_px = Eigen::Vector2d(col, row) - part * approaching_px({col, row});
        x.at<float>(row, col) = static_cast<float>(from_px.x());
        y.at<float>(row, col) = static_cast<float>(from_px.y());
      }
    }
    cv::remap(scene, seen, x, y, cv::INTER_CUBIC, cv::BORDER_REFLECT);
    cv::accumulate(seen, sum);
  }
  return sum / kInstants;
}

// With the same blur all over each window, the mean of these estimates would be 2.5 % too short.
TEST(ExposureEstimate, FollowsBlurThatVariesWithinAWindow) {
  FrameBlur field = assumed_field(0, 14, 1);
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d moved_px = approaching_px(field.grid.center(i));
    field.blocks[i] = classify_blur(moved_px.x(), moved_px.y(), {});
  }
  constexpr int kImages = 8;
  double sum = 0;
  for (int seed = 0; seed < kImages; ++seed) {
    const auto estimate = estimate_exposure(field, test::expose(approached(texture(70 + seed)), 2, seed));
    ASSERT_TRUE(estimate);
    sum += std::log(estimate->ratio);
  }
  EXPECT_NEAR(sum / kImages, 0, 0.012);
}

/// The left part of an image from one, the right from the other.
cv::Mat side_by_side(const cv::Mat& left, const cv::Mat& right, int border_px) {
  cv::Mat both = right.clone();
  left.colRange(0, border_px).copyTo(both.colRange(0, border_px));
  return both;
}

TEST(ExposureEstimate, IsNotMisledByWhatMovesByItself) {
  const cv::Mat scene = test::blur_along_line(texture(54), 0.3, 12),
                object = test::blur_along_line(texture(55), 1.5, 20);
  const cv::Mat image = test::expose(side_by_side(object, scene, kWidthPx / 4), 2, 4);
  expect_ratio(estimate_exposure(assumed_field(0.3, 12, 0.7), image), 1 / 0.7);
}

TEST(ExposureEstimate, IsNotKnownWhereHalvesContradictEachOther) {
  const cv::Mat scene = texture(56), once = test::blur_along_line(scene, 0.3, 12),
                twice = test::blur_along_line(scene, 0.3, 24);
  const cv::Mat image = test::expose(side_by_side(once, twice, kWidthPx / 2), 2, 5);
  EXPECT_FALSE(estimate_exposure(assumed_field(0.3, 12, 1), image));
}

TEST(ExposureEstimate, IsNotKnownOfSharpImagesWhateverIsAssumed) {
  const cv::Mat image = test::expose(texture(57), 2, 6);
  for (const double assumed_px : {3.0, 6.0, 12.0, 25.0, 60.0}) {
    EXPECT_FALSE(estimate_exposure(assumed_field(1.1, assumed_px, 1), image)) << assumed_px;
  }
}

TEST(ExposureEstimate, IsNotKnownBeyondTheRangeOfRatios) {
  const cv::Mat image = test::expose(test::blur_along_line(texture(58), 1.1, 20), 2, 7);
  EXPECT_FALSE(estimate_exposure(assumed_field(1.1, 20, 0.2), image));
  EXPECT_FALSE(estimate_exposure(assumed_field(1.1, 20, 5), image));
}

TEST(ExposureEstimate, IsNotLongerThanAnExposureMayBe) {
  const cv::Mat image = test::expose(test::blur_along_line(texture(66), 1.1, 20), 2, 7);
  FrameBlur field = assumed_field(1.1, 20, 0.5);
  field.exposure_ns = 10'000'000;
  for (const TimeNs longest_ns : {0, 60'000'000, 20'000'000}) {
    expect_ratio(estimate_exposure(field, image, {}, 0, longest_ns), 2);
  }
  EXPECT_FALSE(estimate_exposure(field, image, {}, 0, 15'000'000));
}

TEST(ExposureEstimate, IsNotKnownWithoutTextureOrInNoise) {
  const FrameBlur field = assumed_field(0.3, 15, 1);
  const cv::Mat flat(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(90));
  EXPECT_FALSE(estimate_exposure(field, flat));
  for (const std::uint64_t seed : {8, 9, 10, 11}) {
    EXPECT_FALSE(estimate_exposure(field, test::expose(flat, 5, seed))) << seed;
  }
  // Blur that is there, below the noise.
  const cv::Mat blurred = test::blur_along_line(texture(59), 0.3, 15);
  EXPECT_FALSE(estimate_exposure(field, test::expose(blurred, {60, 0.35}, 12)));
}

TEST(ExposureEstimate, IsNotKnownOfBlurThatIsTooSmall) {
  const cv::Mat image = test::expose(test::blur_along_line(texture(60), 0.3, 1.5), 2, 13);
  EXPECT_FALSE(estimate_exposure(assumed_field(0.3, 1.5, 1), image));
  EXPECT_FALSE(estimate_exposure(assumed_field(0.3, 1.5, 3), image));
}

TEST(ExposureEstimate, IsLessCertainWithNoise) {
  const cv::Mat blurred = test::blur_along_line(texture(61), 0.9, 12);
  const FrameBlur field = assumed_field(0.9, 12, 1);
  const auto little = estimate_exposure(field, test::expose(blurred, {1, 0.5}, 14)),
             much = estimate_exposure(field, test::expose(blurred, {5, 0.5}, 14));
  ASSERT_TRUE(little && much);
  EXPECT_LT(1.3 * little->log_stddev, much->log_stddev);
}

TEST(ExposureEstimate, LeavesBlocksOutWhoseBlurIsNotKnown) {
  // Of the left third nothing is known, and what is there is other blur.
  const cv::Mat scene = test::blur_along_line(texture(62), 0.3, 12),
                other = test::blur_along_line(texture(63), 0.3, 20);
  const cv::Mat image = test::expose(side_by_side(other, scene, 3 * kWidthPx / 5), 2, 15);
  FrameBlur field = assumed_field(0.3, 12, 1);
  for (const BlockStatus status : {BlockStatus::NO_GYRO, BlockStatus::MASKED, BlockStatus::STATIC_EDGE}) {
    for (int i = 0; i < field.grid.size(); ++i) {
      if (field.grid.rect(i).x < 3 * kWidthPx / 5) field.blocks[i].status = status;
    }
    expect_ratio(estimate_exposure(field, image), 1);
  }
  for (BlockBlur& block : field.blocks) block.status = BlockStatus::NO_GYRO;
  EXPECT_FALSE(estimate_exposure(field, image));
}

TEST(ExposureEstimate, IsTheSameOnAnyNumberOfThreads) {
  const cv::Mat image = test::expose(test::blur_along_line(texture(64), 0.3, 12), 2, 16);
  const FrameBlur field = assumed_field(0.3, 12, 0.6);
  const auto alone = estimate_exposure(field, image, 2.0, 1), together = estimate_exposure(field, image, 2.0, 3);
  ASSERT_TRUE(alone && together);
  EXPECT_EQ(alone->ratio, together->ratio);
  EXPECT_EQ(alone->log_stddev, together->log_stddev);
}

TEST(ExposureEstimate, TakesImagesOfAnySizeAndRefusesOthers) {
  for (const cv::Size& size : {cv::Size(1, 1), cv::Size(127, 300), cv::Size(128, 128), cv::Size(193, 130)}) {
    const FrameBlur field = uniform_blur_field(size.width, size.height, 0.3, 12, {});
    const cv::Mat image = test::textured_image(size.width, size.height, 65);
    EXPECT_NO_THROW(estimate_exposure(field, image)) << size;
    EXPECT_THROW(estimate_exposure(field, cv::Mat(size.height + 1, size.width, CV_8UC1)), std::invalid_argument);
    EXPECT_THROW(estimate_exposure(field, cv::Mat(size, CV_16UC1)), std::invalid_argument);
  }
}

}  // namespace
}  // namespace gyro_deblur::exposure_estimate_test
