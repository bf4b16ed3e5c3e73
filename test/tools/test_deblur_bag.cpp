// deblur_bag as a user runs it.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <dynamic_reconfigure/Config.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CompressedImage.h>
#include <tf2_msgs/TFMessage.h>
#include <topic_tools/shape_shifter.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "message_builders.hpp"
#include "ros/messages.hpp"
#include "ros/processor.hpp"
#include "run_program.hpp"
#include "spoilt_message.hpp"

namespace gyro_deblur {
namespace {

using namespace test;
namespace fs = std::filesystem;

constexpr TimeNs kStart = 100 * kSecond;
constexpr TimeNs kFramePeriod = 100 * kMs;
constexpr int kFrames = 5;

class DeblurBagTest : public testing::Test {
 protected:
  DeblurBagTest() {
    std::string pattern = (fs::temp_directory_path() / "deblur_bag_XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no temporary directory");
    directory_ = pattern;
    write_config("");
  }
  ~DeblurBagTest() override { fs::remove_all(directory_); }

  std::string path(const std::string& name) const { return (directory_ / name).string(); }

  /// The keys of test_config(), and more.
  void write_config(const std::string& more) {
    std::ofstream(path("config.yaml"))
        << "exposure_time: 0.03\nreadout_time: 0.02\nR_cam_imu: [1,0,0,0,1,0,0,0,1]\n"
           "block_size: 32\nvalidation: none\noptical_flow: false\nkeypoint_detector: FAST\nkeypoint_descriptor: ORB\n"
        << more;
  }

  /// Rewrites in.bag; `write` gets each of its messages and the new bag.
  void change_bag(const std::function<void(const rosbag::MessageInstance&, rosbag::Bag*)>& write) {
    fs::rename(path("in.bag"), path("before.bag"));
    {
      rosbag::Bag before(path("before.bag"), rosbag::bagmode::Read), bag(path("in.bag"), rosbag::bagmode::Write);
      for (const rosbag::MessageInstance& instance : rosbag::View(before)) write(instance, &bag);
    }
    fs::remove(path("before.bag"));
  }
  /// Changes the messages of one type; `change` gets each and its number, and leaves it out when it returns false.
  template <typename Message>
  void change_messages(const std::function<bool(Message*, int)>& change) {
    int count = 0;
    change_bag([&](const rosbag::MessageInstance& instance, rosbag::Bag* bag) {
      const auto message = instance.instantiate<Message>();
      if (!message) {
        bag->write(instance.getTopic(), instance.getTime(), instance);
      } else if (change(message.get(), count++)) {
        bag->write(instance.getTopic(), instance.getTime(), *message);
      }
    });
  }
  /// Compresses the images; `change` gets each compressed one and its number.
  void compress_images(const std::string& extension, const std::string& format,
                       const std::function<void(sensor_msgs::CompressedImage*, int)>& change) {
    int count = 0;
    change_bag([&](const rosbag::MessageInstance& instance, rosbag::Bag* bag) {
      const auto image = instance.instantiate<sensor_msgs::Image>();
      if (!image) {
        bag->write(instance.getTopic(), instance.getTime(), instance);
        return;
      }
      sensor_msgs::CompressedImage compressed;
      compressed.header = image->header;
      compressed.format = format;
      cv::imencode(extension, view_image(*image).image, compressed.data);
      change(&compressed, count++);
      bag->write("/cam/image_raw/compressed", instance.getTime(), compressed);
    });
  }
  /// A calibration file of the bag's camera.
  void write_calibration_file() {
    const sensor_msgs::CameraInfoPtr info = camera_info(kStart);
    std::ofstream(path("camchain.yaml")) << "cam0:\n  camera_model: pinhole\n  intrinsics: [" << info->K[0] << ", "
                                         << info->K[4] << ", " << info->K[2] << ", " << info->K[5]
                                         << "]\n  distortion_model: none\n  distortion_coeffs: []\n  resolution: ["
                                         << info->width << ", " << info->height << "]\n";
  }

  /// Frames and IMU; the IMU ends 60 ms before the last frame does.
  void write_bag(double rate_rad_s, bool with_exposure = false) {
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Write);
    const auto at = [](TimeNs t_ns) { return to_ros_time(t_ns); };
    const TimeNs last_imu_ns = kStart + (kFrames - 1) * kFramePeriod - 10 * kMs;
    for (TimeNs t_ns = kStart - 2 * kSecond; t_ns <= last_imu_ns; t_ns += 5 * kMs) {
      bag.write("/imu", at(t_ns), imu_message(t_ns, rate_rad_s));
    }
    for (int i = 0; i < kFrames; ++i) {
      const TimeNs t_ns = kStart + i * kFramePeriod;
      bag.write("/cam/image_raw", at(t_ns), *image_message(t_ns));
      bag.write("/cam/camera_info", at(t_ns), *camera_info(t_ns));
      if (!with_exposure) continue;
      Exposure exposure;
      exposure.header.stamp = at(t_ns);
      exposure.exposure_time.fromNSec(20 * kMs);
      bag.write("/cam/exposure", at(t_ns), exposure);
    }
    std_msgs::Header other;
    bag.write("/other", at(kStart), other);
  }

  ProgramResult run(std::vector<std::string> more = {}) const {
    std::vector<std::string> command{DEBLUR_BAG,          path("in.bag"), path("out.bag"),    "--config",
                                     path("config.yaml"), "--json",       path("report.json")};
    command.insert(command.end(), more.begin(), more.end());
    return run_program(command);
  }

  nlohmann::json report() const { return nlohmann::json::parse(std::ifstream(path("report.json"))); }

