// How much of a photograph exact blur and its inverse give back: the first images of the Oxford affine sets.

#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "blur/blur_validation.hpp"
#include "blur/image_noise.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "run_program.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur {
namespace {

const char* const kSets[] = {"bark", "bikes", "boat", "graf", "leuven", "trees", "ubc", "wall"};
constexpr double kExtentsPx[] = {10, 20, 30, 40};
constexpr double kAnglesDeg[] = {0, 30, 75, 110, 150};
constexpr double kNoiseGreyLevels = 2;
// The blurred image is cut out of a larger one, so that its border holds real light from outside.
constexpr int kMarginPx = 32;

std::string image_path(const std::string& set) {
  return std::string(GYRO_DEBLUR_DATA_DIR) + "/oxford_affine/" + set + "/img1.png";
}

struct Example {
  cv::Mat sharp, blurred;
};

Example make_example(const cv::Mat& photograph, double angle_deg, double extent_px, std::uint64_t seed) {
  const cv::Rect inner(kMarginPx, kMarginPx, photograph.cols - 2 * kMarginPx, photograph.rows - 2 * kMarginPx);
  const cv::Mat blurred = test::blur_along_line(photograph, angle_deg * CV_PI / 180, extent_px);
  return {photograph(inner).clone(), test::expose(blurred(inner), kNoiseGreyLevels, seed)};
}

/// PSNR gains [dB]; the border is what lies nearer to the edge than the extent.
struct Gain {
  double whole = 0, interior = 0, border = 0;

