#include "gyro_deblur/overlay.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::overlay_test {
namespace {

cv::Vec3b bgr(BlockStatus status) {
  const cv::Vec3b rgb = status_color_rgb(status);
  return {rgb[2], rgb[1], rgb[0]};
}

double distance(const cv::Vec3b& a, const cv::Vec3b& b) { return cv::norm(cv::Vec3i(a) - cv::Vec3i(b)); }

FrameBlur field_of(int width_px, int height_px, double angle_rad, double extent_px) {
  return uniform_blur_field(width_px, height_px, angle_rad, extent_px, {});
}

TEST(StatusColor, IsDifferentForEveryStatusAndNamedRight) {
  std::set<std::tuple<int, int, int>> colors;
  for (const BlockStatus status : kBlockStatuses) {
    const cv::Vec3b c = status_color_rgb(status);
    colors.insert({c[0], c[1], c[2]});
  }
  EXPECT_EQ(colors.size(), std::size(kBlockStatuses));
  const auto is = [](BlockStatus status, bool r, bool g, bool b) {
    const cv::Vec3b c = status_color_rgb(status);
    return (c[0] > 150) == r && (c[1] > 150) == g && (c[2] > 150) == b;
  };
  EXPECT_TRUE(is(BlockStatus::DEBLURRED, false, true, false));
  EXPECT_TRUE(is(BlockStatus::SHARP, true, true, true));
  EXPECT_TRUE(is(BlockStatus::REJECTED, true, false, false));
  EXPECT_TRUE(is(BlockStatus::TOO_LARGE, true, false, true));
  EXPECT_TRUE(is(BlockStatus::NO_GYRO, true, true, false));
  EXPECT_TRUE(is(BlockStatus::TOO_CURVED, false, true, true));
  EXPECT_TRUE(is(BlockStatus::NOISY, false, false, true));
  EXPECT_TRUE(is(BlockStatus::MASKED, false, false, false));
  EXPECT_TRUE(is(BlockStatus::STATIC_EDGE, true, false, false));
}

TEST(BlurSegment, IsThePathCentredOnTheBlock) {
  const FrameBlur field = field_of(640, 480, std::atan2(4, 3), 50);
  const BlurSegment segment = blur_segment(field, 11);  // second row, second column
  EXPECT_LT((segment.from_px - Eigen::Vector2d(95.5 - 15, 95.5 - 20)).norm(), 1e-4);
  EXPECT_LT((segment.to_px - Eigen::Vector2d(95.5 + 15, 95.5 + 20)).norm(), 1e-4);
}

TEST(PathsApart, AreAllWhereThereIsRoomAndFewerWhereThereIsNot) {
  // 10 x 7 blocks of 64 px, the last row half cut off.
  const auto count = [](double angle_rad, double extent_px, double gap_px) {
    const std::vector<char> chosen = paths_apart(field_of(640, 448, angle_rad, extent_px), gap_px);
    EXPECT_EQ(chosen.size(), 70u);
    EXPECT_EQ(chosen[0], 1);
    return std::count(chosen.begin(), chosen.end(), 1);
  };
  EXPECT_EQ(count(0, 50, 8), 70);
  EXPECT_EQ(count(0, 62, 8), 35) << "every other column";
  EXPECT_EQ(count(0, 150, 8), 28) << "every third";
  EXPECT_EQ(count(M_PI / 2, 150, 8), 30) << "every third row";
  EXPECT_EQ(count(M_PI / 4, 80, 8), 70) << "neighbours of the diagonal are 90 px apart";
}

TEST(PathsApart, NeverComeNearerThanTheGap) {
  constexpr double kGapPx = 8;
  for (const double angle_rad : {0.0, 0.3, 0.8, 1.2, 2.0, 2.9}) {
    FrameBlur field = field_of(640, 480, angle_rad, 120);
    for (int i = 0; i < field.grid.size(); ++i) field.blocks[i].angle_rad += 0.05f * static_cast<float>(i % 7);
    const std::vector<char> chosen = paths_apart(field, kGapPx);
    std::vector<std::pair<int, Eigen::Vector2d>> points;  // along each path
    for (int i = 0; i < field.grid.size(); ++i) {
      if (!chosen[i]) continue;
      const BlurSegment path = blur_segment(field, i);
      for (int k = 0; k <= 30; ++k) points.emplace_back(i, path.from_px + (path.to_px - path.from_px) * k / 30.0);
    }
    double nearest_px = 1e9;
    for (const auto& a : points) {
      for (const auto& b : points) {
        if (a.first < b.first) nearest_px = std::min(nearest_px, (a.second - b.second).norm());
      }
    }
    EXPECT_GE(nearest_px, kGapPx - 1e-6) << angle_rad;
    EXPECT_GT(std::count(chosen.begin(), chosen.end(), 1), 5) << angle_rad;
  }
}

TEST(DrawOverlay, DrawsEachBlockInTheColourOfItsStatus) {
  const cv::Mat grey(960, 1280, CV_8UC1, cv::Scalar(120));
  FrameBlur field = field_of(1280, 960, 0, 40);
  for (int i = 0; i < field.grid.size(); ++i) field.blocks[i].status = kBlockStatuses[i % 5];
  const cv::Mat image = draw_overlay(grey, field);
  ASSERT_EQ(image.type(), CV_8UC3);
  ASSERT_EQ(image.size(), grey.size());
  EXPECT_EQ(grey.at<uchar>(500, 500), 120);  // the input is unchanged
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d center = field.grid.center(i);
    if (center.x() < 520 && center.y() < 320) continue;  // the legend may be there
    const int x = static_cast<int>(center.x()), y = static_cast<int>(center.y());
    // The line is 2 px wide, so that the pixel next to the centre is full.
    EXPECT_LT(cv::norm(image.at<cv::Vec3b>(y, x) - bgr(field.blocks[i].status)), 40) << i;
    EXPECT_LT(cv::norm(image.at<cv::Vec3b>(y, x + 18) - bgr(field.blocks[i].status)), 40) << i;
    EXPECT_EQ(image.at<cv::Vec3b>(y, x + 28), cv::Vec3b(120, 120, 120)) << i;  // beyond the end
    EXPECT_EQ(image.at<cv::Vec3b>(y + 10, x + 15), cv::Vec3b(120, 120, 120)) << i;
  }
}