  template <typename Message>
  std::vector<boost::shared_ptr<Message>> read(const std::string& bag_name, const std::string& topic) const {
    rosbag::Bag bag(path(bag_name), rosbag::bagmode::Read);
    rosbag::View view(bag, rosbag::TopicQuery(topic));
    std::vector<boost::shared_ptr<Message>> messages;
    for (const rosbag::MessageInstance& instance : view) messages.push_back(instance.instantiate<Message>());
    return messages;
  }

  void expect_error(const ProgramResult& result, const std::vector<std::string>& parts) const {
    EXPECT_EQ(result.exit_code, 1) << result.output;
    EXPECT_EQ(std::count(result.output.begin(), result.output.end(), '\n'), 1) << "one line: " << result.output;
    for (const std::string& part : parts) EXPECT_NE(result.output.find(part), std::string::npos) << result.output;
    EXPECT_FALSE(fs::exists(path("out.bag")));
    EXPECT_FALSE(fs::exists(path("out.bag.part")));
  }

  fs::path directory_;
};

TEST_F(DeblurBagTest, CompressedImagesAreDecoded) {
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  const auto expected = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  // The same bag with PNGs, which lose nothing, in place of the images.
  compress_images(".png", "mono8; png compressed ", [](auto*, int) {});
  const ProgramResult result = run();
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  ASSERT_EQ(images.size(), expected.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    EXPECT_EQ(images[i]->header.stamp, expected[i]->header.stamp);
    EXPECT_EQ(images[i]->encoding, "mono8");
    EXPECT_EQ(images[i]->data, expected[i]->data);
  }
  EXPECT_EQ(report()["undecodable_images"], 0);
}

TEST_F(DeblurBagTest, WhatCannotBeDecodedIsLeftOutAndMovesNothingElse) {
  write_bag(kFastRadS, true);
  change_messages<Exposure>([](Exposure* exposure, int i) {
    exposure->exposure_time.fromNSec((20 + i) * kMs);
    return true;
  });
  compress_images(".jpg", "mono8; jpeg compressed ", [](sensor_msgs::CompressedImage* image, int i) {
    if (i == 1) std::fill(image->data.begin(), image->data.end(), 7);
    if (i == 3) image->data.resize(image->data.size() / 2);
  });
  write_config("drop_poor: true\n");
  const ProgramResult result = run();
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_NE(result.output.find("1 more left out: they could not be decoded"), std::string::npos) << result.output;
  EXPECT_NE(result.output.find("warning: compressed image 100.100000000 is left out: "), std::string::npos);
  const nlohmann::json all = report();
  EXPECT_EQ(all["frames_in"], kFrames - 1);
  EXPECT_EQ(all["frames_out"], kFrames - 1);
  EXPECT_EQ(all["dropped_poor"], 0);
  EXPECT_EQ(all["undecodable_images"], 1);
  EXPECT_EQ(all["passed_through"], (nlohmann::json{{"BAD_IMAGE", 1}, {"NO_GYRO", 1}})) << "the IMU ends too early";
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  const auto infos = read<sensor_msgs::CameraInfo>("out.bag", "/cam/deblurred/camera_info");
  const auto fields = read<BlurField>("out.bag", "/cam/blur_field");
  ASSERT_EQ(images.size(), static_cast<std::size_t>(kFrames - 1));
  ASSERT_EQ(infos.size(), images.size());
  ASSERT_EQ(fields.size(), images.size());
  const int numbers[] = {0, 2, 3, 4};
  for (std::size_t i = 0; i < images.size(); ++i) {
    const TimeNs stamp_ns = kStart + numbers[i] * kFramePeriod;
    EXPECT_EQ(to_time_ns(images[i]->header.stamp), stamp_ns);
    EXPECT_EQ(images[i]->width, static_cast<unsigned>(kWidth));
    EXPECT_EQ(images[i]->height, static_cast<unsigned>(kHeight));
    EXPECT_EQ(images[i]->encoding, "mono8");
    EXPECT_EQ(*infos[i], *camera_info(stamp_ns));
    if (fields[i]->reason == BlurField::REASON_NONE) {
      EXPECT_EQ(fields[i]->exposure_time.toNSec(), (20 + numbers[i]) * kMs);
    }
  }
  EXPECT_EQ(fields[2]->reason, BlurField::REASON_BAD_IMAGE);
  EXPECT_NE(fields[2]->reason_text.find("the JPEG ends after"), std::string::npos) << fields[2]->reason_text;
}

TEST_F(DeblurBagTest, ImagesWithoutAStampPassInOrder) {
  write_bag(kFastRadS);
  write_config("drop_poor: true\n");
  ASSERT_EQ(run().exit_code, 0);
  const auto expected = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  change_messages<sensor_msgs::Image>([](sensor_msgs::Image* image, int i) {
    if (i == 2) image->header.stamp = ros::Time();
    return true;
  });
  const ProgramResult result = run();
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const auto inputs = read<sensor_msgs::Image>("in.bag", "/cam/image_raw");
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  ASSERT_EQ(images.size(), expected.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    EXPECT_EQ(images[i]->header.stamp, inputs[i]->header.stamp) << i;
    EXPECT_EQ(images[i]->data, (i == 2 ? inputs : expected)[i]->data) << i;
  }
  EXPECT_EQ(report()["passed_through"], (nlohmann::json{{"NO_STAMP", 1}, {"NO_GYRO", 1}}));
  EXPECT_EQ(report()["time_jumps"], 0);
  EXPECT_EQ(report()["dropped_poor"], 0);
}

/// A way of drivers to fill camera_info.
struct InfoHabit {
  const char* name;
  std::function<bool(sensor_msgs::CameraInfo*, int)> change;
  const char* warning;  ///< of the closing lines; null: none
  bool with_file = false;
};

TEST_F(DeblurBagTest, CameraInfoOfEveryHabitServes) {
  const InfoHabit habits[] = {
      {"not calibrated, with a file",
       [](sensor_msgs::CameraInfo* info, int) {
         info->K.fill(0);
         info->P.fill(0);
         info->R.fill(0);
         info->D.clear();
         info->distortion_model.clear();
         return true;
       },
       nullptr, true},
      {"stamp 0",
       [](sensor_msgs::CameraInfo* info, int) {
         info->header.stamp = ros::Time();
         return true;
       },
       "warning: camera_info has the stamp 0"},
      {"once", [](sensor_msgs::CameraInfo*, int i) { return i == 0; }, nullptr},
      {"once, from long before",
       [](sensor_msgs::CameraInfo* info, int i) {
         info->header.stamp = ros::Time(5);
         return i == 0;
       },
       nullptr},
      {"no size",
       [](sensor_msgs::CameraInfo* info, int) {
         info->width = info->height = 0;
         return true;
       },
       "warning: camera_info has width and height 0"},
  };
  write_calibration_file();
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  const auto expected = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  for (const InfoHabit& habit : habits) {
    SCOPED_TRACE(habit.name);
    write_bag(kFastRadS);
    write_config(std::string("drop_poor: true\n") + (habit.with_file ? "calibration_file: camchain.yaml\n" : ""));
    change_messages<sensor_msgs::CameraInfo>(habit.change);
    const ProgramResult result = run();
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
    ASSERT_EQ(images.size(), expected.size());
    for (std::size_t i = 0; i < images.size(); ++i) EXPECT_EQ(images[i]->data, expected[i]->data) << i;
    for (const auto& info : read<sensor_msgs::CameraInfo>("out.bag", "/cam/deblurred/camera_info")) {
      EXPECT_EQ(info->K[0], habit.with_file ? 0 : kFocalPx) << "the input's own";
    }
    EXPECT_EQ(report()["dropped_poor"], 0);
    const auto warnings = report()["input_problems"];
    EXPECT_EQ(warnings.size(), habit.warning ? 1u : 0u) << warnings;
    if (habit.warning) {
      EXPECT_NE(result.output.find(habit.warning), std::string::npos) << result.output;
    }
  }
}

TEST_F(DeblurBagTest, SliceUsesTheCameraInfoFromLongBeforeIt) {
  write_bag(kFastRadS);
  change_messages<sensor_msgs::CameraInfo>([](sensor_msgs::CameraInfo* info, int i) {
    info->header.stamp = ros::Time(5);
    return i == 0;
  });
  // Half a minute before the images: farther than a slice reads back.
  const sensor_msgs::CameraInfoPtr once = camera_info(5 * kSecond);
  change_bag([&](const rosbag::MessageInstance& instance, rosbag::Bag* bag) {
    if (instance.getTopic() == "/cam/camera_info") {
      bag->write("/cam/camera_info", instance.getTime() - ros::Duration(30), *once);
    } else {
      bag->write(instance.getTopic(), instance.getTime(), instance);
    }
  });
  const ProgramResult result = run({"--start", "30.15"});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_EQ(report()["frames_out"], kFrames - 2);
  EXPECT_EQ(report()["passed_through"], (nlohmann::json{{"NO_GYRO", 1}}));
}

TEST_F(DeblurBagTest, EncodingStaysThatOfTheInput) {
  write_config("drop_poor: true\n");
  for (const char* encoding : {"8UC3", "yuv422", "yuv422_yuy2", "16UC1", "8UC4"}) {
    SCOPED_TRACE(encoding);
    const bool known = std::string(encoding) != "8UC4";
    write_bag(kFastRadS);
    change_messages<sensor_msgs::Image>([&](sensor_msgs::Image* image, int) {
      const TimeNs stamp_ns = to_time_ns(image->header.stamp);
      *image = *image_message(stamp_ns, known ? encoding : "bgra8");
      image->encoding = encoding;
      return true;
    });
    // By its name: 16UC1 is taken for depth otherwise.
    const ProgramResult result = run({"--global-shutter", "--image-topic", "/cam/image_raw"});
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const auto inputs = read<sensor_msgs::Image>("in.bag", "/cam/image_raw");
    const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
    ASSERT_EQ(images.size(), inputs.size());
    for (std::size_t i = 0; i < images.size(); ++i) {
      EXPECT_EQ(images[i]->encoding, inputs[i]->encoding);
      EXPECT_EQ(images[i]->width, inputs[i]->width);
      EXPECT_EQ(images[i]->height, inputs[i]->height);
      EXPECT_EQ(images[i]->step, inputs[i]->step);
      EXPECT_EQ(images[i]->header.stamp, inputs[i]->header.stamp);
      EXPECT_EQ(images[i]->data == inputs[i]->data, !known || i + 1 == images.size()) << i;
    }
    EXPECT_EQ(report()["dropped_poor"], 0);
    EXPECT_EQ(report()["passed_through"],
              known ? (nlohmann::json{{"NO_GYRO", 1}}) : (nlohmann::json{{"UNSUPPORTED_ENCODING", kFrames}}));
  }
}

TEST_F(DeblurBagTest, ColoursAreInTheOrderOfTheFormat) {
  // A texture whose channels differ in brightness: red, then green, then blue.
  const auto colours = [](TimeNs stamp_ns) {
    const sensor_msgs::ImagePtr image = image_message(stamp_ns, "rgb8");
    for (std::size_t i = 0; i < image->data.size(); ++i) {
      image->data[i] = static_cast<std::uint8_t>(image->data[i] / (2 + 2 * (i % 3)));
    }
    return image;
  };
  write_bag(kFastRadS);
  change_messages<sensor_msgs::Image>([&](sensor_msgs::Image* image, int) {
    *image = *colours(to_time_ns(image->header.stamp));
    return true;
  });
  ASSERT_EQ(run().exit_code, 0);
  const auto expected = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  compress_images(".png", "rgb8; png compressed rgb8", [](auto*, int) {});
  ASSERT_EQ(run().exit_code, 0);
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  ASSERT_EQ(images.size(), expected.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    EXPECT_EQ(images[i]->encoding, "rgb8");
    EXPECT_EQ(images[i]->data, expected[i]->data) << i;
  }
}

TEST_F(DeblurBagTest, CalibrationFileStandsInForCameraInfo) {
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  const auto with_info = read<BlurField>("out.bag", "/cam/blur_field");
  fs::remove(path("out.bag"));

  fs::rename(path("in.bag"), path("all.bag"));
  {
    rosbag::Bag all(path("all.bag"), rosbag::bagmode::Read), some(path("in.bag"), rosbag::bagmode::Write);
    rosbag::View view(all, [](const rosbag::ConnectionInfo* c) { return c->topic != "/cam/camera_info"; });
    for (const rosbag::MessageInstance& instance : view) some.write(instance.getTopic(), instance.getTime(), instance);
  }
  expect_error(run(), {"no topic of type sensor_msgs/CameraInfo"});
  write_calibration_file();
  std::ofstream(path("config.yaml"), std::ios::app) << "calibration_file: camchain.yaml\n";
  const ProgramResult result = run();
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const auto with_file = read<BlurField>("out.bag", "/cam/blur_field");
  ASSERT_EQ(with_file.size(), with_info.size());
  for (std::size_t i = 0; i < with_file.size(); ++i) {
    EXPECT_EQ(with_file[i]->reason, with_info[i]->reason) << with_file[i]->reason_text;
    EXPECT_EQ(with_file[i]->extent, with_info[i]->extent);
  }
  EXPECT_EQ(read<sensor_msgs::CameraInfo>("out.bag", "/cam/deblurred/camera_info")[0]->K, camera_info(kStart)->K);
}

// By the option, and by the configuration's key, relative to its folder.
TEST_F(DeblurBagTest, MaskedPixelsLeaveAsTheyCame) {
  write_bag(kFastRadS);
  cv::Mat used(kHeight, kWidth, CV_8UC1, cv::Scalar(255));
  used.colRange(0, kWidth / 2).setTo(0);
  ASSERT_TRUE(cv::imwrite(path("mask.png"), used));
  const auto expect_masked = [&](const ProgramResult& result) {
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const auto inputs = read<sensor_msgs::Image>("in.bag", "/cam/image_raw");
    const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
    const cv::Mat in = view_image(*inputs[0]).image, out = view_image(*images[0]).image;
    EXPECT_EQ(cv::norm(in, out, cv::NORM_INF, used == 0), 0);
    EXPECT_GT(cv::norm(in, out, cv::NORM_INF, used), 0);
    EXPECT_GT(report()["frames"][0]["blocks"]["MASKED"], 5);
    EXPECT_EQ(read<ImageQuality>("out.bag", "/cam/image_quality")[0]->masked, 0.5f);
    fs::remove(path("out.bag"));
  };
  expect_masked(run({"--mask", path("mask.png")}));
  write_config("mask: mask.png\n");
  expect_masked(run());
  expect_error(run({"--mask", path("none.png")}), {"none.png is no file", "give a PNG or PGM of the image's size"});
  write_config("mask: mask.jpg\n");
  expect_error(run(), {"mask.jpg is no file"});
  ASSERT_TRUE(cv::imwrite(path("mask.png"), used.rowRange(0, 10)));
  const ProgramResult other_size = run({"--mask", path("mask.png")});
  EXPECT_EQ(other_size.exit_code, 0);
  EXPECT_NE(other_size.output.find("mask.png has 192x10, the images have 192x128"), std::string::npos)
      << other_size.output;
}

// From when it was recorded on, also for a slice after it; not where a file is named.
TEST_F(DeblurBagTest, MaskOfTheBagIsUsed) {
  write_bag(kFastRadS);
  cv::Mat used(kHeight, kWidth, CV_8UC1, cv::Scalar(255));
  used.colRange(0, kWidth / 2).setTo(0);
  {
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Append);
    const TimeNs recorded_ns = kStart + kFramePeriod - kMs;  // after the first image
    bag.write("/cam/mask", to_ros_time(recorded_ns), *to_image(used, std_msgs::Header(), "mono8"));
  }
  const auto masked_parts = [&](const std::vector<std::string>& options) {
    const ProgramResult result = run(options);
    EXPECT_EQ(result.exit_code, 0) << result.output;
    std::vector<float> parts;
    for (const auto& quality : read<ImageQuality>("out.bag", "/cam/image_quality")) parts.push_back(quality->masked);
    fs::remove(path("out.bag"));
    return parts;
  };
  std::vector<float> expected(kFrames, 0.5f);
  expected.front() = expected.back() = 0;  // the last one has no samples
  EXPECT_EQ(masked_parts({}), expected);
  // The mask was recorded longer before the slice than what is read before it for the slice's frames.
  const ros::Time later = to_ros_time(kStart + 2 * kFramePeriod - 10 * kMs);
  change_bag([&](const rosbag::MessageInstance& instance, rosbag::Bag* bag) {
    const bool is_moved = instance.getTime() >= later;
    bag->write(instance.getTopic(), instance.getTime() + ros::Duration(is_moved ? 10 : 0), instance);
  });
  EXPECT_EQ(masked_parts({"--start", "12.25"}), (std::vector<float>{0.5f, 0}));
  ASSERT_TRUE(cv::imwrite(path("all.png"), cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(255))));
  EXPECT_EQ(masked_parts({"--mask", path("all.png")}), std::vector<float>(kFrames, 0));
}

