// The float engine against the definition.
#include "engine/float/float_engine.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "base/parallel.hpp"
#include "engine/engine.hpp"
#include "filter_grids.hpp"
#include "images.hpp"
#include "inverse/filter_bank.hpp"
#include "naive_convolution.hpp"

namespace gyro_deblur::float_engine_test {
namespace {

using test::equal;
using test::random_image;

/// A grid of blocks, each with its own angle and extent; every seventh is only copied.
FilterGrid varied_blocks(int width, int height, int block_size, double max_extent, const FilterBank& bank) {
  return test::make_grid({width, height}, block_size, [&](int i) -> BlockFilter {
    const double extent = 2 + std::fmod(3.7 * i, max_extent - 2);
    return {std::fmod(23.0 * i, 180) * CV_PI / 180, i % 7 == 3 ? nullptr : &bank.kernel(extent)};
  });
}

struct EngineCase {
  int width, height, type, block_size;
  double max_extent;
};

class FloatEngineTest : public testing::TestWithParam<EngineCase> {};

TEST_P(FloatEngineTest, MatchesTheDefinition) {
  const EngineCase& c = GetParam();
  const FilterBank bank({});
  const cv::Mat src = random_image(c.width, c.height, c.type, 7);
  const FilterGrid blocks = varied_blocks(c.width, c.height, c.block_size, c.max_extent, bank);
  cv::Mat dst;
  make_engine("float", 2)->filter(src, blocks, dst);
  const test::ConvolutionError error = test::compare_with_naive(src, blocks, dst);
  // Rounding to the nearest integer, and float sums: 24 bit mantissa, sum of |taps| below 20.
  const double full_scale = src.depth() == CV_8U ? 255 : 65535;
  EXPECT_LE(error.alone, 0.5 + full_scale * 1e-5);
  // Means of rounded values are rounded again, once for neighbours and once for a copied block.
  EXPECT_LE(error.blended, 1.5 + full_scale * 1e-5);
  EXPECT_EQ(error.copied, 0);
}

INSTANTIATE_TEST_SUITE_P(Shapes, FloatEngineTest,
                         testing::Values(EngineCase{160, 120, CV_8UC1, 64, 30}, EngineCase{131, 97, CV_8UC1, 64, 40},
                                         EngineCase{131, 97, CV_16UC1, 32, 40}, EngineCase{70, 45, CV_8UC2, 16, 20},
                                         EngineCase{70, 45, CV_8UC3, 16, 20}, EngineCase{70, 45, CV_8UC4, 18, 20},
                                         EngineCase{33, 29, CV_16UC3, 8, 12}, EngineCase{33, 29, CV_16UC4, 8, 12},
                                         EngineCase{20, 300, CV_8UC1, 64, 60}, EngineCase{300, 3, CV_8UC1, 64, 60},
                                         EngineCase{5, 7, CV_8UC1, 64, 130}, EngineCase{1, 1, CV_8UC1, 64, 90},
                                         EngineCase{1, 50, CV_16UC1, 64, 30}, EngineCase{50, 1, CV_8UC3, 64, 30}));

TEST(FloatEngine, GivesTheSameForAnyNumberOfThreadsAndOnReuse) {
  const EagerHelpers eager_helpers;
  const FilterBank bank({});
  const cv::Mat src = random_image(200, 150, CV_8UC1, 3);
  const FilterGrid blocks = varied_blocks(200, 150, 32, 50, bank);
  cv::Mat one, two, again;
  make_engine("float", 1)->filter(src, blocks, one);
  const auto engine = make_engine("float", 2);
  engine->filter(src, blocks, two);
  EXPECT_TRUE(equal(one, two));
  // Buffers left from larger and smaller images must not show.
  cv::Mat other;
  engine->filter(random_image(400, 300, CV_8UC3, 4), varied_blocks(400, 300, 64, 90, bank), other);
  engine->filter(random_image(3, 3, CV_8UC1, 4), varied_blocks(3, 3, 64, 90, bank), other);
  engine->filter(src, blocks, again);
  EXPECT_TRUE(equal(one, again));
}

TEST(FloatEngine, WorksOnPartsOfLargerImages) {
  const FilterBank bank({});
  const cv::Mat whole = random_image(100, 80, CV_8UC1, 5);
  const cv::Mat src = whole(cv::Rect(11, 13, 70, 50));  // rows are not contiguous
  const FilterGrid blocks = varied_blocks(70, 50, 32, 20, bank);
  cv::Mat from_part, from_copy;
  make_engine("float")->filter(src, blocks, from_part);
  make_engine("float")->filter(src.clone(), blocks, from_copy);
  EXPECT_TRUE(equal(from_part, from_copy));
}

TEST(FloatEngine, KeepsAConstantImage) {
  const FilterBank bank({});
  const cv::Mat src(90, 100, CV_8UC1, cv::Scalar(173));
  cv::Mat dst;
  make_engine("float")->filter(src, varied_blocks(100, 90, 16, 100, bank), dst);
  EXPECT_TRUE(equal(src, dst));
}

TEST(FloatEngine, RefusesOtherTypes) {
  const auto engine = make_engine("float");
  cv::Mat dst;
  EXPECT_THROW(engine->filter(cv::Mat(4, 4, CV_32FC1, cv::Scalar(0)), {}, dst), std::invalid_argument);
  EXPECT_THROW(engine->filter(cv::Mat(), {}, dst), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur::float_engine_test
