#include "blur/static_content.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "synthetic_blur.hpp"

namespace gyro_deblur::static_content_test {
namespace {

constexpr int kWidthPx = 480, kHeightPx = 360;
/// 5 s at 20 Hz.
constexpr int kImages = 100;

const cv::Mat& scene() {
  static const cv::Mat kScene = test::textured_image(1600, 1000, 3);
  return kScene;
}

/// Where the camera looks: rotating to and fro across the scene, in whole pixels.
cv::Point place(int image, double along_x_px, double along_y_px) {
  return {static_cast<int>(std::lround(560 + along_x_px * std::sin(0.13 * image))),
          static_cast<int>(std::lround(320 + along_y_px * std::sin(0.17 * image + 1)))};
}

cv::Mat view(const cv::Point& at) { return scene()(cv::Rect(at, cv::Size(kWidthPx, kHeightPx))).clone(); }

using Change = std::function<void(cv::Mat&, int)>;

/// Images of a camera that looks to and fro, changed, with noise.
StaticContent after(const Change& change, double along_x_px = 500, double along_y_px = 0, double noise = 1.5,
                    int images = kImages, const PixelMask& mask = {}) {
  StaticContent content;
  cv::Point before = place(0, along_x_px, along_y_px);
  for (int i = 0; i < images; ++i) {
    const cv::Point now = place(i, along_x_px, along_y_px);
    cv::Mat image = view(now);
    change(image, i);
    // Looking to the right moves the scene to the left.
    if (content.move({before.x - now.x, before.y - now.y})) {
      content.add(test::expose(image, noise, static_cast<std::uint64_t>(100 + i)), mask);
    }
    before = now;
  }
  return content;
}

cv::Mat round_window() {
  cv::Mat used(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(0));
  cv::circle(used, {kWidthPx / 2, kHeightPx / 2}, 210, cv::Scalar(255), cv::FILLED);
  return used;
}

void add_rim(cv::Mat& image, int) { image.setTo(4, round_window() == 0); }

/// Bright, with a texture of its own.
void add_bumper(cv::Mat& image, int) {
  const cv::Rect bumper(100, 270, 280, 90);
  cv::Mat texture;
  scene()(cv::Rect(10, 10, bumper.width, bumper.height)).convertTo(texture, CV_8U, 0.4, 150);
  texture.copyTo(image(bumper));
}

TEST(StaticContent, FindsARim) {
  for (const bool along_y : {false, true}) {
    const StaticContent content = along_y ? after(add_rim, 0, 300) : after(add_rim);
    const double black = 1 - cv::countNonZero(round_window()) / (1.0 * kWidthPx * kHeightPx);
    EXPECT_NEAR(content.share(), black, 0.06);
    ASSERT_FALSE(content.edges().empty());
    const cv::Mat edges = content.edges().pixels() == 0;
    // Within two cells of the circle, and on most of what the motion crosses.
    int on_circle = 0, points = 0;
    cv::Mat near(edges.size(), CV_8UC1, cv::Scalar(0));
    cv::circle(near, {kWidthPx / 2, kHeightPx / 2}, 210, cv::Scalar(255), 2 * 26);
    EXPECT_EQ(cv::countNonZero(edges & (near == 0)), 0);
    for (double angle_rad = 0; angle_rad < 2 * CV_PI; angle_rad += 0.01) {
      if (std::abs(along_y ? std::sin(angle_rad) : std::cos(angle_rad)) < 0.5) continue;
      const cv::Point at(cvRound(kWidthPx / 2 + 210 * std::cos(angle_rad)),
                         cvRound(kHeightPx / 2 + 210 * std::sin(angle_rad)));
      if (!cv::Rect(16, 16, kWidthPx - 32, kHeightPx - 32).contains(at)) continue;
      ++points;
      on_circle += edges.at<uchar>(at) != 0;
    }
    EXPECT_GT(on_circle, 0.9 * points) << along_y;
  }
}

TEST(StaticContent, FindsAPartOfTheVehicle) {
  const StaticContent content = after(add_bumper);
  EXPECT_GT(content.share(), 0.03);
  EXPECT_LT(content.share(), 0.2) << "it has 15 % of the image";
  ASSERT_FALSE(content.edges().empty());
  const cv::Mat edges = content.edges().pixels() == 0;
  EXPECT_GT(cv::countNonZero(edges(cv::Rect(100, 270, 280, 90))), 1000);
  EXPECT_EQ(cv::countNonZero(edges.rowRange(0, 240)), 0);
}

TEST(StaticContent, SaysNothingOfWhatIsMasked) {
  const StaticContent masked = after(add_rim, 500, 0, 1.5, kImages, PixelMask(round_window()));
  EXPECT_EQ(masked.share(), 0);
  EXPECT_TRUE(masked.edges().empty());
  const auto both = [](cv::Mat& image, int i) {
    add_bumper(image, i);
    add_rim(image, i);
  };
  EXPECT_GT(after(both, 500, 0, 1.5, kImages, PixelMask(round_window())).share(), 0.02) << "the bumper is not masked";
}

TEST(StaticContent, IsForgottenWhenItIsGone) {
  const auto until_half_time = [](cv::Mat& image, int i) {
    if (i < kImages) add_bumper(image, i);
  };
  EXPECT_GT(after(until_half_time).share(), 0);
  EXPECT_EQ(after(until_half_time, 500, 0, 1.5, 2 * kImages).share(), 0);
}

// Each of them stands still in part, or has edges, but no edge that stands still.
TEST(StaticContent, OfTheSceneIsNone) {
  const Change nothing = [](cv::Mat&, int) {};
  for (const double noise : {0.0, 1.5, 8.0}) {
    EXPECT_EQ(after(nothing, 500, 0, noise).share(), 0) << noise;
    EXPECT_EQ(after(nothing, 0, 300, noise).share(), 0) << noise;
    EXPECT_EQ(after(nothing, 400, 200, noise).share(), 0) << noise;
  }
  const Change sky = [](cv::Mat& image, int) { image.rowRange(0, 150).setTo(255); };
  EXPECT_EQ(after(sky).share(), 0) << "a horizon along the motion";
  const auto horizon = [](double slope) {
    return [slope](cv::Mat& image, int i) {
      const double shift_px = slope * place(i, 500, 0).x;
      for (int x = 0; x < kWidthPx; ++x) {
        const int y = std::clamp(static_cast<int>(150 + slope * (x - 240) + shift_px - 560 * slope), 0, kHeightPx);
        image.col(x).rowRange(0, y).setTo(255);
      }
    };
  };
  for (const double slope : {0.01, 0.03, 0.1}) EXPECT_EQ(after(horizon(slope)).share(), 0) << slope;
  const Change wall = [](cv::Mat& image, int) { image.setTo(120); };
  EXPECT_EQ(after(wall).share(), 0);
  const Change dark = [](cv::Mat& image, int i) {
    add_rim(image, i);
    image = 0.06 * image;
  };
  EXPECT_EQ(after(dark, 500, 0, 5).share(), 0) << "too dark for an edge";
  const Change vignette = [](cv::Mat& image, int) {
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const double off = std::hypot(x - 240, y - 180) / 300;
        image.at<uchar>(y, x) = cv::saturate_cast<uchar>(image.at<uchar>(y, x) * (1 - off * off));
      }
    }
  };
  EXPECT_EQ(after(vignette).share(), 0);
}