TEST(DrawOverlay, LegendDistinguishesFields) {
  const cv::Mat grey(480, 752, CV_8UC1, cv::Scalar(120));
  FrameBlur a = field_of(752, 480, M_PI / 2, 40);
  FrameBlur b = a;
  b.blocks.back().status = BlockStatus::REJECTED;  // far from the legend
  FrameBlur c = a;
  for (BlockBlur& blur : c.blocks) blur.extent_px = 30;
  const cv::Rect legend(102, 2, 50, 44);  // of the text; between the blocks' vertical lines at x = 95 and 159
  const auto differs = [&](const FrameBlur& f, const FrameBlur& g) {
    return cv::norm(draw_overlay(grey, f)(legend), draw_overlay(grey, g)(legend), cv::NORM_INF) > 50;
  };
  EXPECT_FALSE(differs(a, a));
  EXPECT_TRUE(differs(a, b));
  EXPECT_TRUE(differs(a, c));
}

TEST(ResidualSegment, IsTheWayWithinTheExposureFromTheCentre) {
  FrameBlur field = field_of(640, 480, 0, 20);
  field.exposure_ns = 20'000'000;
  EXPECT_FALSE(residual_segment(field, 11));
  field.blocks[11].residual = ResidualVelocity{{300, -400}, 10};
  const auto segment = residual_segment(field, 11);
  ASSERT_TRUE(segment);
  EXPECT_LT((segment->from_px - Eigen::Vector2d(95.5, 95.5)).norm(), 1e-9);
  EXPECT_LT((segment->to_px - Eigen::Vector2d(101.5, 87.5)).norm(), 1e-9);
}

