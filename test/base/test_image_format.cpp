#include "gyro_deblur/image_format.hpp"

#include <cmath>
#include <string>
#include <utility>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

namespace gyro_deblur {
namespace {

TEST(LayoutOfEncoding, KnowsEveryEncodingThatCanBeDeblurred) {
  const std::pair<const char*, PixelLayout> expected[] = {
      {"mono8", PixelLayout::GRAY},
      {"mono16", PixelLayout::GRAY},
      {"8UC1", PixelLayout::GRAY},
      {"16UC1", PixelLayout::GRAY},
      {"bgr8", PixelLayout::BGR},
      {"bgr16", PixelLayout::BGR},
      {"rgb8", PixelLayout::RGB},
      {"rgb16", PixelLayout::RGB},
      {"bgra8", PixelLayout::BGRA},
      {"bgra16", PixelLayout::BGRA},
      {"rgba8", PixelLayout::RGBA},
      {"rgba16", PixelLayout::RGBA},
      {"bayer_rggb8", PixelLayout::BAYER_RGGB},
      {"bayer_rggb16", PixelLayout::BAYER_RGGB},
      {"bayer_bggr8", PixelLayout::BAYER_BGGR},
      {"bayer_bggr16", PixelLayout::BAYER_BGGR},
      {"bayer_gbrg8", PixelLayout::BAYER_GBRG},
      {"bayer_gbrg16", PixelLayout::BAYER_GBRG},
      {"bayer_grbg8", PixelLayout::BAYER_GRBG},
      {"bayer_grbg16", PixelLayout::BAYER_GRBG},
  };
  for (const auto& [encoding, layout] : expected) {
    ASSERT_TRUE(layout_of_encoding(encoding).has_value()) << encoding;
    EXPECT_EQ(*layout_of_encoding(encoding), layout) << encoding;
    EXPECT_EQ(is_bayer(layout), std::string(encoding).rfind("bayer", 0) == 0) << encoding;
  }
  for (const char* encoding : {"", "MONO8", "mono32", "32FC1", "8UC2", "8UC3", "yuv422", "nv21", "jpeg"}) {
    EXPECT_FALSE(layout_of_encoding(encoding).has_value()) << encoding;
  }
}

TEST(ChannelsOf, FollowsTheLayout) {
  EXPECT_EQ(channels_of(PixelLayout::GRAY), 1);
  EXPECT_EQ(channels_of(PixelLayout::BAYER_GBRG), 1);
  EXPECT_EQ(channels_of(PixelLayout::BGR), 3);
  EXPECT_EQ(channels_of(PixelLayout::RGBA), 4);
}

TEST(Luminance8, ReturnsGreyWithoutACopy) {
  const cv::Mat grey(5, 7, CV_8UC1, cv::Scalar(9));
  EXPECT_EQ(luminance8(grey, PixelLayout::GRAY).data, grey.data);
}

TEST(Luminance8, TellsChannelOrdersApart) {
  // ITU-R BT.601: 0.299 R + 0.587 G + 0.114 B.
  const double expected = 0.299 * 200 + 0.587 * 100 + 0.114 * 30;
  const cv::Mat rgb(4, 4, CV_8UC3, cv::Scalar(200, 100, 30)), bgr(4, 4, CV_8UC3, cv::Scalar(30, 100, 200));
  const cv::Mat rgba(4, 4, CV_8UC4, cv::Scalar(200, 100, 30, 7)), bgra(4, 4, CV_8UC4, cv::Scalar(30, 100, 200, 7));
  const std::pair<cv::Mat, PixelLayout> images[] = {
      {rgb, PixelLayout::RGB}, {bgr, PixelLayout::BGR}, {rgba, PixelLayout::RGBA}, {bgra, PixelLayout::BGRA}};
  for (const auto& [image, layout] : images) {
    const cv::Mat luminance = luminance8(image, layout);
    ASSERT_EQ(luminance.type(), CV_8UC1);
    EXPECT_NEAR(luminance.at<uchar>(2, 2), expected, 1);
  }
}

TEST(Luminance8, Scales16BitSoThatFullScaleStaysFullScale) {
  cv::Mat image(1, 4, CV_16UC1);
  const int values[] = {0, 257, 32896, 65535}, expected[] = {0, 1, 128, 255};
  for (int i = 0; i < 4; ++i) image.at<std::uint16_t>(i) = static_cast<std::uint16_t>(values[i]);
  const cv::Mat luminance = luminance8(image, PixelLayout::GRAY);
  ASSERT_EQ(luminance.type(), CV_8UC1);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(luminance.at<uchar>(i), expected[i]);
  EXPECT_EQ(luminance8(cv::Mat(3, 3, CV_16UC3, cv::Scalar::all(65535)), PixelLayout::RGB).at<uchar>(1, 1), 255);
}

TEST(Luminance8, ReadsBayerPatternsByTheirRosNames) {
  // A uniform colour under each pattern; the name lists the first row, then the second.
  const std::pair<std::string, PixelLayout> patterns[] = {{"rggb", PixelLayout::BAYER_RGGB},
                                                          {"bggr", PixelLayout::BAYER_BGGR},
                                                          {"gbrg", PixelLayout::BAYER_GBRG},
                                                          {"grbg", PixelLayout::BAYER_GRBG}};
  const double expected = 0.299 * 200 + 0.587 * 100 + 0.114 * 30;
  for (const auto& [name, layout] : patterns) {
    for (const int type : {CV_8UC1, CV_16UC1}) {
      cv::Mat mosaic(10, 12, type);
      for (int y = 0; y < mosaic.rows; ++y) {
        for (int x = 0; x < mosaic.cols; ++x) {
          const char filter = name[(y % 2) * 2 + x % 2];
          const int value = filter == 'r' ? 200 : filter == 'g' ? 100 : 30;
          if (type == CV_8UC1) {
            mosaic.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(value);
          } else {
            mosaic.at<std::uint16_t>(y, x) = static_cast<std::uint16_t>(value * 257);
          }
        }
      }
      const cv::Mat luminance = luminance8(mosaic, layout);
      ASSERT_EQ(luminance.type(), CV_8UC1);
      EXPECT_NEAR(luminance.at<uchar>(5, 5), expected, 1) << name;
      EXPECT_NEAR(luminance.at<uchar>(4, 5), expected, 1) << name;
    }
  }
}

TEST(Luminance8, TakesTinyMosaics) {
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(2, 1), cv::Size(2, 2), cv::Size(1, 9), cv::Size(3, 3)}) {
    EXPECT_EQ(luminance8(cv::Mat(size, CV_8UC1, cv::Scalar(5)), PixelLayout::BAYER_RGGB).size(), size);
  }
}