// The scene's own edges stand still, and the gyroscope says that the camera rotates: it is not this camera's.
TEST(StaticContent, ImageThatDoesNotRotateWithTheGyroscopeIsNone) {
  const Change stands = [](cv::Mat& image, int) { image = view({560, 320}); };
  EXPECT_EQ(after(stands).share(), 0);
  const Change with_people = [](cv::Mat& image, int i) {
    const cv::Mat moved = image(cv::Rect(5 * (i % 60), 100, 60, 200)).clone();
    image = view({560, 320});
    moved.copyTo(image(cv::Rect(5 * (i % 60), 100, 60, 200)));
  };
  EXPECT_EQ(after(with_people).share(), 0);
}

TEST(StaticContent, RepeatedAndFrozenPicturesAreNone) {
  cv::Mat last;
  const Change every_second = [&last](cv::Mat& image, int i) {
    if (i % 2 == 0) last = image.clone();
    image = last.clone();
  };
  EXPECT_EQ(after(every_second, 500, 0, 0).share(), 0);
  const Change frozen = [&last](cv::Mat& image, int i) {
    if (i % 50 < 12) last = image.clone();
    image = last.clone();
  };
  EXPECT_EQ(after(frozen, 500, 0, 0).share(), 0);
  EXPECT_EQ(after(frozen, 500, 0, 1).share(), 0) << "decoded anew";
}

TEST(StaticContent, CameraAtRestIsNotLookedAt) {
  StaticContent content;
  for (int i = 0; i < 1000; ++i) {
    // A bias of 0.05 rad/s at 20 Hz, with 400 px of focal length.
    EXPECT_FALSE(content.move({1, -1}));
  }
  EXPECT_FALSE(content.move({std::nan(""), 0}));
  EXPECT_TRUE(content.move({5, 0}));
}

TEST(StaticContent, StartsAnewWithImagesOfAnotherSize) {
  StaticContent content = after(add_rim);
  ASSERT_GT(content.share(), 0);
  ASSERT_TRUE(content.move({10, 0}));
  content.add(cv::Mat::zeros(120, 160, CV_8UC1), {});
  EXPECT_EQ(content.share(), 0);
  EXPECT_TRUE(content.edges().empty());
  ASSERT_TRUE(content.move({10, 0}));
  content.add(cv::Mat::zeros(9, 9, CV_8UC1), {});
  EXPECT_EQ(content.share(), 0);
}

}  // namespace
}  // namespace gyro_deblur::static_content_test
