// Blocks filtered with the inverse of their whole path.
#include "engine/fourier_filter.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "base/parallel.hpp"
#include "blur/path_2d.hpp"
#include "compiled_sets.hpp"
#include "engine/engine.hpp"
#include "filter_grids.hpp"
#include "images.hpp"
#include "inverse/filter_bank.hpp"
#include "naive_fourier_filter.hpp"
#include "paths_2d.hpp"
#include "roll_scene.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::fourier_filter_test {
namespace {

using test::equal;

/// All blocks of a grid, on its own.
cv::Mat filtered(const cv::Mat& src, const FilterGrid& grid, FourierFilter& filter, int threads = 1) {
  cv::Mat dst(src.size(), src.type());
  SeamBlender seams;
  seams.plan(grid, src.type());
  std::vector<int> blocks;
  for (int i = 0; i < grid.cols() * grid.rows(); ++i) blocks.push_back(i);
  filter.filter(src, grid, blocks, threads, seams, dst);
  return dst;
}

/// The exact result, by channel.
std::vector<cv::Mat> exact_result(const cv::Mat& src, const FilterGrid& grid) {
  std::vector<cv::Mat> exact;
  for (int channel = 0; channel < src.channels(); ++channel) {
    exact.push_back(test::naive_fourier_filter(src, channel, grid));
  }
  return exact;
}

/// Largest difference from the exact result, clipped, in `within`.
double worst_error(const std::vector<cv::Mat>& exact, const cv::Mat& dst, const cv::Rect& within) {
  const double max = dst.depth() == CV_8U ? 255 : 65535;
  double worst = 0;
  for (int channel = 0; channel < dst.channels(); ++channel) {
    for (int y = within.y; y < within.br().y; ++y) {
      for (int x = within.x; x < within.br().x; ++x) {
        const double clipped = std::clamp(exact[channel].at<double>(y, x), 0.0, max);
        worst = std::max(worst, std::abs(test::pixel_at(dst, x, y, channel) - clipped));
      }
    }
  }
  return worst;
}

class FourierFilterTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<FourierSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
  }

  const FourierSimd* simd_ = nullptr;
};

TEST_P(FourierFilterTest, IsWhatTheDefinitionSays) {
  struct Case {
    std::vector<int> x, y;
    int type;
    double extent_px;
  };
  // Usual blocks; small ones; narrow ones among wide ones; blocks that are cut; single pixels; paths longer than the
  // image.
  const Case cases[] = {{{0, 64, 128, 150}, {0, 64, 129}, CV_8UC1, 14},
                        {{0, 64, 97}, {0, 63}, CV_16UC1, 25},
                        {{0, 16, 32, 41}, {0, 16, 30}, CV_8UC3, 9},
                        {{0, 20, 21, 60, 62}, {0, 3, 40}, CV_8UC1, 7},
                        {{0, 33, 190}, {0, 70}, CV_16UC4, 11},
                        {{0, 1}, {0, 1}, CV_8UC1, 5},
                        {{0, 1, 2, 3}, {0, 5}, CV_8UC2, 3},
                        {{0, 40}, {0, 30}, CV_8UC1, 90},
                        {{0, 1}, {0, 70}, CV_8UC1, 12}};
  FourierFilter filter(*simd_);  // one for all: it keeps its memory
  for (const Case& c : cases) {
    FilterGrid grid{c.x, c.y, {}};
    std::vector<WienerInverse2d> inverses(grid.cols() * grid.rows());
    for (std::size_t i = 0; i < inverses.size(); ++i) {
      const double extent_px = c.extent_px * (1 + 0.2 * static_cast<double>(i % 3));
      inverses[i] = {test::arc_path(extent_px, 0.2 * extent_px, 0.9 * static_cast<double>(i)), 0.01f, 0.5f};
      grid.blocks.push_back({0, nullptr, &inverses[i]});
    }
    const cv::Mat src = test::random_image(c.x.back(), c.y.back(), c.type, 5);
    // Half a step for rounding; the filter gives back 5 times what noise there is at most, floats hold 6e-8 of it, and
    // the gain is right to a thousandth of the largest (WienerGain2dTest).
    const double allowed = src.depth() == CV_8U ? 0.6 : 0.5 + 0.1 * 256;
    EXPECT_LT(worst_error(exact_result(src, grid), filtered(src, grid, filter), cv::Rect({}, src.size())), allowed)
        << src.cols << "x" << src.rows << ", type " << c.type << ", " << c.extent_px << " px";
  }
}

