#include "baselines.hpp"

#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "evaluation.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/options.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::experiments {
namespace {

const cv::Size kSize(480, 360);
constexpr LineBlur kBlur = {20 * CV_PI / 180, 31};
constexpr double kNoiseToSignalRatio = 0.01;

/// Texture as smooth as a photograph's.
cv::Mat scene_of(const cv::Size& size) {
  cv::Mat scene;
  cv::GaussianBlur(test::textured_image(size.width, size.height, 11), scene, cv::Size(), 2);
  return scene;
}

/// A sharp scene, and the middle of its blurred image with a little noise.
struct Example {
  cv::Mat sharp, blurred;
};
Example make_example(const LineBlur& blur, double noise = 1) {
  constexpr int kMargin = 32;
  const cv::Mat scene = scene_of(kSize + cv::Size(2 * kMargin, 2 * kMargin));
  const cv::Rect middle({kMargin, kMargin}, kSize);
  const cv::Mat blurred = test::blur_along_line(scene, blur.angle_rad, blur.extent_px);
  return {scene(middle).clone(), test::expose(blurred(middle), noise, 5)};
}

double rmse(const cv::Mat& a, const cv::Mat& b) {
  return cv::norm(a, b, cv::NORM_L2) / std::sqrt(static_cast<double>(a.total()));
}

cv::Mat as8(const cv::Mat& image) {
  cv::Mat out;
  image.convertTo(out, CV_8U);
  return out;
}

TEST(AsBlurred, CountsDeblurredBlocksAsCopied) {
  FrameBlur field = uniform_blur_field(128, 64, 0.5, 20, {});
  field.blocks[1].status = BlockStatus::REJECTED;
  field.blocks[0].mean_place_px = {1, 2};
  const FrameBlur blurred = as_blurred(field);
  EXPECT_EQ(blurred.count(BlockStatus::DEBLURRED), 0u);
  EXPECT_EQ(blurred.blocks[1].status, BlockStatus::REJECTED);
  EXPECT_EQ(blurred.blocks[0].apparent_offset_px(), Eigen::Vector2d(1, 2));
}

TEST(DeblurInFrequency, UndoesAPeriodicBlur) {
  // Of a wave the filter leaves (1 + gamma) H^2 / (H^2 + gamma), gamma = kNoiseToSignalRatio, H = sinc(extent *
  // frequency along the line).
  const cv::Size size(200, 100);
  const LineBlur blur = {0, 8};
  cv::Mat wave(size, CV_64F);
  constexpr int kPeriods = 10;
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) wave.at<double>(y, x) = std::cos(2 * CV_PI * kPeriods * x / size.width);
  }
  const double argument = CV_PI * blur.extent_px * kPeriods / size.width, H = std::sin(argument) / argument;
  const cv::Mat restored = deblur_in_frequency(H * wave, blur, kNoiseToSignalRatio, false);
  EXPECT_LT(
      cv::norm(restored, wave * ((1 + kNoiseToSignalRatio) * H * H / (H * H + kNoiseToSignalRatio)), cv::NORM_INF),
      1e-9);
}

TEST(TaperEdges, MakesOppositeBordersAgreeAndLeavesTheInterior) {
  const cv::Mat image = make_example(kBlur).blurred;
  const cv::Mat tapered = taper_edges(image, kBlur);
  const auto seam = [](const cv::Mat& any) {
    cv::Mat real;
    any.convertTo(real, CV_64F);
    return rmse(real.col(0), real.col(real.cols - 1)) + rmse(real.row(0), real.row(real.rows - 1));
  };
  EXPECT_LT(seam(tapered), 0.3 * seam(image));
  const int dx = static_cast<int>(std::ceil(kBlur.extent_px * std::cos(kBlur.angle_rad)));
  const int dy = static_cast<int>(std::ceil(kBlur.extent_px * std::sin(kBlur.angle_rad)));
  const cv::Rect inside(dx, dy, image.cols - 2 * dx, image.rows - 2 * dy);
  cv::Mat real;
  image.convertTo(real, CV_64F);
  EXPECT_EQ(cv::norm(tapered(inside), real(inside), cv::NORM_INF), 0);
}

TEST(Wiener, InSpaceBeatsFrequencyAtTheBorderAndMatchesItInside) {
  const Example example = make_example(kBlur);
  const int band = static_cast<int>(std::lround(1.5 * kBlur.extent_px));
  const cv::Rect inside(band, band, kSize.width - 2 * band, kSize.height - 2 * band);
  const cv::Mat space = deblur_in_space(example.blurred, kBlur);
  const cv::Mat frequency = as8(deblur_in_frequency(example.blurred, kBlur, kNoiseToSignalRatio, false));
  EXPECT_LT(rmse(space(inside), example.sharp(inside)), 1.05 * rmse(frequency(inside), example.sharp(inside)));
  const auto border_square = [&](const cv::Mat& image) {
    return std::pow(cv::norm(image, example.sharp, cv::NORM_L2), 2) -
           std::pow(cv::norm(image(inside), example.sharp(inside), cv::NORM_L2), 2);
  };
  EXPECT_LT(std::sqrt(border_square(space)), 0.8 * std::sqrt(border_square(frequency)));
  const cv::Mat tapered = as8(deblur_in_frequency(example.blurred, kBlur, kNoiseToSignalRatio, true));
  EXPECT_LT(border_square(tapered), border_square(frequency));
}

