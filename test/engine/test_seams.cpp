// Borders between blocks must not show, in any engine.
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "engine/cpu/cpu_engine.hpp"
#include "engine/engine.hpp"
#include "filter_grids.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "naive_convolution.hpp"
#include "pipeline/deconvolution.hpp"
#include "roll_scene.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::seams_test {
namespace {

constexpr int kThreads = 2;
constexpr double kNoiseGreyLevels = 1;
constexpr double kMostContrast = 1.05;

BlurFieldOptions wide_options() {
  BlurFieldOptions options;
  options.min_extent_px = 1;
  options.max_extent_px = 500;
  return options;
}

double difference(const cv::Mat& a, const cv::Mat& b) { return cv::norm(a, b, cv::NORM_INF); }

/// Convolves every block by itself, as if it had no neighbours with another filter.
class UnblendedEngine : public Engine {
 public:
  explicit UnblendedEngine(Engine& engine) : engine_(engine) {}

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) override {
    src.copyTo(dst);
    cv::Mat alone;
    for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
      if (grid.blocks[i].kernel == nullptr) continue;
      engine_.filter(src, test::one_block(src.size(), grid.blocks[i].angle_rad, *grid.blocks[i].kernel), alone);
      alone(grid.rect(i)).copyTo(dst(grid.rect(i)));
    }
  }
  std::string name() const override { return engine_.name() + ", not blended"; }

 private:
  Engine& engine_;
};

/// By name: "opencl" too, with the kernels for its first device; "cpu-" and an instruction set.
class SeamsTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    const std::string name = GetParam(), cpu = "cpu-";
    if (name.compare(0, cpu.size(), cpu) == 0) {
      const BlockSimd* kernels = find_for_cpu<BlockSimd>(name.c_str() + cpu.size());
      if (kernels == nullptr) GTEST_SKIP() << "this processor does not run " << name;
      engine_ = std::make_unique<CpuEngine>(kThreads, *kernels);
    } else {
      engine_ = make_engine(name, kThreads);
    }
    if (name == "opencl" && engine_->name().compare(0, name.size(), name) != 0) {
      GTEST_SKIP() << "there is no OpenCL device";
    }
  }

  cv::Mat convolved(const cv::Mat& src, const FilterGrid& grid) {
    cv::Mat dst;
    engine_->filter(src, grid, dst);
    return dst;
  }

  std::unique_ptr<Engine> engine_;
  FilterBank bank_{FilterOptions{}};
};

/// Mean gradient across the borders of blocks over that inside them, relative to the sharp image, where a camera rolled
/// about the image centre.
double seam_contrast(const cv::Mat& sharp, double mean_extent_px, const FilterBank& bank, Engine& engine) {
  const test::Roll roll = test::Roll::about_center(sharp.cols, sharp.rows, mean_extent_px);
  const FrameBlur field = roll.field(sharp.cols, sharp.rows, wide_options());
  const cv::Mat blurred = test::expose(roll.blur(sharp), kNoiseGreyLevels, 3);
  cv::Mat deblurred;
  deconvolve(blurred, PixelLayout::GRAY, field, bank, engine, deblurred);
  return test::border_contrast(deblurred, field.grid) / test::border_contrast(sharp, field.grid);
}

TEST_P(SeamsTest, AreNotSeenOnARollField) {
  const cv::Mat sharp = test::textured_image(832, 576, 21);
  for (const double extent_px : {5.0, 15.0, 30.0, 60.0, 90.0, 130.0}) {
    EXPECT_LE(seam_contrast(sharp, extent_px, bank_, *engine_), kMostContrast) << extent_px << " px";
  }
}

TEST_P(SeamsTest, AreNotSeenOnAPhotograph) {
  const std::string path = std::string(GYRO_DEBLUR_DATA_DIR) + "/oxford_affine/graf/img1.png";
  const cv::Mat sharp = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (sharp.empty()) GTEST_SKIP() << path << " is not there";
  for (const double extent_px : {15.0, 90.0}) {
    EXPECT_LE(seam_contrast(sharp, extent_px, bank_, *engine_), kMostContrast) << extent_px << " px";
  }
}

// Without this the two tests above might measure nothing.
TEST(Seams, AreSeenWhereBlocksAreNotBlended) {
  const cv::Mat sharp = test::textured_image(512, 384, 21);
  const FilterBank bank({});
  const auto engine = make_engine("cpu", kThreads);
  UnblendedEngine unblended(*engine);
  for (const double extent_px : {15.0, 60.0}) {
    const double with = seam_contrast(sharp, extent_px, bank, *engine);
    const double without = seam_contrast(sharp, extent_px, bank, unblended);
    EXPECT_GT(without, kMostContrast + 0.05) << extent_px << " px";
    EXPECT_LT(with, without - 0.05) << extent_px << " px";
  }
}

