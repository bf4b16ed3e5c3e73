// The nodelet in front of a camera whose exposure time is not given, or given wrongly. Loaded into this very
// process. Waits for messages and conditions with a deadline; time never decides.
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <diagnostic_msgs/DiagnosticArray.h>
#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/ros.h>
#include <rosgraph_msgs/Log.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "camera_topics.hpp"
#include "message_builders.hpp"
#include "own_ros_home.hpp"
#include "repeated_pictures.hpp"
#include "ros/image_conversion.hpp"
#include "ros/messages.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {
namespace {

using namespace test;

constexpr int kPictures = 70;  // 3.5 s; a contradiction is reported after 2
constexpr double kSpeed = 2;   // blur of 10 to 20 px

class NodeletExposureTest : public CameraTopicsTest {
 protected:
  NodeletExposureTest() : CameraTopicsTest("/exposure", 1000) {
    const ShutterTiming timing = camera_.simulator().scene().timing(0);
    set("readout_time", to_seconds(timing.readout_ns));
    set("optical_flow", true);
    set("validation", std::string("likelihood"));
    set("exposure_time", std::string());
    image_subscriber_ = nh_.subscribe<sensor_msgs::Image>(
        ns_ + "/deblurred/image_raw", 1000,
        [this](const sensor_msgs::ImageConstPtr& image) { mailbox_.put([&] { images_.push_back(image); }); });
    field_subscriber_ = nh_.subscribe<BlurField>(ns_ + "/blur_field", 1000, [this](const BlurFieldConstPtr& field) {
      mailbox_.put([&] { fields_.push_back(field); });
    });
    log_subscriber_ = nh_.subscribe<rosgraph_msgs::Log>("/rosout", 1000, [this](const rosgraph_msgs::LogConstPtr& log) {
      mailbox_.put([&] { log_.push_back(log->msg); });
    });
    diagnostics_subscriber_ = nh_.subscribe<diagnostic_msgs::DiagnosticArray>(
        "/diagnostics", 100, [this](const diagnostic_msgs::DiagnosticArrayConstPtr& array) {
          mailbox_.put([&] {
            for (const auto& status : array->status) {
              if (("/" + status.name).rfind(name_ + ": ", 0) != 0) continue;
              diagnostics_.push_back(status.message);
              for (const auto& value : status.values) diagnostics_.push_back(value.key + " = " + value.value);
            }
          });
        });
  }

  void load() {
    ASSERT_TRUE(loader_.load(name_, "gyro_deblur/DeblurNodelet", {}, {}));
    ASSERT_TRUE(poll_until([this] {
      return inputs_connected() && image_subscriber_.getNumPublishers() > 0 &&
             field_subscriber_.getNumPublishers() > 0 && log_subscriber_.getNumPublishers() > 0 &&
             diagnostics_subscriber_.getNumPublishers() > 0;
    }));
  }

  static sensor_msgs::CameraInfoPtr info_of(const CameraCalibration& calibration, TimeNs stamp_ns) {
    const sensor_msgs::CameraInfoPtr info = camera_info(stamp_ns, calibration.width_px, calibration.height_px);
    info->K = {calibration.fx_px, 0, calibration.cx_px, 0, calibration.fy_px, calibration.cy_px, 0, 0, 1};
    return info;
  }

  /// Each picture comes when the one before has left, so that none is too late.
  void play(int begin, int end) {
    const CameraCalibration& calibration = camera_.simulator().camera().calibration();
    for (int i = begin; i < end; ++i) {
      const TimeNs stamp_ns = camera_.simulator().stamp(i);
      for (; sample_ < imu_.size() && imu_[sample_].t_ns <= stamp_ns + 100 * kMs; ++sample_) {
        sensor_msgs::Imu imu = imu_message(imu_[sample_].t_ns, imu_[sample_].rate_rad_s.y());
        imu.angular_velocity.x = imu_[sample_].rate_rad_s.x();
        imu.angular_velocity.z = imu_[sample_].rate_rad_s.z();
        imu_publisher_.publish(imu);
      }
      const sensor_msgs::CameraInfoPtr info = info_of(calibration, stamp_ns);
      sensor_msgs::Image like;
      like.header = info->header;
      like.encoding = "mono8";
      info_publisher_.publish(info);
      const sensor_msgs::ImageConstPtr image = to_image(camera_.picture(i), like);
      inputs_.push_back(image);
      image_publisher_.publish(image);
      const std::size_t count = inputs_.size();
      ASSERT_TRUE(mailbox_.wait([&] { return images_.size() >= count && fields_.size() >= count; })) << i;
    }
  }
  static const std::string* find(const std::vector<std::string>& lines, const std::string& part) {
    const auto found = std::find_if(lines.begin(), lines.end(),
                                    [&part](const std::string& line) { return line.find(part) != std::string::npos; });
    return found == lines.end() ? nullptr : &*found;
  }
  bool wait_for(const std::vector<std::string>& lines, const std::string& part) {
    return mailbox_.wait([&] { return find(lines, part) != nullptr; });
  }
  /// The nodelet looks for what is missing when a message comes: picture 0's camera_info, again and again.
  bool wait_with_messages_for(const std::vector<std::string>& lines, const std::string& part) {
    const CameraCalibration& calibration = camera_.simulator().camera().calibration();
    return poll_until([&] {
      info_publisher_.publish(info_of(calibration, camera_.simulator().stamp(0)));
      return mailbox_.look([&] { return find(lines, part) != nullptr; });
    });
  }

