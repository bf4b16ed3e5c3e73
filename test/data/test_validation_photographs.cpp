// How well validation distinguishes predicted blur from none and from a third of it on the first images of the Oxford
// affine sets, of which nothing was tuned on.

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "blur/blur_likelihood.hpp"
#include "blur/image_noise.hpp"
#include "validation_scores.hpp"

namespace gyro_deblur {
namespace {

const char* const kSets[] = {"bark", "bikes", "boat", "graf", "leuven", "trees", "ubc", "wall"};

std::string image_path(const std::string& set) {
  return std::string(GYRO_DEBLUR_DATA_DIR) + "/oxford_affine/" + set + "/img1.png";
}

struct Bounds {
  double extent_px, sharp, third;
};

class ValidationPhotographs : public testing::TestWithParam<Bounds> {};

TEST_P(ValidationPhotographs, AreasUnderTheCurve) {
  if (!std::filesystem::exists(image_path(kSets[0]))) GTEST_SKIP() << "no data at " << image_path(kSets[0]);
  const Bounds& bounds = GetParam();
  cv::RNG rng(static_cast<std::uint64_t>(bounds.extent_px));
  std::vector<test::PredictedBlur> scenes;
  for (const char* set : kSets) {
    const cv::Mat photograph = cv::imread(image_path(set), cv::IMREAD_GRAYSCALE);
    ASSERT_FALSE(photograph.empty()) << set;
    scenes.push_back(test::predict_blur(photograph, rng.uniform(0.0, CV_PI), bounds.extent_px));
  }
  std::uint64_t seed = 0;
  for (const double contrast : {1.0, 0.35}) {
    for (const double noise : {1.0, 4.0, 8.0}) {
      std::array<std::vector<double>, 3> scores;
      for (const test::PredictedBlur& scene : scenes) {
        const cv::Mat* const truths[] = {&scene.blurred, &scene.sharp, &scene.third};
        for (std::size_t t = 0; t < scores.size(); ++t) {
          const cv::Mat image = test::expose(*truths[t], {noise, contrast}, ++seed);
          const std::vector<double> of_image = with_neighbours(
              scene.field.grid,
              log_ratios(scene.field, BlurLikelihood(image, image_noise(image, PixelLayout::GRAY).value_or(0))));
          scores[t].insert(scores[t].end(), of_image.begin(), of_image.end());
        }
      }
      const double sharp = test::area_under_roc(scores[0], scores[1]),
                   third = test::area_under_roc(scores[0], scores[2]);
      std::printf("%2.0f px, contrast %.2f, noise %.0f: %.4f against sharp, %.4f against a third\n", bounds.extent_px,
                  contrast, noise, sharp, third);
      EXPECT_GE(sharp, bounds.sharp) << "contrast " << contrast << ", noise " << noise;
      EXPECT_GE(third, bounds.third) << "contrast " << contrast << ", noise " << noise;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Extents, ValidationPhotographs,
                         testing::Values(Bounds{5, .985, .985}, Bounds{10, .999, .999}, Bounds{20, .999, .999},
                                         Bounds{40, .998, .998}));

}  // namespace
}  // namespace gyro_deblur