TEST_F(DeblurBagTest, EveryFrameComesOutInOrderWithItsReason) {
  write_bag(kFastRadS);
  const ProgramResult result = run();
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const auto inputs = read<sensor_msgs::Image>("in.bag", "/cam/image_raw");
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  const auto infos = read<sensor_msgs::CameraInfo>("out.bag", "/cam/deblurred/camera_info");
  const auto fields = read<BlurField>("out.bag", "/cam/blur_field");
  const auto keypoints = read<KeypointArray>("out.bag", "/cam/keypoints");
  ASSERT_EQ(images.size(), inputs.size());
  ASSERT_EQ(infos.size(), inputs.size());
  ASSERT_EQ(fields.size(), inputs.size());
  ASSERT_EQ(keypoints.size(), inputs.size());
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    const bool covered = i + 1 < inputs.size();
    EXPECT_EQ(images[i]->header.stamp, inputs[i]->header.stamp);
    EXPECT_EQ(infos[i]->header.stamp, inputs[i]->header.stamp);
    EXPECT_EQ(keypoints[i]->header.stamp, inputs[i]->header.stamp);
    EXPECT_EQ(images[i]->data == inputs[i]->data, !covered);
    EXPECT_EQ(fields[i]->reason, covered ? BlurField::REASON_NONE : BlurField::REASON_NO_GYRO);
  }
  const nlohmann::json json = report();
  EXPECT_EQ(json["frames_in"], kFrames);
  EXPECT_EQ(json["frames_out"], kFrames);
  EXPECT_EQ(json["passed_through"]["NO_GYRO"], 1);
  EXPECT_NEAR(json["frames"][0]["center_extent_px"].get<double>(), kFocalPx * kFastRadS * to_seconds(kExposure), 0.25);
  EXPECT_NEAR(json["frames"][0]["center_angle_deg"].get<double>(), 0, 1);
  EXPECT_EQ(json["frames"][0]["blocks"]["DEBLURRED"], 24);
  EXPECT_EQ(json["frames"][4]["identical"], true);
  EXPECT_TRUE(read<std_msgs::Header>("out.bag", "/other").empty());
}

