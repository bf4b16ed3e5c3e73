// The mask of the input images, from file and topic, and what is said where one is missing.
#include <filesystem>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "gyro_deblur/frame_blur.hpp"
#include "mask_file/mask_file.hpp"
#include "processor_test.hpp"

namespace gyro_deblur::processor_mask_test {
namespace {

using namespace test;

/// Half of the image is used.
cv::Mat left_half(int width = kWidth, int height = kHeight) {
  cv::Mat used(height, width, CV_8UC1, cv::Scalar(1));
  used.colRange(width / 2, width).setTo(0);
  return used;
}

sensor_msgs::ImagePtr mask_message(const cv::Mat& pixels, const std::string& encoding = "mono8") {
  sensor_msgs::Image like;
  like.encoding = encoding;
  return to_image(pixels, like);
}

class MaskTest : public ProcessorTest {
 protected:
  MaskTest() {
    folder_ = std::filesystem::path(testing::TempDir()) /
              (std::string("mask_") + testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
    request_.trust_mask = request_.tracks = true;
  }
  ~MaskTest() override { std::filesystem::remove_all(folder_); }

  std::string write(const std::string& name, const cv::Mat& image) const {
    const std::string path = (folder_ / name).string();
    EXPECT_TRUE(cv::imwrite(path, image)) << path;
    return path;
  }

  /// The next frame of a camera that rotates.
  const FrameOutput& next_output() {
    const TimeNs stamp_ns = kStart + frames_++ * 50 * kMs;
    add_imu(stamp_ns - 45 * kMs, stamp_ns + 55 * kMs);
    now_ns_ = stamp_ns + 60 * kMs;
    add_frame(stamp_ns);
    advance();
    EXPECT_EQ(outputs_.size(), static_cast<std::size_t>(frames_));
    return outputs_.back();
  }

  std::string problem(const std::string& kind) const {
    const auto problems = processor_.statistics().input_problems;
    const auto found = problems.find(kind);
    return found == problems.end() || !found->second.active ? "" : found->second.text;
  }

  /// Blocks that are MASKED are the right half's, or the left one's, or none.
  enum class Masked { NONE, LEFT, RIGHT };
  static void expect_masked(const FrameOutput& output, Masked masked) {
    ASSERT_TRUE(output.field) << output.reason_text;
    const FrameBlur& field = *output.field;
    for (int i = 0; i < field.grid.size(); ++i) {
      const bool is_right = field.grid.rect(i).x >= kWidth / 2;
      const bool expected = masked != Masked::NONE && is_right == (masked == Masked::RIGHT);
      EXPECT_EQ(field.blocks[static_cast<std::size_t>(i)].status == BlockStatus::MASKED, expected) << i;
    }
    EXPECT_EQ(output.quality->masked, masked == Masked::NONE ? 0.f : 0.5f);
    const auto is_masked = [masked](double x_px) {
      return masked != Masked::NONE && (x_px >= kWidth / 2) == (masked == Masked::RIGHT);
    };
    std::size_t used = 0;
    for (const Keypoint& keypoint : output.keypoints->keypoints) {
      EXPECT_FALSE(is_masked(keypoint.x)) << keypoint.x;
      ++used;
    }
    EXPECT_GT(used, 10u);
    for (const float u_px : output.tracks->channels[1].values) EXPECT_FALSE(is_masked(u_px)) << u_px;
    const ImageView trust = view_image(*output.trust_mask), in = view_image(*output.input),
                    out = view_image(*output.image);
    for (int x = 0; x < kWidth; ++x) {
      if (!is_masked(x)) continue;
      EXPECT_EQ(cv::countNonZero(trust.image.col(x)), 0) << x;
      EXPECT_EQ(cv::norm(in.image.col(x), out.image.col(x), cv::NORM_INF), 0) << x;
    }
  }

  std::filesystem::path folder_;
  int frames_ = 0;
};

TEST_F(MaskTest, OfAFileHolds) {
  config_.mask_file = write("mask.png", 255 * left_half());
  configure();
  expect_masked(next_output(), Masked::RIGHT);
  expect_masked(next_output(), Masked::RIGHT);
  EXPECT_GT(outputs_.back().tracks->points.size(), 0u);
  EXPECT_EQ(logged("mask"), 0u);
}

TEST_F(MaskTest, OfTheTopicReplacesTheFile) {
  config_.mask_file = write("mask.pgm", left_half());
  configure();
  expect_masked(next_output(), Masked::RIGHT);
  processor_.add_mask(*mask_message(1 - left_half()));
  expect_masked(next_output(), Masked::LEFT);
  configure();
  expect_masked(next_output(), Masked::LEFT);
  processor_.add_mask(*mask_message(cv::Mat::ones(kHeight, kWidth, CV_8UC1), "8UC1"));
  expect_masked(next_output(), Masked::NONE);
}

TEST_F(MaskTest, OfAnotherSizeIsNamedAndNotUsed) {
  config_.mask_file = write("mask.png", left_half(2 * kWidth, kHeight));
  configure();
  const FrameOutput& output = next_output();
  EXPECT_EQ(output.reason, PassThroughReason::NONE);
  expect_masked(output, Masked::NONE);
  const std::string text = problem("mask size");
  for (const char* part : {"mask.png has 384x128, the images have 192x128", "processed without it", "give one of"}) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  }
  EXPECT_EQ(logged("mask.png has 384x128"), 1u) << "with the first image";
  processor_.add_mask(*mask_message(left_half()));
  expect_masked(next_output(), Masked::RIGHT);
  EXPECT_EQ(problem("mask size"), "");
}

TEST_F(MaskTest, ThatCannotBeReadIsNamedAndNotUsed) {
  struct Bad {
    std::string path, part;
  };
  const Bad bad[] = {{(folder_ / "none.png").string(), "is no file"},
                     {write("mask.jpg", left_half()), "is a JPEG"},
                     {GYRO_DEBLUR_SOURCE_DIR "/package.xml", "is not an image"},
                     {write("black.png", cv::Mat::zeros(kHeight, kWidth, CV_8UC1)), "has no pixel above 0"}};
  for (const Bad& each : bad) {
    EXPECT_THROW(load_mask(each.path), OptionError);
    config_.mask_file = each.path;
    configure();
    expect_masked(next_output(), Masked::NONE);
    const std::string text = problem("mask file");
    EXPECT_EQ(text.find("mask = " + each.path + " " + each.part), 0u) << text;
    EXPECT_NE(text.find("give a PNG or PGM of the image's size"), std::string::npos) << text;
    EXPECT_NE(text.find("processed without it"), std::string::npos) << text;
  }
  config_.mask_file = write("good.png", left_half());
  configure();
  expect_masked(next_output(), Masked::RIGHT);
  EXPECT_EQ(problem("mask file"), "");
}

// What drawing programs write.
TEST_F(MaskTest, OfAnyKindOfPixelsIsRead) {
  const cv::Mat used = left_half(), none = cv::Mat::zeros(used.size(), CV_8UC1);
  cv::Mat deep, blue, opaque;
  used.convertTo(deep, CV_16U);
  cv::merge(std::vector<cv::Mat>{used, none, none}, blue);
  cv::merge(std::vector<cv::Mat>{none, none, used, none + 255}, opaque);
  int number = 0;
  for (const cv::Mat& image : {used, deep, blue, opaque}) {
    const PixelMask mask = load_mask(write("mask" + std::to_string(number++) + ".png", image));
    EXPECT_EQ(cv::norm(mask.pixels(), 255 * used, cv::NORM_INF), 0) << number;
  }
}

TEST_F(MaskTest, MessageThatCannotBeUsedChangesNothing) {
  processor_.add_mask(*mask_message(left_half()));
  sensor_msgs::Image cut = *mask_message(1 - left_half());
  cut.data.resize(cut.data.size() / 2);
  cv::Mat deep;
  left_half().convertTo(deep, CV_16U);
  const sensor_msgs::Image bad[] = {*mask_message(deep, "mono16"), cut,
                                    *mask_message(cv::Mat::zeros(kHeight, kWidth, CV_8UC1)), sensor_msgs::Image()};
  const char* const parts[] = {"encoding \"mono16\" is neither mono8 nor 8UC1", "image", "no pixel above 0",
                               "encoding \"\""};
  for (std::size_t i = 0; i < std::size(bad); ++i) {
    processor_.add_mask(bad[i]);
    const std::string text = problem("mask topic");
    EXPECT_NE(text.find(parts[i]), std::string::npos) << text;
    EXPECT_NE(text.find("Publish mono8 of the image's size"), std::string::npos) << text;
    expect_masked(next_output(), Masked::RIGHT);
  }
  processor_.add_mask(*mask_message(left_half()));
  EXPECT_EQ(problem("mask topic"), "");
}

// Keypoints of a frame that passes through, too.
TEST_F(MaskTest, HoldsWithoutAGyroscope) {
  processor_.add_mask(*mask_message(left_half()));
  add_frame(kStart);
  time_out();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "");
  EXPECT_GT(outputs_[0].keypoints->keypoints.size(), 10u);
  for (const Keypoint& keypoint : outputs_[0].keypoints->keypoints) EXPECT_LT(keypoint.x, kWidth / 2);
}

/// Frames of a scene that moves as the gyroscope says, behind something that does not.
class StaticContentTest : public MaskTest {
 protected:
  void play(int images) {
    constexpr int kScenePx = 3000;
    static const cv::Mat kScene = texture(CV_8UC1, kScenePx, kHeight);
    for (int i = 0; i < images; ++i) {
      const TimeNs stamp_ns = kStart + frames_ * 50 * kMs;
      // A rotation to the right moves the scene to the left, by 15 px each time.
      const int x = static_cast<int>(std::lround(kFocalPx * kFastRadS * 0.05 * frames_++)) % (kScenePx - kWidth);
      cv::Mat view = kScene(cv::Rect(x, 0, kWidth, kHeight)).clone();
      if (bumper_) view(cv::Rect(32, 80, 120, 48)).setTo(240);
      add_imu(stamp_ns - 45 * kMs, stamp_ns + 55 * kMs);
      now_ns_ = stamp_ns + 60 * kMs;
      sensor_msgs::ImagePtr image = image_message(stamp_ns);
      image = to_image(view, *image);
      processor_.add_image(image);
      processor_.add_camera_info(camera_info(stamp_ns));
      advance();
    }
  }
  bool bumper_ = true;
};

TEST_F(StaticContentTest, IsReportedWithTheRemedyWithinFiveSeconds) {
  play(100);
  const std::string text = problem("static content");
  EXPECT_NE(text.find(" % of the image does not move with the camera"), std::string::npos) << text;
  EXPECT_NE(text.find("Set mask, or publish the topic mask: mono8 of 192x128"), std::string::npos) << text;
  EXPECT_EQ(logged("does not move with the camera"), 1u);
  EXPECT_GT(outputs_.back().field->count(BlockStatus::STATIC_EDGE), 3u);
  EXPECT_GT(outputs_.back().quality->static_edge, 0.1f);
  cv::Mat used(kHeight, kWidth, CV_8UC1, cv::Scalar(1));
  used(cv::Rect(32, 80, 120, 48)).setTo(0);
  processor_.add_mask(*mask_message(used));
  play(100);
  EXPECT_EQ(problem("static content"), "");
}

TEST_F(StaticContentTest, OfTheSceneIsNotReported) {
  bumper_ = false;
  play(150);
  EXPECT_EQ(logged("does not move with the camera"), 0u);
  EXPECT_EQ(outputs_.back().field->count(BlockStatus::STATIC_EDGE), 0u);
}

}  // namespace
}  // namespace gyro_deblur::processor_mask_test
