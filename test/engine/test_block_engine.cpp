// What the base does for every engine.
#include "engine/block_engine.hpp"

#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "engine/engine.hpp"
#include "filter_grids.hpp"
#include "images.hpp"
#include "inverse/filter_bank.hpp"
#include "naive_convolution.hpp"

namespace gyro_deblur::block_engine_test {
namespace {

using test::equal;
using test::random_image;

TEST(Engine, RefusesGridsThatDoNotFit) {
  const cv::Mat src = random_image(20, 10, CV_8UC1, 1);
  const LineKernel kernel = wiener_kernel(5, {});
  const BlockFilter filter{0, &kernel};
  const FilterGrid wrong[] = {{},
                              {{0, 20}, {0, 10}, {}},
                              {{0, 20}, {0, 10}, {filter, filter}},
                              {{0, 19}, {0, 10}, {filter}},
                              {{0, 20}, {0, 11}, {filter}},
                              {{1, 20}, {0, 10}, {filter}},
                              {{0, 8, 8, 20}, {0, 10}, {filter, filter, filter}},
                              {{0, 12, 8, 20}, {0, 10}, {filter, filter, filter}}};
  for (const char* name : {"float", "cpu", "auto"}) {
    const auto engine = make_engine(name);
    cv::Mat dst;
    for (const FilterGrid& grid : wrong) EXPECT_THROW(engine->filter(src, grid, dst), std::invalid_argument) << name;
    EXPECT_NO_THROW(engine->filter(src, {{0, 8, 20}, {0, 10}, {filter, filter}}, dst));
  }
}

/// Gives every pixel of block i the value i + 1.
class NumberingEngine : public BlockEngine {
 public:
  explicit NumberingEngine(bool copies_itself) : BlockEngine(2), copies_itself_(copies_itself) {}
  std::string name() const override { return "numbering"; }

  std::vector<int> blocks;      // of the latest image
  cv::Mat untouched_by_itself;  // what is in dst after copy_untouched()

 protected:
  void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& filtered, SeamBlender& seams,
                     cv::Mat& dst) override {
    blocks = filtered;
    EXPECT_EQ(threads(), 2);
    EXPECT_EQ(dst.size(), src.size());
    if (copies_itself_) {
      copy_untouched(src, grid, dst);
      untouched_by_itself = dst.clone();
      // The base must not do it again: what is in a copied block now stays.
      for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
        if (grid.blocks[i].kernel == nullptr) dst(grid.rect(i)).setTo(77);
      }
    }
    for (const int block : filtered) {
      seams.store(block, cv::Mat(seams.reach(block).size(), CV_8UC1, cv::Scalar(block + 1)), dst);
    }
  }

 private:
  bool copies_itself_;
};

class BlockEngineTest : public testing::Test {
 protected:
  cv::Mat inner(const cv::Mat& image, int block) const {
    const cv::Rect rect = grid_.rect(block);
    return image(cv::Rect(rect.x + 4, rect.y + 4, rect.width - 8, rect.height - 8));
  }

  const LineKernel kernel_ = wiener_kernel(5, {});
  const cv::Mat src_ = random_image(96, 64, CV_8UC1, 4);
  const FilterGrid grid_ = test::make_grid(src_.size(), 32, [this](int i) -> BlockFilter {
    return {0.1 * i, i % 3 == 1 ? nullptr : &kernel_};  // 0 2 / 3 5
  });
};

TEST_F(BlockEngineTest, HasTheBlocksWithAKernelFilteredAndCopiesTheOthers) {
  NumberingEngine engine(false);
  cv::Mat dst;
  engine.filter(src_, grid_, dst);
  EXPECT_EQ(engine.blocks, (std::vector<int>{0, 2, 3, 5}));
  for (int i = 0; i < 6; ++i) {
    if (grid_.blocks[i].kernel == nullptr) {
      EXPECT_TRUE(equal(src_(grid_.rect(i)), dst(grid_.rect(i)))) << i;
    } else {
      EXPECT_EQ(cv::norm(inner(dst, i), inner(cv::Mat(src_.size(), CV_8UC1, cv::Scalar(i + 1)), i), cv::NORM_INF), 0);
    }
  }
}

TEST_F(BlockEngineTest, BlendsWhereBlocksMeet) {
  NumberingEngine engine(false);
  cv::Mat dst;
  engine.filter(src_, grid_, dst);
  for (int y = 0; y < src_.rows; ++y) {
    const test::AxisBlend down(grid_.y, y);
    for (int x = 0; x < src_.cols; ++x) {
      const test::AxisBlend across(grid_.x, x);
      const double input = src_.at<std::uint8_t>(y, x);
      ASSERT_EQ(dst.at<std::uint8_t>(y, x),
                test::blend_at(grid_, across, down, true, input, [](int block) { return block + 1.0; }))
          << x << ", " << y;
    }
  }
}

TEST_F(BlockEngineTest, LetsAnEngineCopyWhileItWaitsButOnlyOnce) {
  NumberingEngine engine(true);
  cv::Mat dst;
  for (int frame = 0; frame < 2; ++frame) {
    engine.filter(src_, grid_, dst);
    for (const int i : {1, 4}) {
      EXPECT_TRUE(equal(src_(grid_.rect(i)), engine.untouched_by_itself(grid_.rect(i)))) << i;
      EXPECT_EQ(cv::norm(inner(dst, i), inner(cv::Mat(src_.size(), CV_8UC1, cv::Scalar(77)), i), cv::NORM_INF), 0);
    }
  }
}

TEST_F(BlockEngineTest, IsCalledForFramesWithNothingToFilterToo) {
  NumberingEngine engine(false);
  engine.blocks = {9};
  cv::Mat dst;
  engine.filter(src_, {{0, 96}, {0, 64}, {{}}}, dst);
  EXPECT_TRUE(engine.blocks.empty());
  EXPECT_TRUE(equal(src_, dst));
  EXPECT_TRUE(engine.fallback_counts().empty()) << "one method for all";
}

}  // namespace
}  // namespace gyro_deblur::block_engine_test