TEST_F(DeblurBagTest, BadImagesAreLeftOutWhereTheUserSaysSo) {
  write_bag(3.0);  // 18 px
  write_config("max_extent: 5\ndrop_poor: true\n");
  const ProgramResult result = run({"--tracks", "--global-shutter"});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  // The gyroscope does not cover the last one: nobody knows whether it is bad.
  const TimeNs last_ns = kStart + (kFrames - 1) * kFramePeriod;
  for (const std::string topic : {"deblurred/image_raw", "global_shutter/image_raw"}) {
    const auto images = read<sensor_msgs::Image>("out.bag", "/cam/" + topic);
    ASSERT_EQ(images.size(), 1u) << topic;
    EXPECT_EQ(images[0]->header.stamp, to_ros_time(last_ns));
  }
  EXPECT_EQ(read<sensor_msgs::CameraInfo>("out.bag", "/cam/deblurred/camera_info").size(), 1u);
  EXPECT_EQ(read<KeypointArray>("out.bag", "/cam/keypoints").size(), 1u);
  EXPECT_EQ(read<BlurField>("out.bag", "/cam/blur_field").size(), std::size_t{kFrames});
  const auto qualities = read<ImageQuality>("out.bag", "/cam/image_quality");
  ASSERT_EQ(qualities.size(), std::size_t{kFrames});
  EXPECT_EQ(qualities[0]->grade, ImageQuality::POOR);
  EXPECT_EQ(qualities[kFrames - 1]->grade, ImageQuality::UNKNOWN);
  const nlohmann::json json = report();
  EXPECT_EQ(json["frames_in"], kFrames);
  EXPECT_EQ(json["frames_out"], 1);
  EXPECT_EQ(json["dropped_poor"], kFrames - 1);
  EXPECT_EQ(json["frames"][0]["dropped"], true);
  EXPECT_EQ(json["frames"][0]["reason_text"].get<std::string>().rfind("drop_poor: POOR", 0), 0u);
  EXPECT_EQ(json["frames"][kFrames - 1]["dropped"], false);
  EXPECT_NE(result.output.find("1 frames of /cam/image_raw, 1 passed through (NO_GYRO), 4 more dropped as POOR"),
            std::string::npos)
      << result.output;
}