TEST(DrawOverlay, MarksBlocksThatHaveOpticalFlowAndDrawsIt) {
  const cv::Mat grey(960, 1280, CV_8UC1, cv::Scalar(120));  // lines are 2 px wide
  const cv::Vec3b rgb = residual_color_rgb(), orange(rgb[2], rgb[1], rgb[0]);
  for (const BlockStatus status : kBlockStatuses) EXPECT_GT(distance(bgr(status), orange), 75) << to_string(status);
  FrameBlur field = field_of(1280, 960, 0, 40);
  field.exposure_ns = 20'000'000;
  const int with = field.grid.index_at(700, 500), without = with + 1;
  const cv::Mat before = draw_overlay(grey, field);
  field.blocks[with].residual = ResidualVelocity{{0, 1000}, 10};  // 20 px down
  cv::Mat image = draw_overlay(grey, field);
  const int x = static_cast<int>(field.grid.center(with).x()), y = static_cast<int>(field.grid.center(with).y());
  EXPECT_LT(distance(image.at<cv::Vec3b>(y + 16, x), orange), 60) << "the line";
  EXPECT_EQ(image.at<cv::Vec3b>(y - 16, x), cv::Vec3b(120, 120, 120)) << "in its direction alone";
  EXPECT_EQ(image.at<cv::Vec3b>(y + 26, x), cv::Vec3b(120, 120, 120)) << "beyond its end";
  EXPECT_LT(distance(image.at<cv::Vec3b>(y - 10, x), orange), 60) << "the ring";
  EXPECT_LT(distance(image.at<cv::Vec3b>(y, x), bgr(BlockStatus::DEBLURRED)), 40) << "the status stays";
  const cv::Rect next = field.grid.rect(without);
  EXPECT_EQ(cv::norm(image(next), before(next), cv::NORM_INF), 0) << "nothing is from images there";
  // Where its path is not drawn, the ring alone shows the block.
  for (BlockBlur& blur : field.blocks) blur.extent_px = 150;
  const std::vector<char> drawn = paths_apart(field, 16);
  const int hidden = static_cast<int>(std::find(drawn.begin() + with, drawn.end(), 0) - drawn.begin());
  field.blocks[hidden].residual = field.blocks[with].residual;
  image = draw_overlay(grey, field);
  const Eigen::Vector2d center = field.grid.center(hidden);
  const auto at = [&](int dy) {
    return image.at<cv::Vec3b>(static_cast<int>(center.y()) + dy, static_cast<int>(center.x()));
  };
  EXPECT_LT(distance(at(-10), orange), 60);
  EXPECT_EQ(at(16), cv::Vec3b(120, 120, 120));
}

TEST(DrawOverlay, LegendHasTheMedianOfWhatImagesTell) {
  const cv::Mat grey(480, 752, CV_8UC1, cv::Scalar(120));
  FrameBlur field = field_of(752, 480, M_PI / 2, 40);
  field.exposure_ns = 20'000'000;
  for (int i = 60; i < field.grid.size(); ++i) field.blocks[i].residual = ResidualVelocity{{100.0, 0}, 10};
  const cv::Rect legend(0, 0, 160, 60);
  const cv::Mat a = draw_overlay(grey, field)(legend);
  field.blocks.back().residual->velocity_px_s.x() = 900;
  EXPECT_EQ(cv::norm(a, draw_overlay(grey, field)(legend), cv::NORM_INF), 0) << "one of many";
  for (BlockBlur& blur : field.blocks) {
    if (blur.residual) blur.residual->velocity_px_s.x() = 900;
  }
  EXPECT_GT(cv::norm(a, draw_overlay(grey, field)(legend), cv::NORM_INF), 50);
}

TEST(DrawOverlay, CopesWithSmallImagesAndLongPaths) {
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(9, 3), cv::Size(64, 64), cv::Size(3, 700)}) {
    FrameBlur field = field_of(size.width, size.height, 1, 1e5);
    EXPECT_EQ(draw_overlay(cv::Mat(size, CV_8UC1, cv::Scalar(0)), field).size(), size);
    for (BlockBlur& blur : field.blocks) blur = {0, 0, BlockStatus::NO_GYRO};
    EXPECT_EQ(draw_overlay(cv::Mat(size, CV_8UC1, cv::Scalar(0)), field).size(), size);
  }
}

TEST(DrawOverlay, RefusesImagesThatDoNotFit) {
  const FrameBlur field = field_of(640, 480, 0, 10);
  EXPECT_THROW(draw_overlay(cv::Mat(480, 641, CV_8UC1), field), std::invalid_argument);
  EXPECT_THROW(draw_overlay(cv::Mat(481, 640, CV_8UC1), field), std::invalid_argument);
  EXPECT_THROW(draw_overlay(cv::Mat(480, 640, CV_8UC3), field), std::invalid_argument);
  EXPECT_THROW(draw_overlay(cv::Mat(), field), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur::overlay_test
