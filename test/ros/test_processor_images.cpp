// Optical flow with the gyroscope, or without one, from messages to messages.
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include "features/residual_rotation.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "processor_test.hpp"
#include "ros/calibration_conversion.hpp"
#include "ros/output_conversion.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::processor_images_test {
namespace {

using namespace test;

/// A camera that rotates, never at rest, and moves before a wall, 20 images a second.
class ProcessorImagesTest : public ProcessorTest {
 protected:
  ProcessorImagesTest() {
    request_.keypoints = false;
    now_ns_ = simulator_.scene().start_ns;
  }

  static sim::Scene scene() {
    return sim::parse_scene(YAML::Load(R"(
frames: 130
seed: 5
camera: {size: [320, 240], intrinsics: [200, 200, 159.5, 119.5], fps: 20, exposure_time: 0.03, readout_time: 0.02, noise: 2}
imu: {rate: 200}
planes: [{size: [12, 9], position: [0, 0, 2], texture_size: [2400, 1800], texture_seed: 4}]
motion: {type: curve, rotation: {sines: [{amplitude: [6, 0, 4], frequency: 1.3}, {amplitude: [0, 8, 3], frequency: 1.3, phase: 80}]},
  position: {sines: [{amplitude: [0.02, 0.02, 0.02], frequency: 0.8, phase: 70}]}}
)"),
                            "", "processor");
  }

  void SetUp() override {
    config_.pipeline.optical_flow = true;
    configure();
  }

  sensor_msgs::ImageConstPtr message_of(int i) {
    const sim::Frame frame = simulator_.frame(i);
    sensor_msgs::Image like;
    like.header.stamp = to_ros_time(frame.stamp_ns);
    like.header.frame_id = kCameraFrame;
    like.encoding = "mono8";
    return to_image(frame.image, like);
  }

  /// Frames `begin` to `end` with the samples outside `gap`, in the order of time; all leave.
  /// @param tracks_end  somebody listens to tracks up to this frame
  void play(int begin, int end, const TimeRange& gap, const Eigen::Vector3d& bias_rad_s = Eigen::Vector3d::Zero(),
            int tracks_end = 0) {
    std::size_t sample = 0;
    for (int i = begin; i < end; ++i) {
      request_.tracks = i < tracks_end;
      now_ns_ = simulator_.exposure(i).frame().end_ns + 20 * kMs;
      for (; sample < imu_.size() && imu_[sample].t_ns <= now_ns_; ++sample) {
        if (gap.contains(imu_[sample].t_ns)) continue;
        sensor_msgs::Imu imu;
        imu.header.stamp = to_ros_time(imu_[sample].t_ns);
        imu.header.frame_id = kImuFrame;
        const Eigen::Vector3d rate_rad_s =
            (config_.R_cam_imu ? config_.R_cam_imu->transpose() * imu_[sample].rate_rad_s : imu_[sample].rate_rad_s) +
            bias_rad_s;
        imu.angular_velocity.x = rate_rad_s.x();
        imu.angular_velocity.y = rate_rad_s.y();
        imu.angular_velocity.z = rate_rad_s.z();
        processor_.add_imu(imu);
      }
      processor_.add_image(message_of(i));
      if (const sensor_msgs::CameraInfoPtr info = camera_info_of(i)) processor_.add_camera_info(info);
      advance();
    }
    processor_.finish([this](FrameOutput&& output) {
      outputs_.push_back(std::move(output));
      return true;
    });
    ASSERT_EQ(outputs_.size(), static_cast<std::size_t>(end - begin));
  }

  /// Null where the camera sends none.
  sensor_msgs::CameraInfoPtr camera_info_of(int i) const {
    if (i < described_from_) return nullptr;
    const auto info = boost::make_shared<sensor_msgs::CameraInfo>(*camera_info(simulator_.stamp(i), 320, 240));
    if (i < calibrated_from_ || i == zeros_at_) info->K = {};
    if (i < rectified_from_) info->P = {};
    return info;
  }