// A kernel of one tap multiplies by a number, so that a constant image shows the weights themselves.
TEST_P(SeamsTest, AreLinearRamps) {
  LineKernel half, whole;
  half.taps = {0.5f};
  whole.taps = {1.0f};
  const cv::Mat src(64, 64, CV_8UC1, cv::Scalar(180));
  const cv::Mat sideways = convolved(src, {{0, 32, 64}, {0, 64}, {{0, &half}, {0, &whole}}});
  const cv::Mat above = convolved(src, {{0, 64}, {0, 32, 64}, {{0, &half}, {0, &whole}}});
  const cv::Mat faded = convolved(src, {{0, 32, 64}, {0, 64}, {{0, &half}, {0, nullptr}}});
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      // Nine steps of 10 grey levels.
      const int expected = 90 + 10 * std::clamp(x - 27, 0, 9);
      EXPECT_EQ(sideways.at<uchar>(y, x), expected) << x << " " << y;
      EXPECT_EQ(above.at<uchar>(x, y), expected) << x << " " << y;
    }
  }
  // 100, 110, 120 and 130 by the ramp, of which one to four fifths give way to the input.
  const int expected[] = {90, 90, 116, 138, 156, 170, 180, 180};
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(faded.at<uchar>(20, 26 + i), expected[i], 1) << i;
}

TEST_P(SeamsTest, AreWhatTheDefinitionSays) {
  struct Case {
    int width, height, type, block_px;
  };
  const Case cases[] = {{193, 130, CV_8UC1, 64},  {129, 65, CV_8UC1, 64}, {150, 149, CV_16UC1, 37},
                        {300, 280, CV_8UC1, 128}, {97, 90, CV_8UC3, 16},  {97, 90, CV_16UC4, 16},
                        {260, 133, CV_8UC2, 131}, {31, 23, CV_8UC1, 5},   {31, 23, CV_16UC3, 3},
                        {20, 21, CV_8UC1, 2},     {20, 21, CV_16UC1, 1},  {1, 200, CV_8UC1, 64},
                        {200, 1, CV_8UC4, 64}};
  constexpr int kGains = 16;
  std::vector<LineKernel> gains(kGains);
  for (int i = 0; i < kGains; ++i) gains[i].taps = {static_cast<float>(i) / kGains};
  cv::RNG rng(17);
  for (const Case& c : cases) {
    // Multiples of 16, so that every gain gives a whole number, a different one in each channel.
    const double unit = CV_MAT_DEPTH(c.type) == CV_8U ? 16 : 16 * 257;
    const cv::Mat src(c.height, c.width, c.type, cv::Scalar(15, 9, 12, 5) * unit);
    const FilterGrid grid = test::make_grid(src.size(), c.block_px, [&](int) -> BlockFilter {
      const bool copied = rng.uniform(0, 5) == 0;
      const double angle_rad = rng.uniform(0.0, CV_PI);
      return {angle_rad, copied ? nullptr : &gains[rng.uniform(0, kGains)]};
    });
    const cv::Mat dst = convolved(src, grid);
    int wrong = 0;
    for (int y = 0; y < src.rows; ++y) {
      const test::AxisBlend down(grid.y, y);
      for (int x = 0; x < src.cols; ++x) {
        const test::AxisBlend across(grid.x, x);
        for (int channel = 0; channel < src.channels(); ++channel) {
          const double input = test::pixel_at(src, x, y, channel);
          const double expected = test::blend_at(grid, across, down, true, input,
                                                 [&](int block) { return input * grid.blocks[block].kernel->taps[0]; });
          if (test::pixel_at(dst, x, y, channel) != expected) ++wrong;
        }
      }
    }
    EXPECT_EQ(wrong, 0) << c.width << "x" << c.height << " type " << c.type << " blocks of " << c.block_px;
  }
}

