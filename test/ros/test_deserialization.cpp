#include "ros/deserialization.hpp"

#include <string>

#include <gtest/gtest.h>
#include <tf2_msgs/TFMessage.h>

#include "message_builders.hpp"
#include "spoilt_message.hpp"

namespace gyro_deblur::deserialization_test {
namespace {

using namespace test;

/// What reading the message throws; empty when it is read.
template <typename Message>
std::string error_of(const std::vector<std::uint8_t>& bytes, Message* message) {
  try {
    deserialize_checked(bytes.data(), bytes.size(), message);
  } catch (const std::exception& error) {
    return error.what();
  }
  return {};
}

TEST(DeserializeChecked, ReadsWhatRoscppWrites) {
  const sensor_msgs::CameraInfoPtr info = camera_info(5 * kSecond);
  sensor_msgs::CameraInfo read;
  EXPECT_EQ(error_of(bytes_of(*info), &read), "");
  EXPECT_EQ(read, *info);

  tf2_msgs::TFMessage transforms, read_transforms;  // an array of messages
  transforms.transforms.resize(3);
  transforms.transforms[1].child_frame_id = "imu";
  transforms.transforms[2].transform.rotation.w = 1;
  EXPECT_EQ(error_of(bytes_of(transforms), &read_transforms), "");
  EXPECT_EQ(read_transforms, transforms);

  const sensor_msgs::ImagePtr image = image_message(kSecond);
  sensor_msgs::Image read_image;
  EXPECT_EQ(error_of(bytes_of(*image), &read_image), "");
  EXPECT_EQ(read_image, *image);
}

// roscpp's own stream asks for 8 GiB, and takes 2^29 + 1 doubles for 8 bytes.
TEST(DeserializeChecked, ArraysThatAreNotThereCostNoMemory) {
  for (const std::uint32_t announced : {6u + 1000u, (1u << 29) + 1, 1u << 30, 0xffffffffu}) {
    std::vector<std::uint8_t> bytes = bytes_of(*camera_info(kSecond));
    announce<double>(5, announced)(&bytes);
    sensor_msgs::CameraInfo info;
    const std::string error = error_of(bytes, &info);
    EXPECT_NE(error.find("an array of " + std::to_string(announced) + " elements is announced where "),
              std::string::npos)
        << error;
    EXPECT_LE(info.D.capacity(), 5u);
  }
  std::vector<std::uint8_t> bytes = bytes_of(*image_message(kSecond));
  announce<std::uint8_t>(kWidth * kHeight, kWidth * kHeight + 1)(&bytes);
  sensor_msgs::Image image;
  EXPECT_NE(error_of(bytes, &image).find("is announced where 24576 bytes are left"), std::string::npos);
}

TEST(DeserializeChecked, EveryCutIsAnError) {
  const std::vector<std::uint8_t> whole = bytes_of(*camera_info(kSecond));
  for (std::size_t size = 0; size < whole.size(); ++size) {
    std::vector<std::uint8_t> cut(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    cut.reserve(1);
    sensor_msgs::CameraInfo info;
    EXPECT_NE(error_of(cut, &info), "") << size;
  }
}

}  // namespace
}  // namespace gyro_deblur::deserialization_test