  /// How far the paths of a frame's blocks are from the true ones [px]; of a line, whose direction has no sign.
  std::vector<double> errors_px(int i, const FrameBlur& field) const {
    std::vector<double> errors;
    for (int b = 0; b < field.grid.size(); ++b) {
      const BlockBlur& block = field.blocks[b];
      const Eigen::Vector2d truth = simulator_.recorded_displacement(i, field.grid.center(b));
      if (block.status == BlockStatus::NO_GYRO || !truth.allFinite()) continue;
      const Eigen::Vector2d path =
          block.extent_px * Eigen::Vector2d(std::cos(block.angle_rad), std::sin(block.angle_rad));
      errors.push_back(std::min((path - truth).norm(), (path + truth).norm()));
    }
    return errors;
  }

  int described_from_ = 0;   // image from which camera_info comes
  int calibrated_from_ = 0;  // image from which it has a calibration
  int rectified_from_ = 0;   // image from which it has one of rectified images
  int zeros_at_ = -1;        // a message without one
  sim::Simulator simulator_{scene()};
  const std::vector<sim::ImuSample> imu_ = simulator_.imu();
};

double percentile(std::vector<double> values, double part) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

constexpr int kGapBegin = 8, kGapEnd = 18, kFrames = 24;  // half a second

TEST_F(ProcessorImagesTest, AGapOfTheGyroscopePassesUnlessTheImagesBridgeIt) {
  const TimeRange gap{simulator_.stamp(kGapBegin) + kMs, simulator_.stamp(kGapEnd) - 6 * kMs};
  play(0, kFrames, gap);
  const std::vector<FrameOutput> off = std::move(outputs_);
  outputs_.clear();
  for (int i = kGapBegin; i < kGapEnd; ++i) EXPECT_EQ(off[i].reason, PassThroughReason::NO_GYRO) << i;
  EXPECT_EQ(processor_.statistics().frames_by_images_alone, 0u);

  processor_.reset();
  config_.pipeline.flow_without_gyro = "always";
  configure();
  play(0, kFrames, gap);
  std::vector<double> errors, truths;
  for (int i = 0; i < kFrames; ++i) {
    const FrameOutput& output = outputs_[i];
    ASSERT_EQ(output.reason, PassThroughReason::NONE) << i << output.reason_text;
    if (i < kGapBegin || i >= kGapEnd) {
      EXPECT_EQ(output.image->data, off[i].image->data) << i;
      EXPECT_EQ(output.blur_field->extent, off[i].blur_field->extent) << i;
      EXPECT_EQ(output.blur_field->source, off[i].blur_field->source) << i;
      EXPECT_EQ(output.blur_field->residual_x, off[i].blur_field->residual_x) << i;
      EXPECT_EQ(output.reason_text, off[i].reason_text) << i;
      continue;
    }
    EXPECT_EQ(output.reason_text.rfind("optical flow alone: frame needs gyroscope samples from", 0), 0u)
        << output.reason_text;
    EXPECT_EQ(output.blur_field->reason_text, output.reason_text);
    for (std::size_t b = 0; b < output.field->blocks.size(); ++b) {
      const bool known = output.field->blocks[b].status != BlockStatus::NO_GYRO;
      EXPECT_EQ(output.blur_field->source[b], known ? BlurField::SOURCE_IMAGES_ALONE : BlurField::SOURCE_GYROSCOPE);
    }
    for (const double error : errors_px(i, *output.field)) errors.push_back(error);
    for (int b = 0; b < output.field->grid.size(); ++b) {
      truths.push_back(simulator_.recorded_displacement(i, output.field->grid.center(b)).norm());
    }
  }
  EXPECT_EQ(processor_.statistics().frames_by_images_alone, static_cast<std::size_t>(kGapEnd - kGapBegin));
  EXPECT_GT(errors.size(), truths.size() * 8 / 10);
  EXPECT_GT(percentile(truths, 0.5), 4);
  EXPECT_LT(percentile(errors, 0.5), 0.5);
  EXPECT_LT(percentile(errors, 0.9), 1.5);
}

TEST_F(ProcessorImagesTest, ImagesCarryACameraWhoseGyroscopeNeverSpeaks) {
  play(0, 6, {imu_.front().t_ns, imu_.back().t_ns});
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NO_GYRO) << "nothing to follow corners from";
  for (int i = 1; i < 6; ++i) {
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << i;
    EXPECT_NE(outputs_[i].image, outputs_[i].input) << i;
  }
  const auto problems = processor_.statistics().input_problems;
  ASSERT_EQ(problems.count("no imu"), 1u);
  EXPECT_NE(problems.at("no imu").text.find("deblurred by optical flow alone"), std::string::npos);
  EXPECT_EQ(logged("optical flow alone"), 1u) << "said once";
}

