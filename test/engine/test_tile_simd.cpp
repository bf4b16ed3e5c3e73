// The loops of the 2-D filter around its transforms, for every instruction set that this processor runs.
#include "engine/tile_simd.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "base/fourier.hpp"
#include "compiled_sets.hpp"
#include "images.hpp"
#include "naive_convolution.hpp"

namespace gyro_deblur::tile_simd_test {
namespace {

class TileSimdTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    simd_ = find_for_cpu<TileSimd>(GetParam());
    if (simd_ == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
    EXPECT_STREQ(simd_->name, GetParam());
  }

  const TileSimd* simd_ = nullptr;
};

/// From 0 to 1, different at every place.
std::vector<float> rising(int length) {
  std::vector<float> values(length);
  for (int i = 0; i < length; ++i) values[i] = (static_cast<float>(i) + 0.5f) / static_cast<float>(length);
  return values;
}

cv::Mat random_floats(int cols, int rows, std::uint64_t seed) {
  cv::Mat values(rows, cols, CV_32F);
  cv::RNG(seed).fill(values, cv::RNG::UNIFORM, -300.0, 300.0);
  return values;
}

double pixel(const cv::Mat& image, int x, int y) {
  x = std::clamp(x, 0, image.cols - 1);
  y = std::clamp(y, 0, image.rows - 1);
  return image.depth() == CV_32F ? image.at<float>(y, x) : test::pixel_at(image, x, y, 0);
}

TEST_P(TileSimdTest, LoadsTilesThatFadeIntoTheirBeginning) {
  // Inside; at corners; beyond an image that is smaller than the window's surroundings; windows of odd size.
  const std::tuple<cv::Size, cv::Rect, cv::Size> cases[] = {
      {{300, 260}, {90, 80, 64, 64}, {128, 96}},  {{300, 260}, {91, 83, 37, 19}, {96, 64}},
      {{300, 260}, {0, 0, 48, 40}, {96, 96}},     {{300, 260}, {255, 230, 45, 30}, {64, 96}},
      {{20, 9}, {0, 0, 20, 9}, {160, 128}},       {{1, 1}, {0, 0, 1, 1}, {32, 32}},
      {{70, 200}, {3, 100, 61, 33}, {64, 64}},    {{65, 40}, {31, 0, 34, 40}, {64, 64}},
      {{400, 300}, {200, 100, 96, 64}, {96, 64}},
  };
  for (const auto& [size, window, tile_size] : cases) {
    for (const int type : {CV_8UC1, CV_16UC1, CV_32FC1}) {
      const cv::Mat image = type == CV_32FC1 ? random_floats(size.width, size.height, 3)
                                             : test::random_image(size.width, size.height, type, 4);
      const std::vector<float> fade_x = rising(tile_size.width - window.width),
                               fade_y = rising(tile_size.height - window.height);
      const TileSource source{image.data,      static_cast<std::ptrdiff_t>(image.step1()),
                              size.width,      size.height,
                              window.x,        window.y,
                              window.width,    window.height,
                              tile_size.width, tile_size.height,
                              fade_x.data(),   fade_y.data()};
      cv::Mat tile(tile_size.height, fourier_stride(tile_size.width), CV_32F, cv::Scalar(7e7));
      std::vector<float> scratch(tile_scratch(tile_size.width));
      (type == CV_8UC1    ? simd_->load_bytes
       : type == CV_16UC1 ? simd_->load_words
                          : simd_->load_floats)(source, tile.ptr<float>(), scratch.data());
      const double allowed = type == CV_16UC1 ? 0.05 : 3e-4;
      for (int y = 0; y < tile_size.height; ++y) {
        const double before_y = y < window.height ? 0 : fade_y[y - window.height];
        for (int x = 0; x < tile_size.width; ++x) {
          const double before_x = x < window.width ? 0 : fade_x[x - window.width];
          const auto row = [&](int at_y) {
            return (1 - before_x) * pixel(image, window.x + x, at_y) +
                   before_x * pixel(image, window.x + x - tile_size.width, at_y);
          };
          const double expected = (1 - before_y) * row(window.y + y) + before_y * row(window.y + y - tile_size.height);
          ASSERT_NEAR(tile.at<float>(y, x), expected, allowed)
              << size << ", " << window << ", type " << type << " at " << x << ", " << y;
        }
        for (int x = tile_size.width; x < tile.cols; ++x) ASSERT_EQ(tile.at<float>(y, x), 7e7f) << "written beyond";
      }
    }
  }
}

TEST_P(TileSimdTest, MoveWhatIsOutside) {
  const int cols = 96, rows = 32, stride = fourier_stride(cols);
  const cv::Mat before = random_floats(stride, rows, 1), continued = random_floats(stride, rows, 2);
  cv::Mat tile = before.clone();
  std::vector<float> inside_x = rising(cols), inside_y = rising(rows);
  simd_->continue_tile(cols, rows, 2.5f, inside_x.data(), inside_y.data(), continued.ptr<float>(), tile.ptr<float>());
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < cols; ++x) {
      const double old = before.at<float>(y, x), outside = 1 - static_cast<double>(inside_x[x]) * inside_y[y];
      ASSERT_NEAR(tile.at<float>(y, x), old + 2.5 * outside * (continued.at<float>(y, x) - old), 1e-3);
    }
  }
}

