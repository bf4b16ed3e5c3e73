// The table is worth what its accounting finds.
#include "frame_accounting.hpp"

#include <utility>

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>

#include "gyro_deblur/frame_blur.hpp"
#include "ros/conversions.hpp"

namespace gyro_deblur::test {
namespace {

constexpr TimeNs kMs = 1'000'000;
constexpr int kSize = 32, kBlock = 16;

sensor_msgs::ImageConstPtr image(TimeNs stamp_ns) {
  sensor_msgs::Image like;
  like.header.stamp = to_ros_time(stamp_ns);
  like.encoding = "mono8";
  return to_image(cv::Mat(kSize, kSize, CV_8UC1, cv::Scalar(100)), like);
}

/// What a processor that passes everything through would give out.
FrameOutput passed_through(const sensor_msgs::ImageConstPtr& input) {
  FrameOutput output;
  output.input = output.image = input;
  output.camera_info = uncalibrated_camera_info(*input);
  output.reason = PassThroughReason::NO_GYRO;
  output.blur_field = pass_through_message(output.reason, "", *input);
  return output;
}

/// The left blocks were deblurred.
FrameOutput deblurred(const sensor_msgs::ImageConstPtr& input, int changed_column) {
  FrameOutput output = passed_through(input);
  output.reason = PassThroughReason::NONE;
  output.field.emplace();
  output.field->grid = BlockGrid(kSize, kSize, kBlock);
  output.field->blocks.resize(4);
  output.field->blocks[0].status = output.field->blocks[2].status = BlockStatus::DEBLURRED;
  auto changed = boost::make_shared<sensor_msgs::Image>(*input);
  changed->data[static_cast<std::size_t>(changed_column)] = 7;
  output.image = changed;
  return output;
}

class FrameAccountingTest : public testing::Test {
 protected:
  void give(int frames) {
    for (int i = 0; i < frames; ++i) {
      inputs_.push_back(image((100 + i) * kMs));
      accounting_.in(inputs_.back());
    }
  }
  Balance balance() {
    inputs_.clear();
    return accounting_.balance();
  }

  std::vector<sensor_msgs::ImageConstPtr> inputs_;
  FrameAccounting accounting_;
};

TEST_F(FrameAccountingTest, GoodRunIsGood) {
  give(3);
  accounting_.out(passed_through(inputs_[0]));
  accounting_.out(deblurred(inputs_[1], kBlock - 1));
  accounting_.out(passed_through(inputs_[2]));
  const Balance result = balance();
  EXPECT_TRUE(result.good());
  EXPECT_EQ(result.frames_in, 3u);
  EXPECT_EQ(result.frames_out, 3u);
  EXPECT_EQ(result.deblurred, 1u);
  EXPECT_EQ(result.passed_through.at(PassThroughReason::NO_GYRO), 2u);
}

TEST_F(FrameAccountingTest, LostFrame) {
  give(3);
  accounting_.out(passed_through(inputs_[0]));
  accounting_.out(passed_through(inputs_[2]));
  const Balance result = balance();
  EXPECT_EQ(result.lost, 1u);
  EXPECT_EQ(result.reordered, 1u) << "the one after it came too early";
}

TEST_F(FrameAccountingTest, SwappedFrames) {
  give(2);
  accounting_.out(passed_through(inputs_[1]));
  accounting_.out(passed_through(inputs_[0]));
  const Balance result = balance();
  EXPECT_EQ(result.lost, 0u);
  EXPECT_EQ(result.reordered, 2u);
}

TEST_F(FrameAccountingTest, RepeatedAndInventedFrames) {
  give(1);
  accounting_.out(passed_through(inputs_[0]));
  accounting_.out(passed_through(inputs_[0]));
  accounting_.out(passed_through(image(5 * kMs)));
  EXPECT_EQ(balance().repeated, 2u);
}

TEST_F(FrameAccountingTest, MessageThatIsGivenTwiceLeavesTwice) {
  give(1);
  accounting_.in(inputs_[0]);
  accounting_.out(passed_through(inputs_[0]));
  accounting_.out(passed_through(inputs_[0]));
  EXPECT_TRUE(balance().good());
}

TEST_F(FrameAccountingTest, AlteredPixels) {
  give(3);
  FrameOutput output = passed_through(inputs_[0]);
  output.image = deblurred(inputs_[0], 3).image;
  accounting_.out(output);
  accounting_.out(deblurred(inputs_[1], kBlock));
  const_cast<sensor_msgs::Image&>(*inputs_[2]).data[5] = 9;  // the input itself
  accounting_.out(passed_through(inputs_[2]));
  EXPECT_EQ(balance().altered, 3u);
}

TEST_F(FrameAccountingTest, WrongStamp) {
  give(1);
  FrameOutput output = passed_through(inputs_[0]);
  output.blur_field->header.stamp = to_ros_time(kMs);
  accounting_.out(output);
  EXPECT_EQ(balance().misstamped, 1u);
}

TEST_F(FrameAccountingTest, RetainedMessage) {
  give(1);
  const FrameOutput kept = passed_through(inputs_[0]);
  accounting_.out(kept);
  EXPECT_EQ(balance().retained, 1u);
}

}  // namespace
}  // namespace gyro_deblur::test