// The gyroscope's rates are no velocities in pixels while the focal length is not known.
TEST_F(ProcessorImagesTest, ImagesCarryACameraThatIsNotCalibrated) {
  request_.keypoints = request_.markers = true;
  play(0, kFrames, {imu_.front().t_ns, imu_.back().t_ns});  // calibrated, without gyroscope
  const std::vector<FrameOutput> calibrated = std::move(outputs_);
  outputs_.clear();
  processor_.reset();
  calibrated_from_ = kFrames;
  play(0, kFrames, {}, Eigen::Vector3d::Zero(), kFrames);

  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NO_CALIBRATION) << "nothing to follow corners from";
  EXPECT_EQ(outputs_[0].reason_text, "the camera is not calibrated, and optical flow shows no certain motion");
  std::vector<double> errors;
  for (int i = 1; i < kFrames; ++i) {
    const FrameOutput& output = outputs_[i];
    ASSERT_EQ(output.reason, PassThroughReason::NONE) << i << output.reason_text;
    EXPECT_EQ(output.reason_text, "optical flow alone: the camera is not calibrated");
    ASSERT_TRUE(output.field && output.field->images_alone) << i;
    for (const double error : errors_px(i, *output.field)) errors.push_back(error);
    // As with a calibration, but for the perspective of a few degrees.
    for (std::size_t b = 0; b < output.field->blocks.size(); ++b) {
      if (output.field->blocks[b].status == BlockStatus::NO_GYRO) continue;
      EXPECT_NEAR(output.field->blocks[b].extent_px, calibrated[i].field->blocks[b].extent_px, 0.3) << i << ", " << b;
    }
    EXPECT_EQ(output.camera_info->K[0], 0);
    EXPECT_FALSE(output.keypoints->keypoints.empty());
    for (const Keypoint& keypoint : output.keypoints->keypoints) EXPECT_TRUE(std::isnan(keypoint.normalized_x));
    EXPECT_EQ(output.tracks, nullptr) << "a track is made of rays";
    EXPECT_EQ(output.markers->markers.size(), no_markers({})->markers.size());
  }
  EXPECT_LT(percentile(errors, 0.5), 0.5);
  EXPECT_LT(percentile(errors, 0.9), 1.5);
  const auto problem = processor_.statistics().input_problems.at("no calibration");
  EXPECT_NE(problem.text.find("deblurred by optical flow alone"), std::string::npos);
  EXPECT_NE(problem.text.find("set calibration_file"), std::string::npos);
  EXPECT_TRUE(problem.active);
  EXPECT_EQ(logged("camera is not calibrated (K[0] = 0)"), 1u) << "said once";

  // It is calibrated while the node runs.
  calibrated_from_ = kFrames;
  outputs_.clear();
  play(kFrames, kFrames + 4, {}, Eigen::Vector3d::Zero(), kFrames + 4);
  for (const FrameOutput& output : outputs_) {
    EXPECT_FALSE(output.field->images_alone);
    EXPECT_NE(output.tracks, nullptr);
  }
  EXPECT_FALSE(processor_.statistics().input_problems.at("no calibration").active);
}

TEST_F(ProcessorImagesTest, ImagesCarryACameraWithoutCameraInfo) {
  constexpr int kDescribedFrom = 34, kEnd = 40;
  described_from_ = kDescribedFrom;
  play(0, kDescribedFrom, {});
  int alone = 0;
  for (const FrameOutput& output : outputs_) {
    alone += output.reason == PassThroughReason::NONE && output.field->images_alone;
    EXPECT_EQ(output.camera_info->K[0], 0);
  }
  EXPECT_GE(alone, kDescribedFrom - 2);
  EXPECT_EQ(logged("no camera_info has come"), 1u);
  EXPECT_EQ(logged("without feature_tracks"), 1u);

  outputs_.clear();
  play(kDescribedFrom, kEnd, {});
  for (const FrameOutput& output : outputs_) {
    EXPECT_EQ(output.reason, PassThroughReason::NONE) << output.reason_text;
    EXPECT_FALSE(output.field->images_alone);
  }
  EXPECT_FALSE(processor_.statistics().input_problems.at("no camera_info").active);
}