  const HandheldCamera camera_{kPictures, kSpeed};
  const std::vector<sim::ImuSample> imu_ = camera_.simulator().imu();
  std::size_t sample_ = 0;
  Mailbox mailbox_;
  std::vector<sensor_msgs::ImageConstPtr> inputs_, images_;
  std::vector<BlurFieldConstPtr> fields_;
  std::vector<std::string> log_, diagnostics_;
  ros::Subscriber image_subscriber_, field_subscriber_, log_subscriber_, diagnostics_subscriber_;
  nodelet::Loader loader_{false};  // without services
};

TEST_F(NodeletExposureTest, ImagesAreDeblurredAfterMotionWithNoExposureTimeAnywhere) {
  ASSERT_NO_FATAL_FAILURE(load());
  ASSERT_NO_FATAL_FAILURE(play(0, 1));
  EXPECT_EQ(fields_[0]->reason, static_cast<int>(PassThroughReason::NO_EXPOSURE_TIME));
  EXPECT_NE(fields_[0]->reason_text.find("the exposure time is not known yet"), std::string::npos);
  EXPECT_EQ(images_[0]->data, inputs_[0]->data);
  EXPECT_TRUE(wait_with_messages_for(log_, "exposure_time is not set, and no exposure message has come"));
  EXPECT_TRUE(wait_for(diagnostics_, "exposure time, waits for = ")) << "what is missing";
  ASSERT_NO_FATAL_FAILURE(play(1, 20));
  int deblurred = 0;
  for (std::size_t i = 10; i < 20; ++i) {
    EXPECT_EQ(fields_[i]->reason, 0) << fields_[i]->reason_text;
    EXPECT_NEAR(fields_[i]->exposure_time.toSec(), 0.02, 0.03 * 0.02);
    deblurred += images_[i]->data != inputs_[i]->data;
  }
  EXPECT_GE(deblurred, 8) << "it is nearly at rest where it reverses";
  EXPECT_TRUE(wait_for(log_, "estimated from the blur of the images"));
  EXPECT_TRUE(wait_for(diagnostics_, "exposure time, from = images"));
  EXPECT_TRUE(loader_.unload(name_));
}

TEST_F(NodeletExposureTest, AWrongParameterIsNamedWithBothValues) {
  set("exposure_time", 0.0125);
  ASSERT_NO_FATAL_FAILURE(load());
  ASSERT_NO_FATAL_FAILURE(play(0, kPictures));
  const std::string text = "times what exposure_time says: 0.0125 s by exposure_time, 0.0";
  EXPECT_TRUE(wait_for(log_, text));
  // The log has what the images say next to the wrong value, the diagnostics what they say since it is replaced.
  const auto names_the_ratio = [&text](const std::string& line) {
    const std::string before = "blur is ";
    const std::size_t ratio = line.find(before);
    return ratio != std::string::npos && line.find(text) != std::string::npos &&
           std::abs(std::stod(line.substr(ratio + before.size())) - 1.6) < 0.1;
  };
  EXPECT_TRUE(mailbox_.wait([&] { return std::any_of(diagnostics_.begin(), diagnostics_.end(), names_the_ratio); }));
  EXPECT_NEAR(fields_.back()->exposure_time.toSec(), 0.02, 0.03 * 0.02);
  EXPECT_TRUE(loader_.unload(name_));
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  const gyro_deblur::test::OwnRosHome home;
  ros::init(argc, argv, "test_nodelet_exposure");
  ros::AsyncSpinner spinner(2);
  spinner.start();
  return RUN_ALL_TESTS();
}