TEST_F(DeblurBagTest, PixelsAreThoseOfTheProcessor) {
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  Processor::Environment environment;
  environment.clock = [] { return kStart; };
  environment.log = [](LogLevel, const std::string& text) { ADD_FAILURE() << text; };
  Processor processor(std::move(environment));
  processor.set_config(test_config());
  for (const auto& imu : read<sensor_msgs::Imu>("in.bag", "/imu")) processor.add_imu(*imu);
  processor.add_camera_info(camera_info(kStart));
  processor.add_image(image_message(kStart));
  const auto image = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw").front();
  const auto keypoints = read<KeypointArray>("out.bag", "/cam/keypoints").front();
  std::size_t outputs = 0;
  processor.advance([&](FrameOutput&& output) {
    ++outputs;
    EXPECT_TRUE(output.image->data == image->data);
    EXPECT_TRUE(output.keypoints->descriptors == keypoints->descriptors);
    EXPECT_EQ(output.keypoints->keypoints.size(), keypoints->keypoints.size());
    return true;
  });
  EXPECT_EQ(outputs, 1u);
}

TEST_F(DeblurBagTest, SlicesTogetherAreTheWholeBag) {
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  const auto whole_images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  const auto whole_fields = read<BlurField>("out.bag", "/cam/blur_field");
  const auto whole_keypoints = read<KeypointArray>("out.bag", "/cam/keypoints");
  std::size_t done = 0;
  // The images are at 2.0, 2.1, ... 2.4 s of the bag.
  for (const std::vector<std::string>& limits :
       {std::vector<std::string>{"--end", "2.1"}, {"--start", "2.1", "--end", "2.35"}, {"--start", "2.35"}}) {
    const ProgramResult result = run(limits);
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
    const auto fields = read<BlurField>("out.bag", "/cam/blur_field");
    const auto keypoints = read<KeypointArray>("out.bag", "/cam/keypoints");
    ASSERT_FALSE(images.empty());
    for (std::size_t i = 0; i < images.size(); ++i, ++done) {
      ASSERT_LT(done, whole_images.size());
      EXPECT_EQ(images[i]->header.stamp, whole_images[done]->header.stamp);
      EXPECT_TRUE(images[i]->data == whole_images[done]->data);
      EXPECT_EQ(fields[i]->reason, whole_fields[done]->reason);
      EXPECT_EQ(fields[i]->extent, whole_fields[done]->extent);
      EXPECT_TRUE(keypoints[i]->descriptors == whole_keypoints[done]->descriptors);
    }
  }
  EXPECT_EQ(done, whole_images.size());
  fs::remove(path("out.bag"));
  expect_error(run({"--start", "2", "--end", "1"}), {"--start 2", "--end 1"});
}

