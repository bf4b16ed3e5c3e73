// The OpenCL engine against the float engine, with pinned memory and, where device and host share memory, with mapped.
#include "engine/opencl/opencl_engine.hpp"

#include <algorithm>
#include <cctype>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "engine/engine.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/float/float_engine.hpp"
#include "filter_grids.hpp"
#include "inverse/filter_bank.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::opencl_engine_test {
namespace {

constexpr int kThreads = 2;

/// Blocks with angles all around and extents near `extent_px`; every seventh has no kernel.
FilterGrid varied_blocks(int width_px, int height_px, int block_px, double extent_px, const FilterBank& bank) {
  return test::make_grid({width_px, height_px}, block_px, [&](int i) -> BlockFilter {
    const bool filtered = i % 7 != 6;
    const double angle_rad = (23 * i % 180) * CV_PI / 180;
    return {angle_rad, filtered ? &bank.kernel(extent_px * (1 + 0.03 * (i % 5))) : nullptr};
  });
}

cv::Mat textured(int width_px, int height_px, int channels, int depth) {
  const cv::Rect wanted(0, 0, width_px, height_px);
  std::vector<cv::Mat> planes;
  for (int channel = 0; channel < channels; ++channel) {
    const cv::Mat plane = test::textured_image(std::max(width_px, 16), std::max(height_px, 16), 40 + channel);
    planes.push_back(plane(wanted).clone());
  }
  cv::Mat image;
  cv::merge(planes, image);
  if (depth == CV_16U) image.convertTo(image, CV_16U, 257);
  return image;
}

double largest_difference(const cv::Mat& a, const cv::Mat& b) { return cv::norm(a, b, cv::NORM_INF); }

class OpenClEngineTest : public testing::TestWithParam<bool> {
 protected:
  void SetUp() override {
    if (opencl_devices().empty()) GTEST_SKIP() << "there is no OpenCL device";
    engine_ = make_opencl_engine("", kThreads, GetParam());
  }

  cv::Mat expected(const cv::Mat& src, const FilterGrid& blocks) {
    cv::Mat dst;
    float_.filter(src, blocks, dst);
    return dst;
  }

  cv::Mat actual(const cv::Mat& src, const FilterGrid& blocks) {
    cv::Mat dst;
    engine_->filter(src, blocks, dst);
    return dst;
  }