TEST(DeblurInSpace, IsBetterThanTheBlurredImageAndRefusesBadExtents) {
  const Example example = make_example(kBlur);
  EXPECT_GT(test::psnr_db(deblur_in_space(example.blurred, kBlur), example.sharp),
            test::psnr_db(example.blurred, example.sharp) + 1);
  EXPECT_THROW(deblur_in_space(example.blurred, {0, 0.5}), OptionError);
}

TEST(RestoreBeyondBorders, IsBetterThanWienerOnAPhotograph) {
  const std::string path = "/usr/share/doc/opencv-doc/examples/data/building.jpg";
  const cv::Mat photograph = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (photograph.empty()) GTEST_SKIP() << "no photograph at " << path;
  const cv::Rect middle(32, 32, photograph.cols - 64, photograph.rows - 64);
  const cv::Mat blurred =
      test::expose(test::blur_along_line(photograph, kBlur.angle_rad, kBlur.extent_px)(middle), 3, 1);
  // It gives the scene smoothed by output_sigma_px; the other is compared after the same smoothing.
  const auto smooth = [](const cv::Mat& image) {
    cv::Mat out;
    cv::GaussianBlur(image, out, cv::Size(), RestorationOptions().output_sigma_px);
    return out;
  };
  FilterOptions paper;  // the taps that it iterates, on another length
  paper.regularization = Regularization::PAPER;
  const cv::Mat truth = smooth(photograph(middle).clone());
  const cv::Mat wiener = smooth(deblur_in_space(blurred, kBlur, paper));
  const cv::Mat package = smooth(deblur_in_space(blurred, kBlur));
  const cv::Mat restored = restore_beyond_borders(blurred, kBlur);
  const int band = static_cast<int>(kBlur.extent_px);
  const cv::Rect inside(band, band, truth.cols - 2 * band, truth.rows - 2 * band);
  for (const cv::Rect& part :
       {cv::Rect(0, 0, band, truth.rows), cv::Rect(truth.cols - band, 0, band, truth.rows), inside}) {
    EXPECT_LT(rmse(restored(part), truth(part)), 0.95 * rmse(wiener(part), truth(part))) << part;
    EXPECT_LT(rmse(restored(part), truth(part)), rmse(package(part), truth(part))) << part;
  }
}

TEST(RestoreBeyondBorders, RefusesBadOptions) {
  const Example example = make_example(kBlur);
  RestorationOptions options;
  options.iterations = -1;
  EXPECT_THROW(restore_beyond_borders(example.blurred, kBlur, options), OptionError);
}

TEST(MotionAdaptedDog, IsSiftsDetectorWithoutMotion) {
  const cv::Mat scene = scene_of(kSize);
  const cv::Mat image1 = test::expose(scene, 3, 1), image2 = test::expose(scene, 3, 2);
  const auto sift1 = detect_dog(image1), own1 = detect_motion_adapted_dog(image1, {});
  const auto repeatability = [](const auto& keypoints1, const auto& keypoints2) {
    return evaluate_repeatability(keypoints1, kSize, keypoints2, kSize, Homography::eye(), 300, OverlapOptions());
  };
  // Which blobs pass depends on where the samples lie, and OpenCV's lie a quarter of a pixel off in x and y: the two
  // need not agree in each.
  const Repeatability sift = repeatability(sift1, detect_dog(image2));
  const Repeatability own = repeatability(own1, detect_motion_adapted_dog(image2, {}));
  const Repeatability each_other = repeatability(own1, sift1);
  EXPECT_GT(own.ratio, sift.ratio - 0.05);
  EXPECT_GT(each_other.ratio, 0.7);
  EXPECT_LT(each_other.error_px, 0.6);
}

TEST(MotionAdaptedDog, FindsASmearedBlobAtItsPlaceAndTrueScale) {
  // A Gaussian of the scale s, smeared over r: from sigma = r / sqrt(12) on, the adapted scale space is that of the
  // Gaussian without motion but for the box's shape.
  // The scale falls between the ends of an octave, where SIFT loses some blobs.
  constexpr double kScale = 22, kExtent = 40, kX = 201.3, kY = 178.9;
  cv::Mat blob(360, 400, CV_64F);
  for (int y = 0; y < blob.rows; ++y) {
    for (int x = 0; x < blob.cols; ++x) {
      blob.at<double>(y, x) = 40 + 180 * std::exp(-(std::pow(x - kX, 2) + std::pow(y - kY, 2)) / (2 * kScale * kScale));
    }
  }
  const LineBlur blur = {30 * CV_PI / 180, kExtent};
  const cv::Mat smeared = as8(test::blur_along_line(blob, blur.angle_rad, blur.extent_px));
  const auto at_rest = detect_motion_adapted_dog(as8(blob), {}), ordinary = detect_motion_adapted_dog(smeared, {}),
             adapted = detect_motion_adapted_dog(smeared, blur);
  ASSERT_FALSE(at_rest.empty() || ordinary.empty() || adapted.empty());
  EXPECT_NEAR(adapted[0].pt.x, kX, 0.5);
  EXPECT_NEAR(adapted[0].pt.y, kY, 0.5);
  EXPECT_NEAR(adapted[0].size, at_rest[0].size, 0.02 * at_rest[0].size);
  // The smeared blob's two scales are s and sqrt(s^2 + r^2 / 12), and SIFT reports about their geometric mean.
  const double longer = std::pow(1 + kExtent * kExtent / (12 * kScale * kScale), 0.25);
  EXPECT_NEAR(ordinary[0].size / at_rest[0].size, longer, 0.02);
  EXPECT_GT(adapted[0].response, ordinary[0].response);
}

}  // namespace
}  // namespace gyro_deblur::experiments
