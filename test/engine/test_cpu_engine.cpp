// The fast CPU engine against the float engine, for every instruction set that this processor runs.
#include "engine/cpu/cpu_engine.hpp"

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "base/parallel.hpp"
#include "blur/path_1d.hpp"
#include "compiled_sets.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::cpu_engine_test {
namespace {

double psnr_db(double mean_square, double full_scale = 255) {
  return 10 * std::log10(full_scale * full_scale / mean_square);
}

double mean_square(const cv::Mat& a, const cv::Mat& b) {
  const double norm = cv::norm(a, b, cv::NORM_L2);
  return norm * norm / (static_cast<double>(a.total()) * a.channels());
}

BlurFieldOptions wide_options() {
  BlurFieldOptions options;
  options.min_extent_px = 1;
  options.max_extent_px = 500;
  return options;
}

/// A field like that of a camera that rolls: angle and extent differ from block to block.
FrameBlur roll_field(int width_px, int height_px, double mean_extent_px) {
  FrameBlur field;
  field.grid = BlockGrid(width_px, height_px, 64);
  double mean_radius = 0;
  for (int i = 0; i < field.grid.size(); ++i) {
    mean_radius += (field.grid.center(i) - Eigen::Vector2d(width_px / 3.0, height_px / 3.0)).norm();
  }
  const double rotation_rad = mean_extent_px * field.grid.size() / mean_radius;
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d r = field.grid.center(i) - Eigen::Vector2d(width_px / 3.0, height_px / 3.0);
    field.blocks.push_back(classify_blur(-rotation_rad * r.y(), rotation_rad * r.x(), wide_options()));
  }
  return field;
}

class CpuEngineTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    kernels_ = find_for_cpu<BlockSimd>(GetParam());
    if (kernels_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
  }

  /// Float and fast result for one image and field.
  void run(const cv::Mat& image, PixelLayout layout, const FrameBlur& field, cv::Mat& expected, cv::Mat& actual) {
    FloatEngine in_float(2);
    CpuEngine fast(2, *kernels_);
    deconvolve(image, layout, field, *bank_, in_float, expected);
    deconvolve(image, layout, field, *bank_, fast, actual);
  }

  const BlockSimd* kernels_ = nullptr;
  std::unique_ptr<FilterBank> bank_ = std::make_unique<FilterBank>(FilterOptions{});
};

// Short kernels are exact but for the rounding of their weights to int16.
TEST_P(CpuEngineTest, ShortKernelsDifferByRoundingAlone) {
  const cv::Mat sharp = test::textured_image(230, 170, 1);
  for (const double extent_px : {2.0, 5.0, 11.3, 20.0, 29.8}) {
    // Weights of 12 bits, or of 7 where bytes are faster and do no harm.
    const bool bytes = kernels_->has_byte_weights && extent_px > 6;
    const double least_db = bytes ? 55 : 60;
    const int most_levels = bytes ? 3 : 1;
    double pooled = 0;
    int angles = 0;
    for (int degrees = 0; degrees < 180; degrees += 13, ++angles) {
      const double angle_rad = degrees * CV_PI / 180;
      const cv::Mat blurred = test::expose(test::blur_along_line(sharp, angle_rad, extent_px), 1, degrees);
      const FrameBlur field = uniform_blur_field(230, 170, angle_rad, extent_px, wide_options());
      cv::Mat expected, actual;
      run(blurred, PixelLayout::GRAY, field, expected, actual);
      EXPECT_LE(cv::norm(expected, actual, cv::NORM_INF), most_levels) << extent_px << " px, " << degrees << " deg";
      pooled += mean_square(expected, actual);
    }
    EXPECT_GE(psnr_db(pooled / angles), least_db) << extent_px << " px";
  }
}

