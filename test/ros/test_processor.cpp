#include "ros/processor.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core/utility.hpp>

#include "processor_test.hpp"

namespace gyro_deblur::processor_test {
namespace {

using namespace test;

TEST_F(ProcessorTest, FinishLetsEverythingOut) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  add_frame(kStart + 200 * kMs);
  processor_.finish([this](FrameOutput&& output) {
    outputs_.push_back(std::move(output));
    return true;
  });
  ASSERT_EQ(outputs_.size(), 2u);
  expect_deblurred(0);
  expect_passed_through(1, PassThroughReason::NO_GYRO, "");
}

TEST_F(ProcessorTest, SinkCanStop) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  add_frame(kStart + 33 * kMs);
  std::size_t taken = 0;
  processor_.advance([&taken](FrameOutput&&) {
    ++taken;
    return false;
  });
  EXPECT_EQ(taken, 1u);
  EXPECT_EQ(processor_.waiting(), 1u);
}

/// A camera at 30 Hz and a worker that takes its time, both by the steady clock.
class PacedProcessorTest : public ProcessorTest {
 protected:
  static constexpr TimeNs kPeriod = 33 * kMs;

  /// Frames and samples come until `end_ns`, samples in batches; the worker looks every millisecond.
  void play(TimeNs end_ns, TimeNs processing_ns, TimeNs batch_ns) {
    TimeNs busy_until_ns = 0, imu_ns = -100 * kMs;
    for (; steady_ns_ < end_ns; steady_ns_ += kMs) {
      now_ns_ = kStart + steady_ns_;
      if (steady_ns_ % batch_ns == 0) {
        add_imu(kStart + imu_ns, kStart + steady_ns_);
        imu_ns = steady_ns_ + kImuPeriod;
      }
      if (steady_ns_ % kPeriod == 0) add_frame(kStart + steady_ns_ - kFrameDuration);
      if (steady_ns_ < busy_until_ns) continue;
      processor_.advance([&](FrameOutput&& output) {
        const bool processed = output.reason == PassThroughReason::NONE;
        const TimeNs done_ns = steady_ns_ + (processed ? processing_ns : 0);
        latencies_ns_.push_back(kStart + done_ns - kFrameDuration - to_time_ns(output.input->header.stamp));
        outputs_.push_back(std::move(output));
        if (processed) busy_until_ns = done_ns;
        return !processed;
      });
    }
  }
  std::size_t overloaded() const {
    const auto counts = processor_.statistics().passed_through;
    const auto found = counts.find(PassThroughReason::OVERLOAD);
    return found == counts.end() ? 0 : found->second;
  }
  std::vector<TimeNs> latencies_ns_;
};

TEST_F(PacedProcessorTest, UnderOverloadTheNewestFramesAreProcessed) {
  constexpr TimeNs kProcessing = 100 * kMs;
  play(6 * kSecond, kProcessing, kImuPeriod);
  ASSERT_GT(outputs_.size(), 150u);
  EXPECT_GT(overloaded(), outputs_.size() / 2);
  EXPECT_NE(log_.back().find("processing (0.10"), std::string::npos) << log_.back();
  for (std::size_t i = 1; i < outputs_.size(); ++i) {
    EXPECT_EQ(to_time_ns(outputs_[i].input->header.stamp) - to_time_ns(outputs_[i - 1].input->header.stamp), kPeriod);
  }
  // As long as it takes, and a queue of two in front of it, and until the worker looks.
  for (std::size_t i = 30; i < latencies_ns_.size(); ++i) {
    EXPECT_LE(latencies_ns_[i], kProcessing + 3 * kPeriod) << i;
  }
}

TEST_F(PacedProcessorTest, BatchesOfSamplesAreNoOverload) {
  play(6 * kSecond, 30 * kMs, 100 * kMs);  // 9/10 of what it could do
  ASSERT_GT(outputs_.size(), 150u);
  EXPECT_EQ(overloaded(), 0u);
}

TEST_F(PacedProcessorTest, BurstOfFramesIsWorkedOff) {
  play(kSecond, 10 * kMs, kImuPeriod);
  const std::size_t before = outputs_.size();
  constexpr std::size_t kBurst = 25;
  steady_ns_ += static_cast<TimeNs>(kBurst) * kPeriod;
  now_ns_ = kStart + steady_ns_;
  add_imu(kStart + kSecond - kImuPeriod, now_ns_);
  for (std::size_t i = 0; i < kBurst; ++i) {
    add_frame(kStart + kSecond + static_cast<TimeNs>(i) * kPeriod - kFrameDuration);
  }
  play(steady_ns_ + kSecond, 10 * kMs, kImuPeriod);
  EXPECT_GT(outputs_.size(), before + kBurst);
  EXPECT_EQ(overloaded(), 0u);
}