  Gain& operator+=(const Gain& other) {
    whole += other.whole;
    interior += other.interior;
    border += other.border;
    return *this;
  }
};

Gain gain_of(const Example& example, const cv::Mat& deblurred, double extent_px) {
  const int border = static_cast<int>(std::lround(extent_px));
  const cv::Rect inside(border, border, deblurred.cols - 2 * border, deblurred.rows - 2 * border);
  const auto squares = [&](const cv::Mat& image) {
    cv::Mat d;
    cv::subtract(image, example.sharp, d, cv::noArray(), CV_64F);
    return std::array<double, 2>{d.dot(d), d(inside).dot(d(inside))};
  };
  const auto before = squares(example.blurred), after = squares(deblurred);
  return {10 * std::log10(before[0] / after[0]), 10 * std::log10(before[1] / after[1]),
          10 * std::log10((before[0] - before[1]) / (after[0] - after[1]))};
}

TEST(OxfordNoise, IsEstimatedOnBlurredPhotographs) {
  if (!std::filesystem::exists(image_path(kSets[0]))) GTEST_SKIP() << "no data at " << image_path(kSets[0]);
  for (const char* set : kSets) {
    const cv::Mat photograph = cv::imread(image_path(set), cv::IMREAD_GRAYSCALE);
    ASSERT_FALSE(photograph.empty()) << image_path(set);
    const cv::Mat blurred = test::blur_along_line(photograph, 0.5, 15);
    for (const double noise : {0.5, 1.0, 2.0, 4.0, 8.0, 12.0}) {
      const double truth = std::hypot(noise, 1 / std::sqrt(12.0));  // and rounding
      EXPECT_NEAR(image_noise(test::expose(blurred, noise, 7), PixelLayout::GRAY).value_or(0) / truth, 1, 0.15)
          << set << ", noise " << noise;
    }
  }
}

TEST(OxfordPsnr, GainsThreeDecibels) {
  if (!std::filesystem::exists(image_path(kSets[0]))) GTEST_SKIP() << "no data at " << image_path(kSets[0]);
  const FilterBank bank({});
  const auto engine = make_engine("auto");  // as deblur_image does
  const auto print = [](const char* name, const Gain& sum, double count) {
    std::printf("%-10s %8.2f %8.2f %8.2f\n", name, sum.whole / count, sum.interior / count, sum.border / count);
  };
  std::printf("PSNR gain [dB]: noise %g grey levels, mean over angles\n%-10s %8s %8s %8s\n", kNoiseGreyLevels, "",
              "whole", "interior", "border");

  Gain total;
  std::array<Gain, std::size(kExtentsPx)> by_extent;
  int count = 0;
  for (const char* set : kSets) {
    const cv::Mat photograph = cv::imread(image_path(set), cv::IMREAD_GRAYSCALE);
    ASSERT_FALSE(photograph.empty()) << set;
    Gain of_set;
    for (std::size_t e = 0; e < std::size(kExtentsPx); ++e) {
      for (const double angle_deg : kAnglesDeg) {
        const Example example = make_example(photograph, angle_deg, kExtentsPx[e], ++count);
        // The steps of deblur_image with its defaults.
        FrameBlur field =
            uniform_blur_field(example.blurred.cols, example.blurred.rows, angle_deg * CV_PI / 180, kExtentsPx[e], {});
        field = validate_blur_field(field, example.blurred, {});
        cv::Mat deblurred;
        deconvolve(example.blurred, PixelLayout::GRAY, field, bank, *engine, deblurred);
        const Gain gain = gain_of(example, deblurred, kExtentsPx[e]);
        of_set += gain;
        by_extent[e] += gain;
        total += gain;
      }
    }
    print(set, of_set, std::size(kExtentsPx) * std::size(kAnglesDeg));
  }
  for (std::size_t e = 0; e < std::size(kExtentsPx); ++e) {
    print((std::to_string(static_cast<int>(kExtentsPx[e])) + " px").c_str(), by_extent[e],
          std::size(kSets) * std::size(kAnglesDeg));
  }
  print("mean", total, count);
  EXPECT_GE(total.whole / count, 3.0);
  EXPECT_GE(total.interior / count, 3.0);
  EXPECT_GT(total.border / count, 0.0) << "borders must not get worse";
}

TEST(OxfordPsnr, DeblurImageGivesTheSame) {
  if (!std::filesystem::exists(image_path("graf"))) GTEST_SKIP() << "no data at " << image_path("graf");
  const std::string folder = testing::TempDir();
  for (const int mode : {cv::IMREAD_GRAYSCALE, cv::IMREAD_COLOR}) {
    const cv::Mat photograph = cv::imread(image_path("graf"), mode);
    std::vector<cv::Mat> planes, sharp, blurred;
    cv::split(photograph, planes);
    for (const cv::Mat& plane : planes) {
      const Example example = make_example(plane, 30, 27, 1);
      sharp.push_back(example.sharp);
      blurred.push_back(example.blurred);
    }
    cv::Mat in, expected;
    cv::merge(blurred, in);
    ASSERT_TRUE(cv::imwrite(folder + "graf_blurred.png", in));
    const test::ProgramResult result =
        test::run_program({DEBLUR_IMAGE, folder + "graf_blurred.png", folder + "graf_deblurred.png", "--angle-deg",
                           "30", "--extent-px", "27", "--json", folder + "graf.json"});
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const cv::Mat deblurred = cv::imread(folder + "graf_deblurred.png", cv::IMREAD_UNCHANGED);
    ASSERT_EQ(deblurred.type(), in.type());

    const PixelLayout layout = in.channels() == 1 ? PixelLayout::GRAY : PixelLayout::BGR;
    FrameBlur field = uniform_blur_field(in.cols, in.rows, 30 * CV_PI / 180, 27, {});
    field = validate_blur_field(field, luminance8(in, layout), {});
    deconvolve(in, layout, field, FilterBank({}), *make_engine("auto"), expected);
    EXPECT_EQ(cv::norm(deblurred, expected, cv::NORM_INF), 0);

    std::vector<cv::Mat> restored;
    cv::split(deblurred, restored);
    for (std::size_t c = 0; c < restored.size(); ++c) {
      EXPECT_GE(test::psnr_db(restored[c], sharp[c]) - test::psnr_db(blurred[c], sharp[c]), 3.0) << "channel " << c;
    }
  }
}

}  // namespace
}  // namespace gyro_deblur