TEST_P(CpuEngineTest, LongKernelsStayCloseAndRestoreAsWell) {
  const cv::Mat sharp = test::textured_image(256, 192, 2);
  for (const double extent_px : {30.0, 45.0, 70.0, 90.0, 130.0}) {
    double pooled = 0;
    int angles = 0;
    for (int degrees = 0; degrees < 180; degrees += 15, ++angles) {
      const double angle_rad = degrees * CV_PI / 180;
      const cv::Mat blurred = test::expose(test::blur_along_line(sharp, angle_rad, extent_px), 1, degrees);
      const FrameBlur field = uniform_blur_field(256, 192, angle_rad, extent_px, wide_options());
      cv::Mat expected, actual;
      run(blurred, PixelLayout::GRAY, field, expected, actual);
      pooled += mean_square(expected, actual);
      const double loss_db = psnr_db(mean_square(expected, sharp)) - psnr_db(mean_square(actual, sharp));
      EXPECT_LE(loss_db, 0.1) << extent_px << " px, " << degrees << " deg";
    }
    EXPECT_GE(psnr_db(pooled / angles), 45) << extent_px << " px";
  }
}

// Kernels of no known shape, along lines of any direction; only short ones in 16 bit near an axis are left to the
// float engine.
TEST_P(CpuEngineTest, LongNonuniformPathsStayCloseAndRestoreAsWell) {
  const Path1d paths[] = {{-0.29f, -0.245f, -0.18f, -0.1f, 0, 0.125f, 0.275f, 0.45f, 0.71f},  // speeds up
                          {0.9f, 0.7f, 0.5f, 0.25f, 0, -0.05f, -0.1f, -0.05f, 0}};            // reverses
  const cv::Mat sharp = test::textured_image(256, 192, 2);
  for (const Path1d& path : paths) {
    for (const double extent_px : {40.0, 50.0, 66.0, 105.0}) {
      Path1d path_px = path;
      for (float& place_px : path_px) place_px *= static_cast<float>(extent_px / extent_of(path));
      double pooled = 0;
      int angles = 0;
      for (const int degrees : {0, 2, 5, 45, 85, 88, 121, 176}) {
        const double angle_rad = degrees * CV_PI / 180;
        const cv::Mat blurred = test::expose(test::blur_along_path(sharp, angle_rad, path_px), 1, degrees);
        FrameBlur field = uniform_blur_field(256, 192, angle_rad, extent_px, wide_options());
        for (BlockBlur& block : field.blocks) block.nonuniform_path_px = path_px;
        cv::Mat expected, actual;
        run(blurred, PixelLayout::GRAY, field, expected, actual);
        const double error = mean_square(expected, actual);
        EXPECT_GE(psnr_db(error), 42) << extent_px << " px, " << degrees << " deg";
        const double loss_db = psnr_db(mean_square(expected, sharp)) - psnr_db(mean_square(actual, sharp));
        EXPECT_LE(loss_db, 0.1) << extent_px << " px, " << degrees << " deg";
        pooled += error;
        ++angles;

        CpuEngine fast(2, *kernels_);
        cv::Mat deep, of_deep;
        blurred.convertTo(deep, CV_16U, 257);
        const bool near_axis = degrees == 5 || degrees == 85 || degrees == 176;
        EXPECT_EQ(deconvolve(deep, PixelLayout::GRAY, field, *bank_, fast, of_deep).empty(),
                  !near_axis || extent_px > 57);
        of_deep.convertTo(of_deep, CV_8U, 1 / 257.0);
        const double deep_loss_db = psnr_db(mean_square(expected, sharp)) - psnr_db(mean_square(of_deep, sharp));
        EXPECT_LE(deep_loss_db, 0.1) << extent_px << " px, " << degrees << " deg, 16 bit";
        EXPECT_GE(psnr_db(mean_square(expected, of_deep)), 42) << extent_px << " px, " << degrees << " deg, 16 bit";
        EXPECT_EQ(deconvolve(blurred, PixelLayout::GRAY, field, *bank_, fast, actual), FallbackCounts{});
      }
      EXPECT_GE(psnr_db(pooled / angles), 45) << extent_px << " px";
    }
  }
}