TEST_F(DeblurBagTest, SliceUsesTheExposureSettingFromBeforeIt) {
  // A driver publishes its parameters when they change: long before the images here, and between the last two.
  const auto setting = [](int exposure_us) {
    dynamic_reconfigure::Config config;
    config.ints.resize(1);
    config.ints[0].name = "exposure_us";
    config.ints[0].value = exposure_us;
    return config;
  };
  write_bag(kFastRadS);
  {
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Append);
    bag.write("/cam/driver", to_ros_time(kStart - 30 * kSecond), setting(5000));
    bag.write("/cam/driver", to_ros_time(kStart - 20 * kSecond), setting(10000));
    bag.write("/cam/driver", to_ros_time(kStart + 260 * kMs), setting(20000));
  }
  // Without a setting frames could not be deblurred; what is read before a slice ends long after the first ones.
  std::ofstream(path("config.yaml"))
      << "exposure_time: 0\nreadout_time: 0.02\nR_cam_imu: [1,0,0,0,1,0,0,0,1]\n"
         "block_size: 32\nvalidation: none\nkeypoint_detector: FAST\nkeypoint_descriptor: ORB\n"
         "exposure_source: dynamic_reconfigure_us\n"
         "exposure_field: exposure_us\n";
  const std::vector<std::string> driver{"--exposure-topic", "/cam/driver"};
  ASSERT_EQ(run(driver).exit_code, 0);
  const nlohmann::json whole = report()["frames"];
  ASSERT_EQ(whole.size(), static_cast<std::size_t>(kFrames));
  const std::vector<double> expected_s{0.01, 0.01, 0.01, 0.02};
  for (std::size_t i = 0; i < expected_s.size(); ++i) EXPECT_EQ(whole[i].value("exposure_s", 0.0), expected_s[i]) << i;

  // The images are at 30.0, 30.1, ... 30.4 s of the bag.
  std::size_t done = 0;
  for (const auto& [start, end] : {std::pair("29.5", "30.15"), {"30.15", "30.25"}, {"30.25", "40"}}) {
    std::vector<std::string> slice = driver;
    slice.insert(slice.end(), {"--start", start, "--end", end});
    const ProgramResult result = run(slice);
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const nlohmann::json frames = report()["frames"];  // not a part of a temporary
    for (const nlohmann::json& frame : frames) {
      ASSERT_LT(done, whole.size());
      EXPECT_EQ(frame["stamp_ns"], whole[done]["stamp_ns"]);
      EXPECT_EQ(frame["reason"], whole[done]["reason"]) << frame;
      EXPECT_EQ(frame.value("exposure_s", 0.0), whole[done].value("exposure_s", 0.0)) << "slice from " << start << " s";
      ++done;
    }
  }
  EXPECT_EQ(done, whole.size());
}

TEST_F(DeblurBagTest, ExposureTopicIsFoundAndUsed) {
  write_bag(kFastRadS, true);
  ASSERT_EQ(run().exit_code, 0);
  EXPECT_EQ(report()["topics"]["exposure"], "/cam/exposure");
  EXPECT_NEAR(report()["frames"][0]["exposure_s"].get<double>(), 0.02, 1e-12);
}