  std::unique_ptr<Engine> engine_;
  FloatEngine float_{kThreads};
  FilterBank bank_{FilterOptions{}};
};

TEST_P(OpenClEngineTest, AgreesAtEveryAngleAndExtent) {
  const cv::Mat image = textured(200, 150, 1, CV_8U);
  for (const double extent_px : {2.0, 5.0, 11.3, 30.0, 90.0, 130.0}) {
    for (int degrees = 0; degrees < 180; degrees += 15) {
      const FilterGrid blocks = test::one_block(image.size(), degrees * CV_PI / 180, bank_.kernel(extent_px));
      ASSERT_LE(largest_difference(expected(image, blocks), actual(image, blocks)), 1)
          << extent_px << " px, " << degrees << " deg";
    }
  }
}

TEST_P(OpenClEngineTest, TakesEverySizeTypeAndBorder) {
  struct Case {
    int width, height, channels, depth;
  };
  const Case cases[] = {{1, 1, 1, CV_8U},    {1, 90, 1, CV_8U},    {90, 1, 1, CV_16U},   {5, 7, 2, CV_8U},
                        {63, 65, 1, CV_16U}, {131, 197, 3, CV_8U}, {131, 97, 4, CV_16U}, {257, 64, 4, CV_8U}};
  for (const Case& c : cases) {
    const cv::Mat image = textured(c.width, c.height, c.channels, c.depth);
    for (const double extent_px : {8.0, 35.0, 110.0, 400.0}) {
      for (const int block_px : {64, 37, 150}) {
        const FilterGrid blocks = varied_blocks(c.width, c.height, block_px, extent_px, bank_);
        const cv::Mat result = actual(image, blocks);
        ASSERT_EQ(result.size(), image.size());
        ASSERT_EQ(result.type(), image.type());
        EXPECT_LE(largest_difference(expected(image, blocks), result), 1)
            << c.width << "x" << c.height << "x" << c.channels << " depth " << c.depth << " " << extent_px << " px "
            << block_px;
      }
    }
  }
}

TEST_P(OpenClEngineTest, KeepsAConstantImageAndCopiesBlocksWithoutKernel) {
  const cv::Mat constant(150, 200, CV_8UC1, cv::Scalar(117));
  EXPECT_EQ(largest_difference(constant, actual(constant, varied_blocks(200, 150, 50, 80, bank_))), 0);

  const cv::Mat image = textured(200, 150, 1, CV_8U);
  FilterGrid blocks = varied_blocks(200, 150, 50, 12, bank_);
  cv::Mat result = actual(image, blocks);
  for (std::size_t i = 0; i < blocks.blocks.size(); ++i) {
    const cv::Rect rect = blocks.rect(static_cast<int>(i));
    const double difference = largest_difference(image(rect), result(rect));
    if (blocks.blocks[i].kernel == nullptr) {
      EXPECT_EQ(difference, 0);
    } else {
      EXPECT_GT(difference, 0);
    }
  }
  for (BlockFilter& block : blocks.blocks) block.kernel = nullptr;
  EXPECT_EQ(largest_difference(image, actual(image, blocks)), 0);
}

// Buffers of an earlier, larger frame must not shine through.
TEST_P(OpenClEngineTest, DoesNotDependOnEarlierFrames) {
  const cv::Mat small = textured(120, 90, 1, CV_8U), large = textured(300, 200, 3, CV_16U);
  const FilterGrid small_blocks = varied_blocks(120, 90, 64, 20, bank_);
  const FilterGrid large_blocks = varied_blocks(300, 200, 64, 90, bank_);
  const cv::Mat small_first = actual(small, small_blocks), large_first = actual(large, large_blocks);
  EXPECT_EQ(largest_difference(small_first, actual(small, small_blocks)), 0);
  EXPECT_EQ(largest_difference(large_first, actual(large, large_blocks)), 0);
}

TEST_P(OpenClEngineTest, TakesImagesWithGapsBetweenRows) {
  const cv::Mat frame = textured(200, 150, 3, CV_8U);
  const cv::Mat part = frame(cv::Rect(20, 10, 101, 77));
  const FilterGrid blocks = varied_blocks(part.cols, part.rows, 64, 20, bank_);
  EXPECT_EQ(largest_difference(actual(part.clone(), blocks), actual(part, blocks)), 0);
}

TEST_P(OpenClEngineTest, FiltersKernelsOfAnyShape) {
  LineKernel lopsided, sparse, zero;
  lopsided.taps.assign(81, 0.0f);
  for (int i = 0; i < 81; ++i) lopsided.taps[i] = static_cast<float>(i) / 3240;
  sparse.taps.assign(81, 0.0f);
  sparse.taps[3] = sparse.taps[70] = 0.5f;
  zero.taps.assign(5, 0.0f);
  for (const int depth : {CV_8U, CV_16U}) {
    const cv::Mat image = textured(160, 120, 1, depth);
    const FilterGrid blocks = {
        {0, 80, 160}, {0, 60, 120}, {{2.5, &lopsided}, {0.7, &sparse}, {1.7, &sparse}, {1.2, &zero}}};
    EXPECT_LE(largest_difference(expected(image, blocks), actual(image, blocks)), 1);
  }
}

TEST_P(OpenClEngineTest, RefusesOtherTypes) {
  cv::Mat dst;
  EXPECT_THROW(engine_->filter(cv::Mat(8, 8, CV_32FC1), {}, dst), std::invalid_argument);
  EXPECT_THROW(engine_->filter(cv::Mat(), {}, dst), std::invalid_argument);
}

// No device holds a plane of 2^31 floats or more; the error has to be one that the fallback takes.
TEST_P(OpenClEngineTest, ReportsWhatTheDeviceCannotDo) {
  LineKernel endless;
  endless.taps.assign(80001, 1.0f / 80001);
  const cv::Mat image = textured(8, 8, 1, CV_8U);
  cv::Mat dst;
  EXPECT_THROW(engine_->filter(image, test::one_block(image.size(), CV_PI / 4, endless), dst), DeviceError);
  // The engine is none the worse for it.
  const FilterGrid blocks = varied_blocks(8, 8, 64, 5, bank_);
  EXPECT_LE(largest_difference(expected(image, blocks), actual(image, blocks)), 1);
}

std::string memory_name(const testing::TestParamInfo<bool>& info) { return info.param ? "Pinned" : "Mapped"; }
INSTANTIATE_TEST_SUITE_P(Memory, OpenClEngineTest, testing::Bool(), memory_name);

class OpenClDeviceTest : public testing::Test {
 protected:
  void SetUp() override {
    devices_ = opencl_devices();
    if (devices_.empty()) GTEST_SKIP() << "there is no OpenCL device";
  }
  std::vector<std::string> devices_;
};

TEST_F(OpenClDeviceTest, IsChosenByIndexOrPartOfItsName) {
  const std::string by_index = make_opencl_engine("0", kThreads)->name();
  EXPECT_EQ(by_index.rfind("opencl (", 0), 0u) << by_index;
  std::string shouted = devices_[0];
  std::transform(shouted.begin(), shouted.end(), shouted.begin(), [](unsigned char c) { return std::toupper(c); });
  EXPECT_EQ(make_opencl_engine(shouted, kThreads)->name(), by_index);
  EXPECT_EQ(make_engine("opencl:0")->name(), by_index);
  EXPECT_EQ(make_engine("opencl:" + devices_[0].substr(1))->name(), by_index);
  EXPECT_EQ(make_engine("opencl")->name().rfind("opencl (", 0), 0u);
}

TEST_F(OpenClDeviceTest, ListsWhatThereIsWhenNoneFits) {
  for (const std::string& wanted : {std::string("abacus"), std::to_string(devices_.size())}) {
    try {
      make_opencl_engine(wanted, kThreads);
      FAIL() << wanted;
    } catch (const DeviceError& error) {
      EXPECT_NE(std::string(error.what()).find(wanted), std::string::npos) << error.what();
      EXPECT_NE(std::string(error.what()).find(devices_[0]), std::string::npos) << error.what();
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::opencl_engine_test