// Where sheared columns lie between pixels over long stretches.
TEST_P(CpuEngineTest, StaysCloseNearAnAxis) {
  const cv::Mat sharp = test::textured_image(256, 256, 2);
  for (const double extent_px : {36.0, 45.0, 58.0, 66.0, 75.0, 90.0, 110.0}) {
    for (const int degrees : {2, 5, 9, 80, 85, 88, 91, 93, 98, 101, 176, 179}) {
      const double angle_rad = degrees * CV_PI / 180;
      const cv::Mat blurred = test::expose(test::blur_along_line(sharp, angle_rad, extent_px), 1, degrees);
      const FrameBlur field = uniform_blur_field(256, 256, angle_rad, extent_px, wide_options());
      cv::Mat expected, actual;
      run(blurred, PixelLayout::GRAY, field, expected, actual);
      EXPECT_GE(psnr_db(mean_square(expected, actual)), 42) << extent_px << " px, " << degrees << " deg";
      const double loss_db = psnr_db(mean_square(expected, sharp)) - psnr_db(mean_square(actual, sharp));
      EXPECT_LE(loss_db, 0.1) << extent_px << " px, " << degrees << " deg";
    }
  }
}

// Box and rest nearly cancel where the noise-to-signal ratio is small; whatever the engine does about it must not show.
TEST_P(CpuEngineTest, FollowsTheFloatEngineAtAnyNoiseToSignalRatio) {
  const cv::Mat sharp = test::textured_image(200, 150, 7);
  for (const double ratio : {1e-5, 1e-3, 5e-3, 0.008, 0.1, 1.0}) {
    bank_ = std::make_unique<FilterBank>(FilterOptions{ratio, ratio < 0.05 ? 4.0 : 8.0});
    for (const double extent_px : {12.0, 35.5, 40.0, 90.0}) {
      const cv::Mat blurred = test::expose(test::blur_along_line(sharp, 0.3, extent_px), 1, 11);
      cv::Mat expected, actual;
      run(blurred, PixelLayout::GRAY, uniform_blur_field(200, 150, 0.3, extent_px, wide_options()), expected, actual);
      EXPECT_GE(psnr_db(mean_square(expected, actual) + 1e-9), 44) << "ratio " << ratio << ", " << extent_px << " px";
    }
  }
}

TEST_P(CpuEngineTest, FollowsTheFloatEngineWithAnyRegularization) {
  const cv::Mat sharp = test::textured_image(200, 150, 8);
  for (const Regularization rule : {Regularization::FIXED, Regularization::PAPER}) {
    FilterOptions options;
    options.regularization = rule;
    bank_ = std::make_unique<FilterBank>(options);
    for (const double extent_px : {12.0, 40.0, 90.0}) {
      const cv::Mat blurred = test::expose(test::blur_along_line(sharp, 0.3, extent_px), 1, 11);
      cv::Mat expected, actual;
      run(blurred, PixelLayout::GRAY, uniform_blur_field(200, 150, 0.3, extent_px, wide_options()), expected, actual);
      EXPECT_GE(psnr_db(mean_square(expected, actual) + 1e-9), 44)
          << static_cast<int>(rule) << ", " << extent_px << " px";
    }
  }
}

TEST_P(CpuEngineTest, TakesEverySizeTypeAndBorder) {
  struct Case {
    int width, height;
    PixelLayout layout;
    bool deep;
  };
  const Case cases[] = {{1, 1, PixelLayout::GRAY, false},   {1, 90, PixelLayout::GRAY, false},
                        {90, 1, PixelLayout::GRAY, true},   {5, 7, PixelLayout::GRAY, false},
                        {63, 65, PixelLayout::GRAY, true},  {131, 197, PixelLayout::BGR, false},
                        {131, 97, PixelLayout::RGBA, true}, {129, 64, PixelLayout::BAYER_RGGB, false}};
  for (const Case& c : cases) {
    for (const double extent_px : {8.0, 35.0, 110.0, 400.0}) {
      cv::Mat image =
          test::textured_image(std::max(c.width, 16), std::max(c.height, 16), 3)(cv::Rect(0, 0, c.width, c.height))
              .clone();
      if (channels_of(c.layout) > 1) {
        const std::vector<cv::Mat> planes(channels_of(c.layout), image);
        cv::merge(planes, image);
      }
      if (c.deep) image.convertTo(image, CV_16U, 257);
      cv::Mat expected, actual;
      run(image, c.layout, roll_field(c.width, c.height, extent_px), expected, actual);
      ASSERT_EQ(actual.size(), image.size());
      ASSERT_EQ(actual.type(), image.type());
      // A sharp image filtered for a long blur is nearly all overshoot, which the two scales follow less closely.
      const double full_scale = c.deep ? 65535 : 255;
      EXPECT_GE(psnr_db(mean_square(expected, actual) + 1e-9, full_scale), 32)
          << c.width << "x" << c.height << " " << static_cast<int>(c.layout) << " " << extent_px << " px";
    }
  }
}