// A file describes raw images, and K does.
TEST_F(ProcessorImagesTest, RectifiedImagesHaveTheirCalibrationFromPAlone) {
  config_.rectified_input = true;
  config_.calibration.emplace();
  config_.calibration->camera = to_calibration(*camera_info(0, 320, 240), 320, 240, false);
  configure();
  constexpr int kDescribedFrom = 16, kRectifiedFrom = 20, kEnd = 24;
  described_from_ = kDescribedFrom;
  rectified_from_ = kRectifiedFrom;
  calibrated_from_ = kEnd;
  play(0, kEnd, {});
  for (int i = 1; i < kEnd; ++i) {
    ASSERT_EQ(outputs_[i].reason, PassThroughReason::NONE) << i << outputs_[i].reason_text;
    EXPECT_EQ(outputs_[i].field->images_alone, i < kRectifiedFrom) << i;
  }
  EXPECT_EQ(logged("camera is not calibrated (P[0] = 0)"), 1u);
  EXPECT_EQ(logged("calibration_file"), 0u) << "which would not help";
}

TEST_F(ProcessorImagesTest, AMessageOfZerosDoesNotMakeACameraUncalibrated) {
  constexpr int kZeros = 6, kEnd = 12;
  zeros_at_ = kZeros;
  play(0, kEnd, {});
  for (int i = 1; i < kEnd; ++i) {
    const PassThroughReason expected = i == kZeros ? PassThroughReason::NO_CALIBRATION : PassThroughReason::NONE;
    ASSERT_EQ(outputs_[i].reason, expected) << i << outputs_[i].reason_text;
    if (i != kZeros) {
      EXPECT_FALSE(outputs_[i].field->images_alone) << i;
    }
  }
}

TEST_F(ProcessorImagesTest, ARepetitionDoesNotTakeTheMotionWithoutCalibrationForItsOwn) {
  constexpr int kImages = 6;
  calibrated_from_ = kImages;
  play(0, kImages, {});
  EXPECT_TRUE(outputs_.back().field->images_alone);
  const TimeNs again_ns = simulator_.stamp(kImages - 1) + 10 * kMs;
  const auto again = boost::make_shared<sensor_msgs::Image>(*outputs_.back().input);
  again->header.stamp = to_ros_time(again_ns);
  processor_.add_image(again);
  processor_.add_camera_info(camera_info(again_ns, 320, 240));
  advance();
  ASSERT_EQ(outputs_.size(), kImages + 1u);
  EXPECT_EQ(outputs_.back().reason, PassThroughReason::NONE) << outputs_.back().reason_text;
  EXPECT_FALSE(outputs_.back().field->images_alone);
}

TEST_F(ProcessorImagesTest, NeverMeansThatImagesWithoutACalibrationPass) {
  config_.pipeline.flow_without_gyro = "never";
  configure();
  calibrated_from_ = 6;
  play(0, 6, {});
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NO_CALIBRATION);
}

TEST_F(ProcessorImagesTest, NeverMeansThatImagesWithoutAGyroscopePass) {
  config_.pipeline.flow_without_gyro = "never";
  configure();
  play(0, 6, {imu_.front().t_ns, imu_.back().t_ns});
  for (const FrameOutput& output : outputs_) EXPECT_EQ(output.reason, PassThroughReason::NO_GYRO);
  EXPECT_EQ(processor_.statistics().input_problems.at("no imu").text.find("optical flow"), std::string::npos);
}

constexpr int kSilentFrom = 8;
constexpr int kWaiting = 22;                             // images of the second in which it may be a gap
constexpr int kByFlowFrom = kSilentFrom + kWaiting + 8;  // with those that wait at that time