TEST_F(PacedProcessorTest, WhoeverLetsEverythingOutHasTime) {
  constexpr TimeNs kProcessing = 100 * kMs;
  play(kSecond, kProcessing, kImuPeriod);
  for (int i = 0; i < 20; ++i) add_frame(kStart + kSecond + i * kPeriod);
  add_imu(kStart + kSecond, kStart + 3 * kSecond);
  const std::size_t before = overloaded();
  processor_.finish([&](FrameOutput&& output) {
    steady_ns_ += kProcessing;
    outputs_.push_back(std::move(output));
    return true;
  });
  EXPECT_EQ(overloaded(), before);
  EXPECT_EQ(processor_.waiting(), 0u);
}

TEST_F(ProcessorTest, BadConfigurationPassesFramesThroughUntilItIsCorrected) {
  processor_.set_config_error("noise_to_signal_ratio = -1 is outside [1e-05, 1]");
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::BAD_CONFIGURATION, "noise_to_signal_ratio = -1");
  EXPECT_EQ(logged("noise_to_signal_ratio = -1"), 1u);
  EXPECT_EQ(processor_.statistics().configuration_error, "noise_to_signal_ratio = -1 is outside [1e-05, 1]");
  configure();
  add_frame(kStart + kMs);
  advance();
  expect_deblurred(1);
}

TEST_F(ProcessorTest, ConfigurationThatCannotBeUsedChangesNothing) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  Config bad = config_;
  bad.pipeline.filter.noise_to_signal_ratio = 2;
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  bad = config_;
  bad.pipeline.keypoints.detector = "nonsense";
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  bad = config_;
  bad.R_cam_imu = -Eigen::Matrix3d::Identity();
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
}

TEST_F(ProcessorTest, DescriptorThatCannotDescribeChangesNothing) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  Config bad = config_;
  bad.pipeline.keypoints.detector = "SIFT";
  bad.pipeline.keypoints.descriptor = "ORB";
  EXPECT_THROW(processor_.set_config(bad), OptionError);
  add_frame(kStart);
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].keypoints->detector, "FAST");
  EXPECT_FALSE(outputs_[0].keypoints->keypoints.empty());
}

// Also with an OpenCV that lacks their detector.
TEST_F(ProcessorTest, DefaultKeypointsAreNoConditionForImages) {
  cv::setNumThreads(1);  // ThreadSanitizer does not see what orders OpenCV's threads
  config_.pipeline.keypoints = KeypointOptions();
  configure();
  add_imu(kStart - 50 * kMs, kStart + kSecond);
  const std::vector<std::string> available = available_detectors();
  const bool has_detector = std::count(available.begin(), available.end(), "SIFT") > 0;
  add_frame(kStart);
  add_frame(kStart + 2 * kSecond);  // passes through
  advance();
  time_out();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_deblurred(0);
  expect_passed_through(1, PassThroughReason::NO_GYRO, "");
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.keypoints->keypoints.empty(), !has_detector);
  EXPECT_EQ(logged("has no keypoints: keypoint_detector = SIFT"), has_detector ? 0u : 1u) << "and counted";
  EXPECT_EQ(processor_.statistics().keypoints_text.empty(), has_detector);
}

TEST_F(ProcessorTest, AbsentDeviceIsSaidOnceAndReplaced) {
  config_.pipeline.engine = "opencl:no such device";
  configure();
  add_imu(kStart - kSecond, kStart + kSecond);
  for (int i = 0; i < 3; ++i) add_frame(kStart + i * 100 * kMs);
  advance();
  ASSERT_EQ(outputs_.size(), 3u);
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NONE);
  EXPECT_EQ(logged("OpenCL failed"), 1u);
  EXPECT_EQ(processor_.statistics().engine.rfind("cpu-", 0), 0u) << processor_.statistics().engine;
}