TEST_F(DeblurBagTest, KeepsAllTopicsAndWritesPictures) {
  write_bag(kFastRadS);
  const ProgramResult result =
      run({"--keep-all-topics", "--overlay", "--markers", "--trust-mask", "--output-namespace", "/elsewhere"});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_EQ(read<std_msgs::Header>("out.bag", "/other").size(), 1u);
  EXPECT_EQ(read<sensor_msgs::Image>("out.bag", "/cam/image_raw").size(), 5u);
  EXPECT_EQ(read<sensor_msgs::Image>("out.bag", "/elsewhere/deblurred/image_raw").size(), 5u);
  EXPECT_EQ(read<sensor_msgs::Image>("out.bag", "/elsewhere/blur_overlay").front()->encoding, "bgr8");
  EXPECT_EQ(read<visualization_msgs::MarkerArray>("out.bag", "/elsewhere/blur_markers").size(), 5u);
  EXPECT_EQ(read<ImageQuality>("out.bag", "/elsewhere/image_quality").size(), 5u);
  EXPECT_EQ(read<sensor_msgs::Image>("out.bag", "/elsewhere/trust_mask").front()->encoding, "mono8");
}

TEST_F(DeblurBagTest, LeavesOutKeypointsWhereAskedTo) {
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  EXPECT_EQ(read<KeypointArray>("out.bag", "/cam/keypoints").size(), images.size());
  const ProgramResult result = run({"--no-keypoints"});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_TRUE(read<KeypointArray>("out.bag", "/cam/keypoints").empty());
  const auto without = read<sensor_msgs::Image>("out.bag", "/cam/deblurred/image_raw");
  ASSERT_EQ(without.size(), images.size());
  for (std::size_t i = 0; i < images.size(); ++i) EXPECT_TRUE(without[i]->data == images[i]->data) << "image " << i;
}

TEST_F(DeblurBagTest, WritesGlobalShutterImagesWithTheirOwnStamps) {
  write_bag(kFastRadS);
  ASSERT_EQ(run({"--global-shutter"}).exit_code, 0);
  const auto inputs = read<sensor_msgs::Image>("in.bag", "/cam/image_raw");
  const auto images = read<sensor_msgs::Image>("out.bag", "/cam/global_shutter/image_raw");
  const auto infos = read<sensor_msgs::CameraInfo>("out.bag", "/cam/global_shutter/camera_info");
  const auto keypoints = read<KeypointArray>("out.bag", "/cam/keypoints");
  ASSERT_EQ(images.size(), inputs.size());
  ASSERT_EQ(infos.size(), inputs.size());
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    const bool covered = i + 1 < inputs.size();
    EXPECT_EQ(images[i]->header.stamp, covered ? keypoints[i]->reference_time : inputs[i]->header.stamp);
    EXPECT_EQ(infos[i]->header.stamp, images[i]->header.stamp);
    EXPECT_EQ(images[i]->data == inputs[i]->data, !covered);
  }
  ASSERT_EQ(run().exit_code, 0);
  EXPECT_TRUE(read<sensor_msgs::Image>("out.bag", "/cam/global_shutter/image_raw").empty());
}

TEST_F(DeblurBagTest, FramesWhoseRateIsAllBiasAreBitIdentical) {
  write_bag(0.9);
  write_config("gyro_bias: [0, 0.9, 0]\n");
  const ProgramResult result = run();
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_NEAR(report()["gyro_bias_rad_s"][1].get<double>(), 0.9, 1e-9);
  const nlohmann::json frames = report()["frames"];  // not a part of a temporary
  EXPECT_EQ(frames.size(), static_cast<std::size_t>(kFrames));
  for (const auto& frame : frames) EXPECT_EQ(frame["identical"], true);
}

// What is left is rosbag's index, of 64 bytes or so a message.
TEST_F(DeblurBagTest, MemoryGrowsByNoRecordOfFrames) {
  constexpr int kSide = 16;
  constexpr TimeNs kPeriod = 10 * kMs;
  std::ofstream(path("config.yaml"))
      << "exposure_time: 0.02\nR_cam_imu: [1,0,0,0,1,0,0,0,1]\nblock_size: 8\n"
         "threads: 1\nvalidation: none\nkeypoint_detector: FAST\nkeypoint_descriptor: ORB\n";
  const auto peak_kib = [&](int frames, const std::vector<std::string>& arguments) {
    {
      rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Write);
      for (int i = 0; i < frames; ++i) {
        const TimeNs t_ns = kStart + i * kPeriod;
        bag.write("/imu", to_ros_time(t_ns), imu_message(t_ns, kFastRadS));
        bag.write("/cam/image_raw", to_ros_time(t_ns), *image_message(t_ns, "mono8", kSide, kSide));
        bag.write("/cam/camera_info", to_ros_time(t_ns), *camera_info(t_ns, kSide, kSide));
      }
    }
    std::vector<std::string> command{DEBLUR_BAG, path("in.bag"), path("out.bag"), "--config", path("config.yaml")};
    command.insert(command.end(), arguments.begin(), arguments.end());
    const ProgramResult result = run_program(command);
    EXPECT_EQ(result.exit_code, 0) << result.output;
    return static_cast<double>(result.peak_memory_kib);
  };
  // The peak varies by some MiB with which pages of the libraries are resident: a difference of many frames is free of
  // that.
  constexpr int kFew = 300, kMany = 6000;
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{}, std::vector<std::string>{"--json", path("report.json")}}) {
    const double growth_kib = peak_kib(kMany, arguments) - peak_kib(kFew, arguments);
    EXPECT_LT(growth_kib / (kMany - kFew), 1) << "KiB a frame";
  }
  EXPECT_EQ(report()["frames"].size(), static_cast<std::size_t>(kFew));
}