// From image 8 on it is silent for 2.5 s, and comes again.
TEST_F(ProcessorImagesTest, ImagesCarryACameraWhileItsGyroscopeIsSilent) {
  constexpr int kSilentTo = 58, kEnd = 64;
  play(0, kEnd, {simulator_.stamp(kSilentFrom) - kMs, simulator_.stamp(kSilentTo) - kMs});
  int passed = 0, alone = 0;
  for (int i = 0; i < kEnd; ++i) {
    const bool by_flow = outputs_[i].field && outputs_[i].field->images_alone;
    alone += by_flow;
    if (outputs_[i].reason != PassThroughReason::NONE) {
      ++passed;
      EXPECT_EQ(outputs_[i].reason, PassThroughReason::NO_GYRO) << i;
    }
    if (i < kSilentFrom || i > kSilentTo + 1) {
      EXPECT_FALSE(by_flow) << i;
    }
  }
  EXPECT_LE(passed, kWaiting + 2);
  EXPECT_GE(alone, kSilentTo - kSilentFrom - kWaiting - 2);
  EXPECT_EQ(logged("the IMU has been silent since"), 1u) << "said once";
  const auto problems = processor_.statistics().input_problems;
  ASSERT_EQ(problems.count("imu silent"), 1u);
  EXPECT_FALSE(problems.at("imu silent").active) << "it has come again";
}

// As a camera at more than 60 images a second does, whose images fill the queue in half a second.
TEST_F(ProcessorImagesTest, AQueueThatIsFullBeforeItTimesOutSeesThatTheGyroscopeIsSilent) {
  constexpr int kEnd = 64;
  config_.frame_queue_size = 4;
  configure();
  play(0, kEnd, {simulator_.stamp(kSilentFrom) - kMs, imu_.back().t_ns + kMs});
  EXPECT_EQ(outputs_[kSilentFrom + 1].reason, PassThroughReason::OVERLOAD) << "the queue is full first";
  for (int i = kByFlowFrom; i < kEnd; ++i) {
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << i << outputs_[i].reason_text;
  }
}

TEST_F(ProcessorImagesTest, ImagesNeedNoRotationToAGyroscopeThatIsSilent) {
  constexpr int kEnd = 64;
  config_.R_cam_imu.reset();
  config_.self_calibration = SelfCalibrationMode::NEVER;
  configure();
  play(0, kEnd, {simulator_.stamp(kSilentFrom) - kMs, imu_.back().t_ns + kMs});
  EXPECT_EQ(outputs_[0].reason, PassThroughReason::NO_EXTRINSIC);
  for (int i = kByFlowFrom; i < kEnd; ++i) {
    EXPECT_EQ(outputs_[i].reason, PassThroughReason::NONE) << i << outputs_[i].reason_text;
  }
}

TEST_F(ProcessorImagesTest, SeesMotionAfterSomebodyHasCeasedToListenToTracks) {
  constexpr int kTracksEnd = 5, kEnd = kTracksEnd + 30;  // a second and a half later
  play(0, kEnd, {}, Eigen::Vector3d::Constant(0.1), kTracksEnd);
  ASSERT_TRUE(outputs_.back().field);
  const auto& blocks = outputs_.back().field->blocks;
  EXPECT_GT(std::count_if(blocks.begin(), blocks.end(), [](const BlockBlur& b) { return b.residual.has_value(); }), 10);
}

TEST_F(ProcessorTest, AnImageThatMayBeAtRestIsNotTouchedByImagesAlone) {
  config_.pipeline.optical_flow = true;
  configure();
  for (int i = 0; i < 3; ++i) add_frame(kStart + i * 50 * kMs);
  now_ns_ += 200 * kMs;
  time_out();
  for (std::size_t i = 0; i < 3; ++i) expect_passed_through(i, PassThroughReason::NO_GYRO, "there are none");
}

TEST_F(ProcessorImagesTest, ABiasIsReportedInTheGyroscopesAxes) {
  config_.R_cam_imu = Eigen::AngleAxisd(1.2, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
  configure();
  const Eigen::Vector3d bias_rad_s(0.05, 0.05, -0.05);
  play(0, 130, {}, bias_rad_s);
  const auto error = processor_.statistics().gyro_error;
  ASSERT_TRUE(error);
  EXPECT_EQ(error->kind, GyroError::Kind::BIAS);
  EXPECT_LT((error->vector - bias_rad_s).cwiseAbs().maxCoeff(), 0.01) << error->vector.transpose();
  EXPECT_GT(processor_.statistics().blocks_from_images, 0u);
  configure();
  EXPECT_FALSE(processor_.statistics().gyro_error) << "begins anew";
}

}  // namespace
}  // namespace gyro_deblur::processor_images_test