TEST_F(ProcessorTest, ManyChangesOfParametersMakeNoNewEngine) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  add_frame(kStart);
  for (int i = 0; i < 100; ++i) {
    config_.pipeline.filter.noise_to_signal_ratio = 0.001 * (1 + i);
    config_.pipeline.keypoints.max_keypoints = 100 + i % 7;
    configure();
  }
  config_.pipeline.blur_field.block_size_px = 64;
  config_.pipeline.keypoints.descriptor = "BRISK";
  configure();
  advance();
  expect_deblurred(0);
  EXPECT_EQ(outputs_[0].field->grid.block_size_px(), 64) << "the last one counts";
  EXPECT_EQ(outputs_[0].keypoints->descriptor, "BRISK");
  EXPECT_EQ(engines_made_, 1);
  config_.pipeline.threads = 1;
  configure();
  EXPECT_EQ(engines_made_, 2);
}

TEST_F(ProcessorTest, FrameIsKeptWhenEvenPassingItThroughFails) {
  add_imu(kStart - 50 * kMs, kStart + 200 * kMs);
  const auto first = add_frame(kStart);
  add_frame(kStart + kMs);
  requests_to_fail_ = 1;
  EXPECT_THROW(advance(), std::bad_alloc);
  EXPECT_TRUE(outputs_.empty());
  EXPECT_EQ(processor_.waiting(), 2u);
  advance();
  ASSERT_EQ(outputs_.size(), 2u);
  expect_passed_through(0, PassThroughReason::INTERNAL_ERROR, "");
  EXPECT_EQ(outputs_[0].image, first);
  expect_deblurred(1);
  EXPECT_EQ(processor_.waiting(), 0u);
}

TEST_F(ProcessorTest, CamerasShareASourceAndKeepWhatIsTheirOwn) {
  const auto source = std::make_shared<GyroSource>(GyroSource::options_of(config_), [](LogLevel, const auto&) {});
  Processor::Environment environments[2] = {environment(), environment()};
  for (Processor::Environment& each : environments) each.gyro = source;
  Processor left(environments[0]), right(environments[1]);
  config_.R_cam_imu = Eigen::Matrix3d::Identity();
  left.set_config(config_);
  Config other = config_;
  other.gyro.time_offset_ns = 100 * kMs;
  other.R_cam_imu = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  right.set_config(other);
  const auto feed = [&](TimeNs from_ns, TimeNs to_ns) {
    for (TimeNs t_ns = from_ns; t_ns <= to_ns; t_ns += kImuPeriod) {
      const sensor_msgs::Imu imu = imu_message(t_ns, kFastRadS);
      if (!source->add(to_gyro_sample(imu), imu.header.frame_id)) continue;  // nobody is notified, as SharedImu does it
      for (Processor* camera : {&left, &right}) camera->on_imu_sample();
    }
  };
  const auto show = [](Processor* camera, TimeNs stamp_ns) {
    camera->add_camera_info(camera_info(stamp_ns));
    camera->add_image(image_message(stamp_ns));
  };
  std::vector<FrameOutput> of_left, of_right;
  const auto advance_both = [&] {
    const auto into = [](std::vector<FrameOutput>* outputs) {
      return [outputs](FrameOutput&& output) {
        outputs->push_back(std::move(output));
        return true;
      };
    };
    left.advance(into(&of_left));
    right.advance(into(&of_right));
  };
  for (Processor* camera : {&left, &right}) show(camera, kStart);
  feed(kStart - 50 * kMs, kStart + kFrameDuration);
  advance_both();
  EXPECT_EQ(of_left.size(), 1u);
  EXPECT_EQ(of_right.size(), 0u) << "its offset asks for later samples";
  feed(kStart + kFrameDuration + kImuPeriod, kStart + kFrameDuration + 100 * kMs);
  advance_both();
  ASSERT_EQ(of_right.size(), 1u);
  const auto center = [](const FrameOutput& output) {
    return output.field->blocks[static_cast<std::size_t>(output.field->grid.size() / 2)];
  };
  EXPECT_NEAR(std::cos(2 * (center(of_left[0]).angle_rad - center(of_right[0]).angle_rad)), -1, 0.1)
      << "each has its own rotation: 90 degrees apart";

  // One camera is reset; the other has what it had.
  left.reset();
  EXPECT_TRUE(left.statistics().gyro_available.empty());
  EXPECT_FALSE(right.statistics().gyro_available.empty());

  // The IMU's clock is set back: each camera is notified once.
  feed(kStart + kFrameDuration + 105 * kMs, kStart + kSecond);
  for (Processor* camera : {&left, &right}) show(camera, kStart + kSecond);
  feed(kStart - 50 * kMs, kStart + kSecond);
  for (Processor* camera : {&left, &right}) show(camera, kStart);
  advance_both();
  EXPECT_EQ(left.statistics().time_jumps, 1u);
  EXPECT_EQ(right.statistics().time_jumps, 1u);
  ASSERT_EQ(of_left.size(), 3u);
  ASSERT_EQ(of_right.size(), 3u);
  for (const auto* outputs : {&of_left, &of_right}) {
    EXPECT_STREQ(to_string((*outputs)[1].reason), "TIME_JUMP");
    EXPECT_STREQ(to_string((*outputs)[2].reason), "NONE");
  }
}