TEST_F(DeblurBagTest, StaticTransformOfTheBagIsUsed) {
  std::ofstream(path("config.yaml"))
      << "exposure_time: 0.03\nvalidation: none\nkeypoint_detector: FAST\nkeypoint_descriptor: ORB\n";
  write_bag(kFastRadS);
  ASSERT_EQ(run().exit_code, 0);
  EXPECT_EQ(report()["passed_through"]["NO_EXTRINSIC"], kFrames);
  {
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Append);
    tf2_msgs::TFMessage transforms;
    transforms.transforms.resize(1);
    transforms.transforms[0].header.frame_id = kImuFrame;
    transforms.transforms[0].child_frame_id = kCameraFrame;
    transforms.transforms[0].transform.rotation.w = 1;
    bag.write("/tf_static", to_ros_time(kStart + kSecond), transforms);  // late: latched in a live system
  }
  ASSERT_EQ(run().exit_code, 0);
  EXPECT_FALSE(report()["passed_through"].contains("NO_EXTRINSIC"));
}

TEST_F(DeblurBagTest, TopicsThatAreNotThereAreListed) {
  write_bag(kFastRadS);
  expect_error(run({"--imu-topic", "/nope"}), {"/nope", "/imu (sensor_msgs/Imu)", "/cam/image_raw"});
  expect_error(run({"--camera-ns", "/left"}), {"/left/image_raw", "/cam/image_raw"});
  expect_error(run({"--imu-topic", "/cam/image_raw"}), {"not of type sensor_msgs/Imu"});
}

TEST_F(DeblurBagTest, MessagesOfAnotherVersionAreRefused) {
  write_bag(kFastRadS);
  {
    topic_tools::ShapeShifter older;
    const std::string md5 = "0123456789abcdef0123456789abcdef";
    older.morph(md5, "gyro_deblur/Exposure", "float64 exposure_time\n", "0");
    std::vector<std::uint8_t> bytes(sizeof(double));
    ros::serialization::IStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
    older.read(stream);
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Append);
    bag.write("/cam/exposure", to_ros_time(kStart), older);
  }
  expect_error(run(), {"/cam/exposure", "another version", "0123456789abcdef"});
}

TEST_F(DeblurBagTest, DamagedMessageIsNamed) {
  struct Damage {
    const char *topic, *type;
    std::function<void()> add;
  };
  const TimeNs at_ns = kStart + 50 * kMs;
  const auto add = [&](const std::string& topic, const auto& message, const Spoil& spoil) {
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Append);
    bag.write(topic, to_ros_time(at_ns), spoilt(message, spoil));
  };
  Exposure exposure;
  tf2_msgs::TFMessage transforms;
  transforms.transforms.resize(1);
  const Spoil cut = [](std::vector<std::uint8_t>* bytes) { bytes->resize(bytes->size() / 2); };
  const Damage damages[] = {
      {"/cam/camera_info", "sensor_msgs/CameraInfo",
       [&] { add("/cam/camera_info", *camera_info(at_ns), announce<double>(5, 1u << 30)); }},
      {"/cam/image_raw", "sensor_msgs/Image",
       [&] { add("/cam/image_raw", *image_message(at_ns), announce<std::uint8_t>(kWidth * kHeight, 0xffffffff)); }},
      {"/imu", "sensor_msgs/Imu", [&] { add("/imu", imu_message(at_ns, 1), cut); }},
      {"/cam/exposure", "gyro_deblur/Exposure", [&] { add("/cam/exposure", exposure, cut); }},
      {"/tf_static", "tf2_msgs/TFMessage", [&] { add("/tf_static", transforms, cut); }},
      {"/tf", "tf2_msgs/TFMessage", [&] { add("/tf", transforms, announce<char>(1, 1u << 31)); }},
  };
  for (const Damage& damage : damages) {
    write_bag(kFastRadS);
    damage.add();
    expect_error(run(), {"deblur_bag: " + path("in.bag") + ": topic " + damage.topic + ", " + damage.type +
                         " recorded at 100.050000000 s: cannot be read: "});
  }
}

TEST_F(DeblurBagTest, SeveralCandidatesHaveToBeNamed) {
  write_bag(kFastRadS);
  {
    rosbag::Bag bag(path("in.bag"), rosbag::bagmode::Append);
    bag.write("/imu2", to_ros_time(kStart), imu_message(kStart, 0));
  }
  expect_error(run(), {"several", "/imu2"});
  EXPECT_EQ(run({"--imu-topic", "/imu"}).exit_code, 0);
}

TEST_F(DeblurBagTest, UnreadableFiles) {
  expect_error(run(), {"in.bag", "no such file"});
  std::ofstream(path("in.bag")) << "this is not a bag\n";
  expect_error(run(), {"in.bag", "not a bag"});
  write_bag(kFastRadS);
  fs::resize_file(path("in.bag"), fs::file_size(path("in.bag")) / 2);
  expect_error(run(), {"in.bag"});
  write_bag(kFastRadS);
  fs::remove(path("config.yaml"));
  expect_error(run(), {"config.yaml"});
  write_config("noise_to_signal_ratio: 7\n");
  expect_error(run(), {"noise_to_signal_ratio = 7"});
}

TEST_F(DeblurBagTest, InputIsNotOverwritten) {
  write_bag(kFastRadS);
  const ProgramResult result =
      run_program({DEBLUR_BAG, path("in.bag"), path("in.bag"), "--config", path("config.yaml")});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.output.find("overwrite"), std::string::npos);
  EXPECT_EQ(read<sensor_msgs::Image>("in.bag", "/cam/image_raw").size(), 5u);
}

TEST_F(DeblurBagTest, HelpAndBadUsage) {
  EXPECT_EQ(run_program({DEBLUR_BAG, "--help"}).exit_code, 0);
  EXPECT_EQ(run_program({DEBLUR_BAG}).exit_code, 2);
  EXPECT_EQ(run_program({DEBLUR_BAG, "a", "b", "--config", "c", "--nonsense"}).exit_code, 2);
}

}  // namespace
}  // namespace gyro_deblur
