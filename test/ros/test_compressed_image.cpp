#include "ros/compressed_image.hpp"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "message_builders.hpp"

namespace gyro_deblur::compressed_image_test {
namespace {

using namespace test;

sensor_msgs::CompressedImage compressed(const cv::Mat& pixels, const std::string& extension,
                                        const std::string& format) {
  sensor_msgs::CompressedImage message;
  message.header.stamp = to_ros_time(kSecond);
  message.header.frame_id = kCameraFrame;
  message.format = format;
  cv::imencode(extension, pixels, message.data);
  return message;
}

/// One colour: red 200, green 100, blue 30, or the grey level 100; of 16 bits these times 257.
cv::Mat in_order(const std::string& order, int depth = CV_8U) {
  const double scale = depth == CV_16U ? 257 : 1;
  cv::Scalar levels;
  for (std::size_t i = 0; i < order.size(); ++i) {
    const char channel = order[i];
    levels[static_cast<int>(i)] = scale * (channel == 'r' ? 200 : channel == 'b' ? 30 : channel == 'a' ? 255 : 100);
  }
  return cv::Mat(16, 24, CV_MAKETYPE(depth, static_cast<int>(order.size())), levels);
}

struct FormatCase {
  const char* format;
  const char* extension;
  cv::Mat file;  ///< as cv::imencode takes it, so that the file shows its colours in BGR order
  const char* encoding;
  cv::Mat expected;
};

TEST(DecodeImage, GivesWhatImageTransportsSubscriberGives) {
  const FormatCase cases[] = {
      {"rgb8; jpeg compressed bgr8", ".jpg", in_order("bgr"), "rgb8", in_order("rgb")},
      {"rgb8; jpeg compressed rgb8", ".jpg", in_order("rgb"), "rgb8", in_order("rgb")},
      {"rgb8; jpeg compressed ", ".jpg", in_order("rgb"), "rgb8", in_order("rgb")},
      {"bgr8; jpeg compressed bgr8", ".jpg", in_order("bgr"), "bgr8", in_order("bgr")},
      {"bgr8; jpeg compressed rgb8", ".jpg", in_order("rgb"), "bgr8", in_order("bgr")},
      {"rgba8; jpeg compressed bgr8", ".jpg", in_order("bgr"), "rgba8", in_order("rgba")},
      {"bgra8; png compressed bgr8", ".png", in_order("bgr"), "bgra8", in_order("bgra")},
      {"bgra8; png compressed rgb8", ".png", in_order("rgb"), "bgra8", in_order("bgra")},
      {"rgb16; png compressed bgr16", ".png", in_order("bgr", CV_16U), "rgb16", in_order("rgb", CV_16U)},
      {"mono8; jpeg compressed ", ".jpg", in_order("g"), "mono8", in_order("g")},
      {"mono8; png compressed ", ".png", in_order("g"), "mono8", in_order("g")},
      {"mono16; png compressed ", ".png", in_order("g", CV_16U), "mono16", in_order("g", CV_16U)},
      {"16UC1; png compressed ", ".png", in_order("g", CV_16U), "16UC1", in_order("g", CV_16U)},
      {"8UC1; png compressed ", ".png", in_order("g"), "8UC1", in_order("g")},
      {"8UC3; jpeg compressed ", ".jpg", in_order("bgr"), "8UC3", in_order("bgr")},
      {"bayer_rggb8; jpeg compressed ", ".jpg", in_order("g"), "bayer_rggb8", in_order("g")},
      {"bayer_grbg16; png compressed ", ".png", in_order("g", CV_16U), "bayer_grbg16", in_order("g", CV_16U)},
      // Names that say nothing of the colours' order.
      {"jpeg", ".jpg", in_order("bgr"), "bgr8", in_order("bgr")},
      {"png", ".png", in_order("bgra"), "bgra8", in_order("bgra")},
      {"rgb8", ".jpg", in_order("bgr"), "bgr8", in_order("bgr")},
      {"", ".png", in_order("g", CV_16U), "mono16", in_order("g", CV_16U)},
      // Names that do not fit the pixels.
      {"rgb16; jpeg compressed bgr8", ".jpg", in_order("bgr"), "rgb8", in_order("rgb")},
      {"mono16; jpeg compressed mono8", ".jpg", in_order("g"), "mono8", in_order("g")},
      {"rgb8; jpeg compressed bgr8", ".jpg", in_order("g"), "mono8", in_order("g")},
      {"mono8; jpeg compressed ", ".jpg", in_order("bgr"), "bgr8", in_order("bgr")},
      {"yuv422; jpeg compressed ", ".jpg", in_order("bgr"), "bgr8", in_order("bgr")},
      {"nonsense; png", ".png", in_order("bgr"), "bgr8", in_order("bgr")},
  };
  for (const FormatCase& each : cases) {
    const sensor_msgs::CompressedImage message = compressed(each.file, each.extension, each.format);
    const DecodedImage decoded = decode_image(message);
    ASSERT_NE(decoded.image, nullptr) << each.format;
    EXPECT_EQ(decoded.problem, "") << each.format;
    EXPECT_EQ(decoded.image->encoding, each.encoding) << each.format;
    EXPECT_EQ(decoded.image->header, message.header) << each.format;
    const cv::Mat pixels = view_image(*decoded.image).image;
    ASSERT_EQ(pixels.type(), each.expected.type()) << each.format;
    ASSERT_EQ(pixels.size(), each.expected.size()) << each.format;
    EXPECT_LE(cv::norm(pixels, each.expected, cv::NORM_INF), std::string(each.extension) == ".jpg" ? 3 : 0)
        << each.format;
  }
}

TEST(DecodeImage, RefusesWhatIsNoImage) {
  const sensor_msgs::CompressedImage whole = compressed(texture(), ".jpg", "mono8; jpeg compressed ");
  sensor_msgs::CompressedImage garbage = whole, empty = whole, header_cut = whole, png_cut, depth = whole;
  for (std::size_t i = 0; i < garbage.data.size(); ++i) garbage.data[i] = static_cast<std::uint8_t>(i * 37);
  empty.data.clear();
  header_cut.data.resize(30);
  png_cut = compressed(texture(), ".png", "mono8; png compressed ");
  png_cut.data.resize(png_cut.data.size() / 2);
  depth.format = "16UC1; compressedDepth";
  for (const auto& message : {garbage, empty, header_cut, png_cut, depth}) {
    const DecodedImage decoded = decode_image(message);
    EXPECT_EQ(decoded.image, nullptr) << decoded.problem;
    EXPECT_NE(decoded.problem.find(std::to_string(message.data.size()) + " bytes"), std::string::npos)
        << decoded.problem;
    EXPECT_NE(decoded.problem.find(message.format), std::string::npos) << decoded.problem;
  }
}

TEST(DecodeImage, SaysThatAJpegIsCut) {
  for (const int type : {CV_8UC1, CV_8UC3}) {
    const sensor_msgs::CompressedImage whole = compressed(texture(type), ".jpg", "jpeg");
    const cv::Mat expected = view_image(*decode_image(whole).image).image.clone();
    for (int eighth = 2; eighth < 8; ++eighth) {
      sensor_msgs::CompressedImage cut = whole;
      cut.data.resize(whole.data.size() * static_cast<std::size_t>(eighth) / 8);
      const DecodedImage decoded = decode_image(cut), again = decode_image(cut);
      ASSERT_NE(decoded.image, nullptr) << eighth;
      EXPECT_NE(decoded.problem.find("ends after " + std::to_string(cut.data.size()) + " bytes"), std::string::npos)
          << decoded.problem;
      EXPECT_EQ(decoded.image->data, again.image->data) << "nothing of what the memory held before";
      const cv::Mat pixels = view_image(*decoded.image).image;
      ASSERT_EQ(pixels.size(), expected.size());
      // Of a texture each row of blocks takes about as many bytes; the tables before them some hundred.
      const int rows = (eighth - 2) * kHeight / 8;
      if (rows > 0) {
        EXPECT_EQ(cv::norm(pixels.rowRange(0, rows), expected.rowRange(0, rows), cv::NORM_INF), 0);
      }
    }
  }
}

TEST(DecodeImage, TakesAJpegThatLacksTheEndMarkerAlone) {
  const sensor_msgs::CompressedImage whole = compressed(texture(CV_8UC3), ".jpg", "jpeg");
  sensor_msgs::CompressedImage unmarked = whole;
  ASSERT_EQ(unmarked.data.back(), 0xD9);
  unmarked.data.resize(unmarked.data.size() - 2);
  const DecodedImage decoded = decode_image(unmarked);
  EXPECT_EQ(decoded.problem, "");
  EXPECT_EQ(decoded.image->data, decode_image(whole).image->data);
  // What a driver's buffer has behind the image.
  sensor_msgs::CompressedImage padded = whole;
  padded.data.resize(padded.data.size() + 512);
  EXPECT_EQ(decode_image(padded).problem, "");
}

TEST(DecodeImage, EndOfAPreviewIsNotThatOfTheImage) {
  sensor_msgs::CompressedImage message = compressed(texture(), ".jpg", "jpeg");
  const std::vector<std::uint8_t> preview = compressed(in_order("g"), ".jpg", "jpeg").data;
  const std::size_t length = preview.size() + 2;
  std::vector<std::uint8_t> segment = {0xFF, 0xE1, static_cast<std::uint8_t>(length >> 8),
                                       static_cast<std::uint8_t>(length & 0xFF)};
  segment.insert(segment.end(), preview.begin(), preview.end());
  message.data.insert(message.data.begin() + 2, segment.begin(), segment.end());
  EXPECT_EQ(decode_image(message).problem, "");
  message.data.resize(message.data.size() * 2 / 3);
  EXPECT_NE(decode_image(message).problem, "");
}

}  // namespace
}  // namespace gyro_deblur::compressed_image_test