// Blocks at the whole and at half the size next to each other and to copied ones, which the definition mixes.
TEST_P(FourierFilterTest, MixesSizesAsTheDefinitionSays) {
  const WienerInverse2d brief{test::arc_path(12, 3, 0.3), 0.01f, 0.1f}, lengthy{test::arc_path(60, 9, 1.2), 0.1f, 1};
  ASSERT_NE(test::is_at_half_size(brief), test::is_at_half_size(lengthy));
  FourierFilter filter(*simd_);
  for (const auto& [size, block_px, type] :
       {std::tuple(cv::Size(200, 131), 64, CV_8UC1), std::tuple(cv::Size(101, 75), 24, CV_8UC3),
        std::tuple(cv::Size(61, 45), 16, CV_16UC1), std::tuple(cv::Size(47, 33), 9, CV_8UC1)}) {
    const cv::Mat src = test::random_image(size.width, size.height, type, 5);
    const FilterGrid grid = test::make_grid(size, block_px, [&](int i) -> BlockFilter {
      if (i % 5 == 4) return {};
      return {0, nullptr, i % 5 == 1 || i % 5 == 2 ? &lengthy : &brief};
    });
    std::vector<int> blocks;
    for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
      if (!grid.blocks[i].copies()) blocks.push_back(i);
    }
    cv::Mat dst(src.size(), src.type());
    SeamBlender seams;
    seams.plan(grid, src.type());
    filter.filter(src, grid, blocks, 2, seams, dst);
    const std::vector<cv::Mat> exact = exact_result(src, grid);
    const double allowed = src.depth() == CV_8U ? 0.6 : 0.5 + 0.1 * 256;
    for (const int i : blocks) {
      // Without the margins, in which results wait for their neighbours.
      const cv::Rect rect = grid.rect(i);
      const int margin_x = std::min(4, rect.width / 2), margin_y = std::min(4, rect.height / 2);
      const cv::Rect inner(rect.x + margin_x, rect.y + margin_y, rect.width - 2 * margin_x, rect.height - 2 * margin_y);
      EXPECT_LT(worst_error(exact, dst, inner), allowed) << size << ", " << block_px << " px, block " << i;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, FourierFilterTest, testing::ValuesIn(test::kInstructionSets));

TEST(FourierFilter, DoesNotDependOnThreads) {
  const EagerHelpers eager_helpers;
  const cv::Mat src = test::textured_image(300, 260, 2);
  const WienerInverse2d inverse{test::arc_path(20, 4, 0.4), 0.01f, 0};
  const FilterGrid grid = test::make_grid(src.size(), 32, [&](int) { return BlockFilter{0, nullptr, &inverse}; });
  FourierFilter filter;
  const cv::Mat alone = filtered(src, grid, filter, 1);
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(equal(filtered(src, grid, filter, 4), alone));
}

TEST(FourierFilter, KeepsAConstantImage) {
  const WienerInverse2d inverse{test::arc_path(30, 8, 1), 0.02f, 3};
  FourierFilter filter;
  for (const int type : {CV_8UC1, CV_16UC3}) {
    const cv::Mat src(150, 200, type, cv::Scalar::all(type == CV_8UC1 ? 251 : 60001));
    const FilterGrid grid = test::make_grid(src.size(), 64, [&](int) { return BlockFilter{0, nullptr, &inverse}; });
    EXPECT_TRUE(equal(filtered(src, grid, filter), src)) << type;
  }
}

// Blocks with an inverse, with a kernel and without either next to each other.
TEST(FourierFilter, SharesAnImageWithOtherFilters) {
  const cv::Mat src = test::textured_image(320, 256, 6);
  const FilterBank bank({});
  const WienerInverse2d inverse{test::arc_path(15, 3, 0.3), 0.01f, 0.1f};
  FilterGrid grid = test::make_grid(src.size(), 64, [&](int i) -> BlockFilter {
    if (i % 5 == 2) return {0.3, &bank.kernel(15)};
    return i % 5 == 4 ? BlockFilter{} : BlockFilter{0, nullptr, &inverse};
  });
  const std::vector<cv::Mat> exact = exact_result(src, grid);
  for (const char* name : {"cpu", "float", "opencl"}) {
    cv::Mat dst, lines_only;
    const auto engine = make_engine(name, 2);
    engine->filter(src, grid, dst);
    FilterGrid lines = grid;
    for (BlockFilter& block : lines.blocks) block.inverse = nullptr;
    engine->filter(src, lines, lines_only);
    for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
      const cv::Rect rect = grid.rect(i), inner(rect.x + 4, rect.y + 4, rect.width - 8, rect.height - 8);
      if (grid.blocks[i].copies()) {
        EXPECT_TRUE(equal(dst(rect), src(rect))) << name << ", " << i;
      } else if (grid.blocks[i].kernel != nullptr) {
        EXPECT_TRUE(equal(dst(inner), lines_only(inner))) << name << ", " << i;
      } else {
        EXPECT_LT(worst_error(exact, dst, inner), 0.6) << name << ", " << i;
      }
    }
  }
}