TEST_P(CpuEngineTest, KeepsAConstantImageAndCopiesBlocksWithoutKernel) {
  const cv::Mat constant(150, 200, CV_8UC1, cv::Scalar(117));
  FrameBlur field = roll_field(200, 150, 80);
  cv::Mat expected, actual;
  run(constant, PixelLayout::GRAY, field, expected, actual);
  EXPECT_EQ(cv::norm(constant, actual, cv::NORM_INF), 0);

  const cv::Mat image = test::textured_image(200, 150, 4);
  field.blocks[1].status = BlockStatus::REJECTED;
  field.blocks[2].status = BlockStatus::NO_GYRO;
  run(image, PixelLayout::GRAY, field, expected, actual);
  for (const int block : {1, 2}) {
    EXPECT_EQ(cv::norm(image(field.grid.rect(block)), actual(field.grid.rect(block)), cv::NORM_INF), 0);
  }
  EXPECT_GT(cv::norm(image(field.grid.rect(0)), actual(field.grid.rect(0)), cv::NORM_INF), 0);
}

TEST_P(CpuEngineTest, GivesTheSameForAnyNumberOfThreadsAndOnReuse) {
  const EagerHelpers eager_helpers;
  const cv::Mat image = test::textured_image(210, 140, 5);
  CpuEngine one(1, *kernels_), two(2, *kernels_);
  cv::Mat a, b, again;
  deconvolve(image, PixelLayout::GRAY, roll_field(210, 140, 60), *bank_, one, a);
  deconvolve(image, PixelLayout::GRAY, roll_field(210, 140, 60), *bank_, two, b);
  cv::Mat other;
  deconvolve(image, PixelLayout::GRAY, roll_field(210, 140, 12), *bank_, two, other);
  deconvolve(image, PixelLayout::GRAY, roll_field(210, 140, 60), *bank_, two, again);
  EXPECT_EQ(cv::norm(a, b, cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(a, again, cv::NORM_INF), 0);
}

// Kernels of unknown shape have no box to take out.
TEST_P(CpuEngineTest, FiltersKernelsOfAnyShape) {
  LineKernel lopsided;
  lopsided.taps.assign(81, 0.0f);
  for (int i = 0; i < 81; ++i) lopsided.taps[i] = static_cast<float>(i) / 3240;
  const cv::Mat image = test::textured_image(160, 120, 6);
  for (const int depth : {CV_8U, CV_16U}) {
    cv::Mat src;
    image.convertTo(src, depth, depth == CV_8U ? 1 : 257);
    const FilterGrid blocks = {
        {0, 80, 160}, {0, 50, 120}, {{2.5, &lopsided}, {2.5, &lopsided}, {0.7, nullptr}, {0.7, &lopsided}}};
    cv::Mat expected, actual;
    FloatEngine(2).filter(src, blocks, expected);
    CpuEngine(2, *kernels_).filter(src, blocks, actual);
    EXPECT_LE(cv::norm(expected, actual, cv::NORM_INF), 1);
  }
}

TEST_P(CpuEngineTest, RefusesOtherTypes) {
  CpuEngine fast(1, *kernels_);
  cv::Mat dst;
  EXPECT_THROW(fast.filter(cv::Mat(8, 8, CV_32FC1), {}, dst), std::invalid_argument);
  EXPECT_THROW(fast.filter(cv::Mat(), {}, dst), std::invalid_argument);
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, CpuEngineTest, testing::ValuesIn(test::kInstructionSets));

}  // namespace
}  // namespace gyro_deblur::cpu_engine_test
