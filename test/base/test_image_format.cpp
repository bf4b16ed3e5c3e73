#include "gyro_deblur/image_format.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur::image_format_test {
namespace {

TEST(LayoutOfEncoding, KnowsEveryEncodingThatCanBeDeblurred) {
  const std::pair<const char*, PixelLayout> expected[] = {
      {"mono8", PixelLayout::GRAY},
      {"mono16", PixelLayout::GRAY},
      {"8UC1", PixelLayout::GRAY},
      {"16UC1", PixelLayout::GRAY},
      {"bgr8", PixelLayout::BGR},
      {"bgr16", PixelLayout::BGR},
      {"8UC3", PixelLayout::BGR},
      {"16UC3", PixelLayout::BGR},
      {"yuv422", PixelLayout::YUV422_UYVY},
      {"uyvy", PixelLayout::YUV422_UYVY},
      {"yuv422_yuy2", PixelLayout::YUV422_YUYV},
      {"yuyv", PixelLayout::YUV422_YUYV},
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
    EXPECT_EQ(is_yuv422(layout), std::string(encoding).find('y') < 2) << encoding;
    EXPECT_EQ(shares_colors(layout), is_bayer(layout) || is_yuv422(layout)) << encoding;
  }
  for (const char* encoding : {"", "MONO8", "mono32", "32FC1", "8UC2", "8UC4", "yuv420", "nv21", "jpeg"}) {
    EXPECT_FALSE(layout_of_encoding(encoding).has_value()) << encoding;
  }
}

TEST(ChannelsOf, FollowsTheLayout) {
  EXPECT_EQ(channels_of(PixelLayout::GRAY), 1);
  EXPECT_EQ(channels_of(PixelLayout::BAYER_GBRG), 1);
  EXPECT_EQ(channels_of(PixelLayout::YUV422_UYVY), 2);
  EXPECT_EQ(channels_of(PixelLayout::YUV422_YUYV), 2);
  EXPECT_EQ(channels_of(PixelLayout::BGR), 3);
  EXPECT_EQ(channels_of(PixelLayout::RGBA), 4);
}

TEST(Luminance8, ReturnsGreyWithoutACopy) {
  const cv::Mat grey(5, 7, CV_8UC1, cv::Scalar(9));
  EXPECT_EQ(luminance8(grey, PixelLayout::GRAY).data, grey.data);
}

TEST(Luminance8, DistinguishesChannelOrders) {
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

TEST(Luminance8, OfYuv422IsItsOwnByte) {
  // Two pixels of luminance 90 and 160; U 60, V 210.
  cv::Mat uyvy(4, 6, CV_8UC2), yuyv(4, 6, CV_8UC2);
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 6; ++x) {
      const auto chroma = static_cast<uchar>(x % 2 == 0 ? 60 : 210), light = static_cast<uchar>(x % 2 == 0 ? 90 : 160);
      uyvy.at<cv::Vec2b>(y, x) = {chroma, light};
      yuyv.at<cv::Vec2b>(y, x) = {light, chroma};
    }
  }
  for (const auto& [image, layout] :
       {std::pair(uyvy, PixelLayout::YUV422_UYVY), std::pair(yuyv, PixelLayout::YUV422_YUYV)}) {
    const cv::Mat luminance = luminance8(image, layout);
    ASSERT_EQ(luminance.type(), CV_8UC1);
    EXPECT_EQ(luminance.at<uchar>(2, 2), 90);
    EXPECT_EQ(luminance.at<uchar>(2, 3), 160);
    // ITU-R BT.601, of 16 to 235: R = 1.164 (Y - 16) + 1.596 (V - 128), B = 1.164 (Y - 16) + 2.018 (U - 128).
    const cv::Vec3b bgr = to_bgr(image, layout).at<cv::Vec3b>(2, 2);
    EXPECT_NEAR(bgr[2], 1.164 * 74 + 1.596 * 82, 2);
    EXPECT_NEAR(bgr[0], std::max(0.0, 1.164 * 74 - 2.018 * 68), 2);
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

TEST(Luminance8, DoesNotChangeItsInput) {
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

cv::Mat deep(const std::vector<int>& values) {
  cv::Mat image(1, static_cast<int>(values.size()), CV_16UC1);
  for (int x = 0; x < image.cols; ++x) image.at<std::uint16_t>(0, x) = static_cast<std::uint16_t>(values[x]);
  return image;
}

TEST(BitDepthOf, IsTheFewestThatHoldEveryPixelSoFar) {
  struct Case {
    std::vector<int> values;
    int bits;
  };
  const Case cases[] = {{{0, 1023, 5}, 10},
                        {{1, 0}, 10},
                        {{0, 1024, 5}, 12},
                        {{4095, 7}, 12},
                        {{4096, 7}, 14},
                        {{16383}, 14},
                        {{16384, 1}, 16},
                        {{65535}, 16},
                        {{0, 0}, 16},
                        // Aligned to the high bits: 12 and 14 bits, bright and dark.
                        {{4095 << 4, 3 << 4}, 16},
                        {{40 << 4, 3 << 4}, 16},
                        {{16383 << 2, 1 << 2}, 16},
                        {{21 << 2}, 16}};
  for (const Case& c : cases) EXPECT_EQ(BitDepth().of(deep(c.values), PixelLayout::GRAY), c.bits) << c.values[0];
}

TEST(BitDepthOf, GrowsAloneAndSaysSoOnce) {
  BitDepth depth;
  EXPECT_EQ(depth.take_message(), "");
  const auto of = [&depth](int value) { return depth.of(deep({value, 1, 2}), PixelLayout::GRAY); };
  EXPECT_EQ(of(700), 10);
  EXPECT_NE(depth.take_message().find("have 10 significant bits"), std::string::npos);
  EXPECT_EQ(of(3000), 12);
  for (const int darker : {10, 700, 4095, 2}) EXPECT_EQ(of(darker), 12);
  EXPECT_NE(depth.take_message().find("have 12 significant bits"), std::string::npos);
  EXPECT_EQ(depth.take_message(), "");
  EXPECT_EQ(of(65535), 16);
  EXPECT_EQ(of(700), 16);
}

TEST(BitDepthOf, IsWhatWasGiven) {
  for (const int given : {8, 11, 16}) {
    BitDepth depth(given);
    EXPECT_EQ(depth.of(deep({700, 1}), PixelLayout::GRAY), given);
    EXPECT_EQ(depth.of(cv::Mat(2, 2, CV_8UC1, cv::Scalar(9)), PixelLayout::GRAY), 8);
    EXPECT_EQ(depth.take_message(), "");
  }
  for (const int bad : {-1, 1, 7, 17}) EXPECT_THROW(BitDepth{bad}, OptionError);
}

TEST(BitDepthOf, IsThatOfColoursAlone) {
  EXPECT_EQ(BitDepth().of(cv::Mat(2, 2, CV_16UC4, cv::Scalar(5, 6, 7, 65535)), PixelLayout::BGRA), 10);
  EXPECT_EQ(BitDepth().of(cv::Mat(2, 2, CV_16UC3, cv::Scalar(5, 6, 4095)), PixelLayout::RGB), 12);
  EXPECT_EQ(BitDepth().of(cv::Mat(4, 4, CV_16UC1, cv::Scalar(4095)), PixelLayout::BAYER_RGGB), 12);
}

TEST(Luminance8, TakesFullScaleOfTheSignificantBitsToFullScale) {
  for (int bits = 8; bits <= 16; ++bits) {
    const int full = (1 << bits) - 1;
    const cv::Mat luminance = luminance8(deep({0, full / 2, full, std::min(full + 1, 65535)}), PixelLayout::GRAY, bits);
    EXPECT_EQ(luminance.at<uchar>(0, 0), 0);
    EXPECT_NEAR(luminance.at<uchar>(0, 1), 127.5, 0.5) << bits;
    EXPECT_EQ(luminance.at<uchar>(0, 2), 255) << bits;
    EXPECT_EQ(luminance.at<uchar>(0, 3), 255) << bits;
  }
}

TEST(KeepRange, TakesBackWhatFilteringAdded) {
  cv::Mat output = deep({0, 4095, 4096, 60000, 5000, 4999});
  keep_range(deep({0, 9, 4095, 4000, 5000, 5000}), 12, output);
  EXPECT_EQ(cv::norm(output, deep({0, 4095, 4095, 4095, 5000, 4999}), cv::NORM_INF), 0);
  cv::Mat alpha(1, 1, CV_16UC4, cv::Scalar(5000, 7, 7, 65535));
  keep_range(cv::Mat(1, 1, CV_16UC4, cv::Scalar(4000, 7, 7, 65535)), 12, alpha);
  EXPECT_EQ(alpha.at<cv::Vec4w>(0, 0), cv::Vec4w(4095, 7, 7, 65535));
  cv::Mat whole = deep({65535});
  keep_range(deep({1}), 16, whole);
  EXPECT_EQ(whole.at<std::uint16_t>(0, 0), 65535);
}

}  // namespace
}  // namespace gyro_deblur::image_format_test