TEST_P(TileSimdTest, WeighWindowsWithoutGaps) {
  const int cols = 128;
  const cv::Mat tile = random_floats(fourier_stride(cols), 64, 5);
  for (const cv::Size& size : {cv::Size(64, 64), cv::Size(128, 2), cv::Size(37, 5), cv::Size(1, 3)}) {
    const std::vector<float> weights_x = rising(size.width), weights_y = rising(size.height);
    std::vector<float> window(size.area() + 1, 7e7f);
    simd_->weigh(tile.ptr<float>(), cols, size.width, size.height, weights_x.data(), weights_y.data(), window.data());
    for (int i = 0; i < size.area(); ++i) {
      const int x = i % size.width, y = i / size.width;
      ASSERT_NEAR(window[i], static_cast<double>(tile.at<float>(y, x)) * weights_x[x] * weights_y[y], 1e-4) << size;
    }
    EXPECT_EQ(window.back(), 7e7f) << "written beyond";
  }
}

TEST_P(TileSimdTest, AddRectangles) {
  const cv::Mat from = random_floats(70, 20, 6), before = random_floats(90, 20, 7);
  for (const int width : {1, 3, 4, 18, 36, 64, 69}) {
    cv::Mat to = before.clone();
    const cv::Rect rect(1, 2, width, 11);
    simd_->add(from(rect).ptr<float>(), from.cols, width, rect.height, to(rect).ptr<float>(), to.cols);
    cv::Mat expected = before.clone();
    expected(rect) += from(rect);
    EXPECT_TRUE(test::equal(to, expected)) << width;
  }
}

TEST_P(TileSimdTest, MixByWeights) {
  const int count = 83;
  std::vector<float> halves(count), weights_of_halves(count), weights(count), before(count);
  for (int i = 0; i < count; ++i) {
    halves[i] = static_cast<float>(i);
    before[i] = static_cast<float>(3 * i);
    weights_of_halves[i] = 0.1f * static_cast<float>(i % 5 - 1);
    weights[i] = 0.2f * static_cast<float>(i % 3);
  }
  std::vector<float> values = before;
  simd_->mix_sizes(halves.data(), weights_of_halves.data(), weights.data(), count, values.data());
  for (int i = 0; i < count; ++i) {
    const double weight = weights[i], of_half = weights_of_halves[i];
    if (of_half <= 0 && weight > 0) {
      EXPECT_FLOAT_EQ(values[i], static_cast<float>(before[i] / weight)) << i;
    } else if (weight + of_half != 0) {
      EXPECT_FLOAT_EQ(values[i], static_cast<float>((before[i] + halves[i]) / (weight + of_half))) << i;
    }
  }
}

TEST_P(TileSimdTest, RoundAndClip) {
  const auto check = [](auto store, auto highest) {
    using Pixel = decltype(highest);
    const float top = std::numeric_limits<Pixel>::max(), infinity = std::numeric_limits<float>::infinity();
    const std::vector<std::pair<float, double>> values = {
        {0, 0},       {-0.4f, 0},      {-3, 0},     {-infinity, 0},     {0.49f, 0},
        {0.5f, 1},    {1.5f, 2},       {99.4f, 99}, {top, top},         {top + 9, top},
        {1e30f, top}, {infinity, top}, {-1e30f, 0}, {top - 1, top - 1}, {std::numeric_limits<float>::quiet_NaN(), 0}};
    for (const int width : {1, 7, 16, 37, 64}) {
      for (const int step : {1, 3}) {
        const int height = 3, stride = width * step + 2, from_stride = width + 5;
        std::vector<float> from(from_stride * height, 33);
        for (int i = 0; i < width * height; ++i) {
          from[i / width * from_stride + i % width] = values[i % values.size()].first;
        }
        std::vector<Pixel> to(stride * height, 77);
        store(from.data(), from_stride, width, height, step, to.data(), stride);
        for (int y = 0; y < height; ++y) {
          for (int i = 0; i < stride; ++i) {
            const bool is_written = i % step == 0 && i < width * step;
            const double expected = is_written ? values[(y * width + i / step) % values.size()].second : 77;
            ASSERT_EQ(to[y * stride + i], expected) << width << ", step " << step << " at " << i << ", " << y;
          }
        }
      }
    }
  };
  check(simd_->store_bytes, std::uint8_t());
  check(simd_->store_words, std::uint16_t());
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, TileSimdTest, testing::ValuesIn(test::kInstructionSets));

}  // namespace
}  // namespace gyro_deblur::tile_simd_test