// Few blocks, at the whole and at half the size, after an image that was all filtered: memory that is kept shows
// nowhere.
TEST(FourierFilter, KeepsNothingOfFormerImages) {
  const cv::Mat former(256, 320, CV_8UC1, cv::Scalar(255)), src = test::textured_image(320, 256, 3);
  const WienerInverse2d brief{test::arc_path(12, 3, 0.3), 0.01f, 0.1f}, lengthy{test::arc_path(60, 9, 1.2), 0.1f, 1};
  for (const int block_px : {4, 8, 64}) {
    const auto grid_of = [&](const auto& is_filtered) {
      const int cols = (src.cols + block_px - 1) / block_px;
      return test::make_grid(src.size(), block_px, [&](int i) -> BlockFilter {
        if (!is_filtered(i % cols, i / cols)) return {};
        return {0, nullptr, i % 2 == 0 ? &brief : &lengthy};
      });
    };
    const FilterGrid all = grid_of([](int, int) { return true; });
    const FilterGrid few = grid_of([](int col, int row) { return row == 1 && (col == 0 || col == 3); });
    const auto used = make_engine("cpu", 2), fresh = make_engine("cpu", 2);
    cv::Mat dst, expected;
    used->filter(former, all, dst);
    used->filter(src, few, dst);
    fresh->filter(src, few, expected);
    EXPECT_TRUE(equal(dst, expected)) << block_px << " px";
  }
}

// The noise of an image, and about what it makes of WienerInverse2d's ratio in these scenes and in photographs.
constexpr double kNoiseGreyLevels = 2;
constexpr float kNoiseToSignal = 0.007f, kNoiseRisePx2 = 0.3f;

/// What is left of a sharp image after blur along `path_px`, noise, and a filter [dB].
double restored_db(const cv::Mat& sharp, const Path2d& path_px, const BlockFilter& filter) {
  const cv::Mat blurred = test::expose(test::blur_in_2d(sharp, path_px), kNoiseGreyLevels, 4);
  const FilterGrid grid = test::make_grid(sharp.size(), 64, [&](int) { return filter; });
  cv::Mat dst;
  make_engine("cpu", 2)->filter(blurred, grid, dst);
  const int border = static_cast<int>(extent_of(path_px).maxCoeff());
  const cv::Rect inside(border, border, sharp.cols - 2 * border, sharp.rows - 2 * border);
  return test::psnr_db(dst(inside), sharp(inside));
}

TEST(FourierFilter, RestoresAsMuchAsTheKernelOfALine) {
  const cv::Mat sharp = test::textured_image(512, 384, 9);
  const FilterBank bank({});
  for (const double extent_px : {6.0, 15.0, 30.0, 60.0}) {
    const Path2d path_px = test::arc_path(extent_px, 0, 0.5);
    const WienerInverse2d inverse{path_px, kNoiseToSignal, kNoiseRisePx2};
    EXPECT_GT(restored_db(sharp, path_px, {0, nullptr, &inverse}),
              restored_db(sharp, path_px, {0.5, &bank.kernel(extent_px)}))
        << extent_px << " px";
  }
}