TEST_P(SeamsTest, LeaveCopiedBlocksAndWhatIsFarFromABorderAlone) {
  const cv::Mat src = test::textured_image(320, 256, 4);
  FilterGrid grid = test::make_grid(src.size(), 64, [&](int i) -> BlockFilter {
    return {0.3 * i, i % 3 == 1 ? nullptr : &bank_.kernel(9 + i)};
  });
  const cv::Mat blended = convolved(src, grid);
  cv::Mat alone;
  UnblendedEngine(*engine_).filter(src, grid, alone);
  for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
    const cv::Rect rect = grid.rect(i), inner(rect.x + 4, rect.y + 4, 56, 56);
    if (grid.blocks[i].kernel == nullptr) {
      EXPECT_EQ(difference(src(rect), blended(rect)), 0) << i;
    } else {
      EXPECT_EQ(difference(alone(inner), blended(inner)), 0) << i;
      EXPECT_GT(difference(alone(rect), blended(rect)), 0) << i;
    }
  }
}

// A block next to a copied one has no step there: the mean gradient is that of the image around.
TEST_P(SeamsTest, AreNotSeenNextToCopiedBlocks) {
  const cv::Mat sharp = test::textured_image(640, 640, 8);
  const double angle_rad = 0.4, extent_px = 24;
  const cv::Mat blurred = test::expose(test::blur_along_line(sharp, angle_rad, extent_px), kNoiseGreyLevels, 2);
  FrameBlur field = uniform_blur_field(640, 640, angle_rad, extent_px, wide_options());
  for (int i = 0; i < field.grid.size(); ++i) {
    if ((i / field.grid.cols() + i % field.grid.cols()) % 2 == 0) field.blocks[i].status = BlockStatus::REJECTED;
  }
  cv::Mat blended, alone;
  deconvolve(blurred, PixelLayout::GRAY, field, bank_, *engine_, blended);
  UnblendedEngine unblended(*engine_);
  deconvolve(blurred, PixelLayout::GRAY, field, bank_, unblended, alone);
  EXPECT_LE(test::border_contrast(blended, field.grid), kMostContrast);
  EXPECT_GT(test::border_contrast(alone, field.grid), kMostContrast + 0.2);
}

TEST_P(SeamsTest, AreNotWhereNothingChanges) {
  const cv::Mat src = test::textured_image(200, 150, 4);
  const LineKernel& kernel = bank_.kernel(13);
  const FilterGrid blocks = test::make_grid(src.size(), 48, [&](int) -> BlockFilter { return {0.7, &kernel}; });
  EXPECT_EQ(difference(convolved(src, blocks), convolved(src, test::one_block(src.size(), 0.7, kernel))), 0);
}

// The planes of a mosaic are images with half the blocks and half the extents.
TEST_P(SeamsTest, AreBlendedOnBayerPlanes) {
  const cv::Size size(384, 256);
  const cv::Mat mosaic = test::textured_image(size.width, size.height, 12);
  FrameBlur field =
      test::Roll::about_center(size.width, size.height, 20).field(size.width, size.height, wide_options());
  field.blocks[7].status = BlockStatus::REJECTED;
  cv::Mat dst;
  deconvolve(mosaic, PixelLayout::BAYER_RGGB, field, bank_, *engine_, dst);

  FrameBlur half = field;
  half.grid = BlockGrid(size.width / 2, size.height / 2, field.grid.block_size_px() / 2);
  for (BlockBlur& block : half.blocks) block.extent_px /= 2;
  for (const cv::Point phase : {cv::Point(0, 0), cv::Point(1, 0), cv::Point(0, 1), cv::Point(1, 1)}) {
    const auto plane_of = [&](const cv::Mat& from) {
      cv::Mat plane(size / 2, CV_8UC1);
      for (int y = 0; y < plane.rows; ++y) {
        for (int x = 0; x < plane.cols; ++x) plane.at<uchar>(y, x) = from.at<uchar>(2 * y + phase.y, 2 * x + phase.x);
      }
      return plane;
    };
    cv::Mat expected;
    deconvolve(plane_of(mosaic), PixelLayout::GRAY, half, bank_, *engine_, expected);
    EXPECT_EQ(difference(expected, plane_of(dst)), 0) << phase;
  }
}

std::string engine_name(const testing::TestParamInfo<const char*>& info) {
  std::string name = info.param;
  name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
  return name;
}
constexpr const char* kEngines[] = {"float", "cpu-baseline",
#if defined(__x86_64__)
                                    "cpu-avx2", "cpu-avx512",
#elif defined(__aarch64__)
                                    "cpu-dotprod",
#endif
                                    "opencl"};
INSTANTIATE_TEST_SUITE_P(Engines, SeamsTest, testing::ValuesIn(kEngines), engine_name);

}  // namespace
}  // namespace gyro_deblur::seams_test
