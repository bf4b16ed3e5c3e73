#include "ros/picture.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>

#include "message_builders.hpp"

namespace gyro_deblur::picture_test {
namespace {

using namespace test;

constexpr TimeNs kStampNs = 100 * kSecond;

sensor_msgs::ImagePtr copy_of(const sensor_msgs::Image& image) { return boost::make_shared<sensor_msgs::Image>(image); }

TEST(ShowSamePixels, ComparesEveryByteOfEveryEncoding) {
  for (const char* encoding : {"mono8", "mono16", "bgr8", "rgba8", "bgr16", "bayer_rggb8", "8UC1"}) {
    const sensor_msgs::ImagePtr image = image_message(kStampNs, encoding);
    EXPECT_TRUE(show_same_pixels(*image, *copy_of(*image))) << encoding;
    for (const std::size_t at : {std::size_t{0}, image->data.size() / 2, image->data.size() - 1}) {
      const sensor_msgs::ImagePtr other = copy_of(*image);
      other->data[at] ^= 1;
      EXPECT_FALSE(show_same_pixels(*image, *other)) << encoding << ", byte " << at;
    }
  }
}

TEST(ShowSamePixels, NewPicturesOfASceneAtRestDiffer) {
  EXPECT_FALSE(show_same_pixels(*image_message(kStampNs), *image_message(kStampNs + 1)));
}

TEST(ShowSamePixels, HeaderAndPaddingDoNotMatter) {
  constexpr std::uint32_t kPadding = 5;
  const sensor_msgs::ImagePtr image = image_message(kStampNs);
  const auto padded = [&image](std::uint8_t padding) {
    const sensor_msgs::ImagePtr wide = copy_of(*image);
    wide->header.seq = padding;
    wide->step += kPadding;
    wide->data.assign(std::size_t{wide->step} * wide->height, padding);
    for (std::size_t y = 0; y < image->height; ++y) {
      std::copy_n(image->data.data() + y * image->step, image->step, wide->data.data() + y * wide->step);
    }
    return wide;
  };
  EXPECT_TRUE(show_same_pixels(*padded(1), *padded(2)));
  EXPECT_TRUE(show_same_pixels(*image, *padded(3)));
  const sensor_msgs::ImagePtr other = padded(1);
  other->data[other->step] ^= 1;
  EXPECT_FALSE(show_same_pixels(*padded(1), *other));
}

TEST(ShowSamePixels, SameBytesMayMeanOtherPixels) {
  const sensor_msgs::ImagePtr image = image_message(kStampNs, "mono8");
  sensor_msgs::ImagePtr other = copy_of(*image);
  other->encoding = "bayer_rggb8";
  EXPECT_FALSE(show_same_pixels(*image, *other));
  other = copy_of(*image);
  other->width /= 2;
  other->height *= 2;
  other->step /= 2;
  EXPECT_FALSE(show_same_pixels(*image, *other));
}

TEST(PictureTracker, PictureHasTheStampOfTheFirstImageThatShowsIt) {
  PictureTracker tracker;
  const sensor_msgs::ImagePtr first = image_message(kStampNs), second = image_message(kStampNs + kSecond);
  const PictureTracker::Shown shown = tracker.add(first, kStampNs);
  EXPECT_TRUE(shown.is_new);
  for (const TimeNs later_ns : {TimeNs{0}, 25 * kMs, 10 * kSecond}) {
    const PictureTracker::Shown again = tracker.add(copy_of(*first), kStampNs + later_ns);
    EXPECT_FALSE(again.is_new);
    EXPECT_EQ(again.picture, shown.picture);
  }
  EXPECT_EQ(shown.picture->stamp_ns, kStampNs);
  const PictureTracker::Shown next = tracker.add(second, kStampNs + kSecond);
  EXPECT_TRUE(next.is_new);
  EXPECT_TRUE(tracker.add(first, kStampNs + 2 * kSecond).is_new) << "compared with the newest alone";
}

TEST(PictureTracker, TimeThatWentBackOrAForgottenPictureBeginsAnew) {
  PictureTracker tracker;
  const sensor_msgs::ImagePtr image = image_message(kStampNs);
  tracker.add(image, kStampNs);
  EXPECT_TRUE(tracker.add(copy_of(*image), kStampNs - kMs).is_new);
  tracker.forget();
  EXPECT_TRUE(tracker.add(copy_of(*image), kStampNs).is_new);
  EXPECT_EQ(image.use_count(), 1) << "nor is it kept";
}

}  // namespace
}  // namespace gyro_deblur::picture_test