TEST(FourierFilter, RestoresWhereThePathIsCurved) {
  const cv::Mat sharp = test::textured_image(512, 384, 9);
  const FilterBank bank({});
  for (const auto& [extent_px, sagitta_px] : {std::pair(15.0, 5.0), std::pair(30.0, 8.0), std::pair(60.0, 12.0)}) {
    const Path2d path_px = test::arc_path(extent_px, sagitta_px, 0.5);
    const WienerInverse2d inverse{path_px, kNoiseToSignal, kNoiseRisePx2};
    const double in_2d = restored_db(sharp, path_px, {0, nullptr, &inverse});
    EXPECT_GT(in_2d, restored_db(sharp, path_px, {}) + 4) << extent_px << " px";
    EXPECT_GT(in_2d, restored_db(sharp, path_px, {0.5, &bank.kernel(extent_px)}) + 3) << extent_px << " px";
  }
}

// Without what continues the image beyond its border, what lies within half an extent of it gains 3.1, 3.0 and 2.5 dB.
TEST(FourierFilter, KnowsLittleOfWhatLiesOutsideButSomething) {
  const cv::Mat scene = test::textured_image(448, 384, 9);
  const cv::Rect seen(64, 64, 320, 256);
  for (const auto& [extent_px, gained_db] : {std::pair(15.0, 3.8), std::pair(30.0, 3.5), std::pair(60.0, 3.2)}) {
    const Path2d path_px = test::arc_path(extent_px, 0.2 * extent_px, 0.5);
    const WienerInverse2d inverse{path_px, kNoiseToSignal, kNoiseRisePx2};
    const cv::Mat sharp = scene(seen).clone();
    const cv::Mat blurred = test::expose(test::blur_in_2d(scene, path_px)(seen), kNoiseGreyLevels, 4);
    const FilterGrid grid = test::make_grid(seen.size(), 64, [&](int) { return BlockFilter{0, nullptr, &inverse}; });
    FourierFilter filter;
    const cv::Mat restored = filtered(blurred, grid, filter);
    const int width = static_cast<int>(extent_px / 2);
    const auto squares = [&](const cv::Mat& image) {
      cv::Mat d;
      cv::subtract(image, sharp, d, cv::noArray(), CV_64F);
      const cv::Mat inner = d(cv::Rect(width, width, d.cols - 2 * width, d.rows - 2 * width));
      return d.dot(d) - inner.dot(inner);
    };
    EXPECT_GT(10 * std::log10(squares(blurred) / squares(restored)), gained_db) << extent_px << " px";
  }
}

// Every other block has the inverse, with paths that are off by up to a fifth; the others something else.
TEST(FourierFilter, LeavesNoSeams) {
  constexpr double kMostContrast = 1.05, kExtentPx = 24;
  const cv::Mat sharp = test::textured_image(640, 640, 8);
  const FilterBank bank({});
  const Path2d path_px = test::arc_path(kExtentPx, 0, 0.4);
  const cv::Mat blurred = test::expose(test::blur_in_2d(sharp, path_px), 1, 2);
  const BlockGrid blocks(sharp.cols, sharp.rows, 64);
  WienerInverse2d inverses[3];
  for (int i = 0; i < 3; ++i)
    inverses[i] = {test::arc_path(kExtentPx * (1 + 0.1 * (i - 1)), 1.5 * i, 0.4), kNoiseToSignal, kNoiseRisePx2};
  const BlockFilter line{0.4, &bank.kernel(kExtentPx)}, copied{}, other{0, nullptr, &inverses[1]};
  const auto engine = make_engine("cpu", 2);
  const double of_sharp = test::border_contrast(sharp, blocks);
  for (const BlockFilter& between : {line, copied, other}) {
    const FilterGrid grid = test::make_grid(sharp.size(), 64, [&](int i) -> BlockFilter {
      return (i / blocks.cols() + i) % 2 == 0 ? BlockFilter{0, nullptr, &inverses[i % 3]} : between;
    });
    cv::Mat dst, hard(sharp.size(), CV_8U), alone;
    engine->filter(blurred, grid, dst);
    EXPECT_LE(test::border_contrast(dst, blocks) / of_sharp, kMostContrast);
    // Blocks cut out of an image that is filtered like them show: there is something to blend.
    for (int i = 0; i < blocks.size(); ++i) {
      engine->filter(blurred, test::make_grid(sharp.size(), 640, [&](int) { return grid.blocks[i]; }), alone);
      alone(blocks.rect(i)).copyTo(hard(blocks.rect(i)));
    }
    EXPECT_GT(test::border_contrast(hard, blocks) / of_sharp, kMostContrast);
  }
}

}  // namespace
}  // namespace gyro_deblur::fourier_filter_test