TEST(Luminance8, RefusesWhatDoesNotFit) {
  EXPECT_THROW(luminance8(cv::Mat(2, 2, CV_8UC3), PixelLayout::GRAY), std::invalid_argument);
  EXPECT_THROW(luminance8(cv::Mat(2, 2, CV_8UC1), PixelLayout::BGR), std::invalid_argument);
  EXPECT_THROW(luminance8(cv::Mat(2, 2, CV_32FC1), PixelLayout::GRAY), std::invalid_argument);
  EXPECT_THROW(luminance8(cv::Mat(2, 2, CV_8SC1), PixelLayout::GRAY), std::invalid_argument);
}

TEST(Luminance8, LeavesItsInputAlone) {
  for (const PixelLayout layout :
       {PixelLayout::GRAY, PixelLayout::BGR, PixelLayout::RGB, PixelLayout::BGRA, PixelLayout::RGBA,
        PixelLayout::BAYER_RGGB, PixelLayout::BAYER_BGGR, PixelLayout::BAYER_GBRG, PixelLayout::BAYER_GRBG}) {
    for (const int depth : {CV_8U, CV_16U}) {
      cv::Mat image(40, 50, CV_MAKETYPE(depth, channels_of(layout)));
      cv::randu(image, 0, depth == CV_8U ? 255 : 65535);
      const cv::Mat before = image.clone();
      luminance8(image, layout);
      EXPECT_EQ(cv::norm(before, image, cv::NORM_INF), 0) << static_cast<int>(layout) << ", depth " << depth;
    }
  }
}

}  // namespace
}  // namespace gyro_deblur