TEST_F(ProcessorTest, ThreadsMayFeedItAtOnce) {
  constexpr int kFrames = 60;
  constexpr TimeNs kPeriod = kExposure;
  const TimeNs last_imu_ns = kStart + kFrames * kPeriod + kFrameDuration;
  config_.frame_queue_size = kFrames;
  config_.input_timeout_ns = 10 * kSecond;
  configure();
  std::thread imu([&] { add_imu(kStart - 50 * kMs, last_imu_ns); });
  std::thread infos([&] {
    for (int i = 0; i < kFrames; ++i) processor_.add_camera_info(camera_info(kStart + i * kPeriod));
  });
  std::thread images([&] {
    for (int i = 0; i < kFrames; ++i) processor_.add_image(image_message(kStart + i * kPeriod));
  });
  std::thread owner([&] {
    for (int i = 0; i < 20; ++i) {
      configure();
      processor_.statistics();
    }
  });
  while (outputs_.size() < kFrames && processor_.statistics().time_jumps == 0) advance();
  for (std::thread* thread : {&imu, &infos, &images, &owner}) thread->join();
  ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(kFrames));
  for (std::size_t i = 0; i < outputs_.size(); ++i) {
    EXPECT_EQ(to_time_ns(outputs_[i].input->header.stamp), kStart + static_cast<TimeNs>(i) * kPeriod);
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << outputs_[i].reason_text;
  }
}

TEST_F(ProcessorTest, BiasAtRestIsLearnedAndUsed) {
  constexpr double kBiasRadS = 0.25;
  constexpr TimeNs kPeriod = 100 * kMs;
  config_.given.gyro_bias = false;
  configure();
  for (int i = 0; i < 35; ++i) {
    const TimeNs stamp_ns = kStart + i * kPeriod;
    add_imu(stamp_ns, stamp_ns + kPeriod - kImuPeriod, kBiasRadS);
    add_frame(stamp_ns);
    advance();
  }
  ASSERT_EQ(outputs_.size(), 35u);
  const auto extent_px = [](const FrameOutput& output) {
    const BlockGrid& grid = output.field->grid;  // the block next to the centre, where extents are least
    return output.field->blocks[static_cast<std::size_t>(grid.rows() / 2 * grid.cols() + grid.cols() / 2)].extent_px;
  };
  EXPECT_NEAR(extent_px(outputs_[1]), kFocalPx * kBiasRadS * to_seconds(kExposure), 0.1);
  EXPECT_NEAR(extent_px(outputs_.back()), 0, 0.1) << "without its bias the camera stands still";
  EXPECT_LT((processor_.statistics().bias_rad_s - Eigen::Vector3d(0, kBiasRadS, 0)).norm(), 0.005);
  EXPECT_EQ(logged("gyro_bias is estimated from the images and used"), 1u);
  config_.pipeline.blur_field.min_extent_px = 2;
  configure();
  processor_.reset();
  EXPECT_GT(processor_.statistics().bias_rad_s.norm(), 0.24) << "neither other parameters nor a reset change it";
  processor_.reset_calibration();
  EXPECT_EQ(processor_.statistics().bias_rad_s.norm(), 0);
}

TEST_F(ProcessorTest, ResetLetsWaitingFramesOutAndForgets) {
  add_imu(kStart - 50 * kMs, kStart);
  add_frame(kStart);
  processor_.reset();
  advance();
  expect_passed_through(0, PassThroughReason::TIME_JUMP, "reset");
  EXPECT_TRUE(processor_.statistics().gyro_available.empty());
  add_imu(kStart - 60 * kSecond, kStart - 60 * kSecond);
  EXPECT_EQ(processor_.statistics().time_jumps, 0u) << "any time may follow a reset";
}

}  // namespace
}  // namespace gyro_deblur::processor_test
