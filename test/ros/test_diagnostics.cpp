#include "ros/diagnostics.hpp"

#include <chrono>
#include <map>
#include <string>
#include <utility>

#include <gtest/gtest.h>
#include <boost/make_shared.hpp>

#include "features/residual_rotation.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur::diagnostics_test {
namespace {

using diagnostic_msgs::DiagnosticStatus;

class DiagnosticReportTest : public testing::Test {
 protected:
  DiagnosticReportTest() { report_.start({}, time_); }

  using Status = diagnostic_updater::DiagnosticStatusWrapper DiagnosticStatuses::*;

  /// The values of all statuses of the report after `seconds` more. Level and summary are those of `of`; the other
  /// statuses are OK.
  std::map<std::string, std::string> fill(double seconds = 1, Status of = &DiagnosticStatuses::image) {
    time_ += std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
    statuses_ = report_.fill({statistics_, 2, node_ns_, time_});
    level_ = (statuses_.*of).level;
    summary_ = (statuses_.*of).message;
    std::map<std::string, std::string> values;
    for (const Status status : {&DiagnosticStatuses::image, &DiagnosticStatuses::imu, &DiagnosticStatuses::calibration,
                                &DiagnosticStatuses::timing}) {
      if (status != of) {
        EXPECT_EQ((statuses_.*status).level, DiagnosticStatus::OK) << (statuses_.*status).message;
        EXPECT_EQ((statuses_.*status).message, "running");
      }
      for (const auto& value : (statuses_.*status).values) {
        EXPECT_TRUE(values.emplace(value.key, value.value).second) << value.key;
      }
    }
    return values;
  }

  DiagnosticReport report_;
  DiagnosticReport::Time time_;
  TimeNs node_ns_ = 0;
  ProcessorStatistics statistics_;
  int level_ = -1;
  std::string summary_;
  DiagnosticStatuses statuses_;
};

TEST_F(DiagnosticReportTest, RatesAreThoseSinceTheReportBefore) {
  statistics_.frames_in = 100;
  statistics_.frames_out = 80;
  statistics_.imu_accepted = 400;
  auto values = fill(2);
  EXPECT_EQ(values["input rate [Hz]"], "50.0");
  EXPECT_EQ(values["output rate [Hz]"], "40.0");
  EXPECT_EQ(values["gyroscope rate [Hz]"], "200.0");
  statistics_.frames_in += 30;
  values = fill(1);
  EXPECT_EQ(values["input rate [Hz]"], "30.0");
  EXPECT_EQ(values["output rate [Hz]"], "0.0");
  EXPECT_EQ(values["frames in"], "130");
  EXPECT_EQ(values["cameras on this gyroscope"], "2");
  EXPECT_EQ(level_, DiagnosticStatus::OK);
  EXPECT_EQ(summary_, "running");
}

TEST_F(DiagnosticReportTest, FramesThatPassThroughWarnOnceWithARemedy) {
  statistics_.passed_through[PassThroughReason::NO_GYRO] = 3;
  auto values = fill();
  EXPECT_EQ(values["passed through, NO_GYRO"], "3");
  EXPECT_EQ(level_, DiagnosticStatus::WARN);
  EXPECT_NE(summary_.find("3 frames passed through: NO_GYRO; check that the IMU publishes"), std::string::npos)
      << summary_;
  values = fill();
  EXPECT_EQ(values["passed through, NO_GYRO"], "3");
  EXPECT_EQ(level_, DiagnosticStatus::OK) << "none since";
}

TEST_F(DiagnosticReportTest, ImagesThatAreLeftOutWarnOnce) {
  const std::string key = "compressed images left out, not decodable";
  EXPECT_EQ(fill().count(key), 0u);
  statistics_.undecodable_images = 2;
  EXPECT_EQ(fill()[key], "2");
  EXPECT_EQ(level_, DiagnosticStatus::WARN);
  EXPECT_NE(summary_.find("2 compressed images could not be decoded and have no output"), std::string::npos)
      << summary_;
  EXPECT_EQ(fill()[key], "2");
  EXPECT_EQ(level_, DiagnosticStatus::OK) << "none since";
}

TEST_F(DiagnosticReportTest, KeypointsThatCannotBeFoundAreAnError) {
  statistics_.keypoints_text = "keypoint_detector = SIFT: OpenCV 4.2.0 has none";
  fill();
  EXPECT_EQ(level_, DiagnosticStatus::ERROR);
  EXPECT_NE(summary_.find("no keypoints: keypoint_detector = SIFT: OpenCV 4.2.0 has none"), std::string::npos)
      << summary_;
  statistics_.keypoints_text.clear();
  fill();
  EXPECT_EQ(level_, DiagnosticStatus::OK);
}

TEST_F(DiagnosticReportTest, GradesAndScoresAreThoseOfThePeriod) {
  auto values = fill();
  EXPECT_EQ(values.count("score of images, mean"), 0u);
  EXPECT_EQ(values.count("images dropped, POOR"), 0u);
  FrameOutput output;
  output.quality = boost::make_shared<ImageQuality>();
  for (const auto& [grade, score] : {std::pair{ImageQuality::DEBLURRED, 0.5f},
                                     {ImageQuality::DEBLURRED, 0.75f},
                                     {ImageQuality::POOR, 0.1f},
                                     {ImageQuality::UNKNOWN, -1.f}}) {
    output.quality->grade = grade;
    output.quality->score = score;
    report_.add(output);
  }
  values = fill();
  for (const char* share : {"DEBLURRED 50", "POOR 25", "UNKNOWN 25"}) {
    EXPECT_NE(values["images [%]"].find(share), std::string::npos) << values["images [%]"];
  }
  EXPECT_EQ(values["images [%]"].find("SHARP"), std::string::npos);
  EXPECT_EQ(values["score of images, mean"], "0.45") << "of those that have one";
  EXPECT_EQ(fill().count("images [%]"), 0u) << "none since";
  EXPECT_EQ(level_, DiagnosticStatus::OK) << "POOR images alone are no fault";
}

TEST_F(DiagnosticReportTest, DroppedImagesWarnWithTheParameter) {
  FrameOutput output;
  output.dropped = true;
  statistics_.count(output);
  statistics_.count(output);
  EXPECT_EQ(statistics_.frames_out, 0u);
  EXPECT_EQ(fill()["images dropped, POOR"], "2");
  EXPECT_EQ(level_, DiagnosticStatus::WARN);
  EXPECT_NE(summary_.find("2 images dropped by drop_poor"), std::string::npos) << summary_;
  EXPECT_EQ(fill()["images dropped, POOR"], "2");
  EXPECT_EQ(level_, DiagnosticStatus::OK) << "none since";
}

TEST_F(DiagnosticReportTest, ExposureIsAdvisedForFastFramesOfThePeriod) {
  EXPECT_EQ(fill().count("longest exposure that is undone well [ms]"), 0u);
  ExposureTerms terms;
  terms.exposure_ns = 10'000'000;
  terms.noise_to_contrast = 0.05;
  const auto add = [&] {
    for (int i = 0; i < 20; ++i) {
      FrameOutput output;
      terms.speed_px_s = 20.0 * (i * 7 % 20 + 1);  // 20 to 400, in disorder
      output.exposure_terms = terms;
      report_.add(output);
    }
  };
  add();
  auto values = fill();
  EXPECT_EQ(values["speed of the image, p90 [px/s]"], "380");
  terms.speed_px_s = 380;
  const auto advice = advise_exposure(terms, 1'000'000'000);
  EXPECT_NEAR(std::stod(values["longest exposure that is undone well [ms]"]), to_seconds(advice->longest_ns) * 1e3,
              .05);
  EXPECT_NEAR(std::stod(values["exposure with most corners [ms]"]), to_seconds(advice->best_ns) * 1e3, .05);
  EXPECT_EQ(fill().count("longest exposure that is undone well [ms]"), 0u) << "no frame since";
  statistics_.frame_period_ns = 5'000'000;
  add();
  EXPECT_EQ(fill()["longest exposure that is undone well [ms]"], "5.0") << "the frame period";
  statistics_.frame_period_ns.reset();
  terms.noise_to_contrast = 1;
  for (int i = 0; i < 5; ++i) add();
  FrameOutput fast;
  terms.speed_px_s = 20'000;
  fast.exposure_terms = terms;
  for (int i = 0; i < 100; ++i) report_.add(fast);
  EXPECT_EQ(fill()["longest exposure that is undone well [ms]"].rfind("none: POOR at any", 0), 0u);
}

TEST_F(DiagnosticReportTest, MostlyRejectedBlocksWarn) {
  statistics_.blocks = {{BlockStatus::DEBLURRED, 50}, {BlockStatus::REJECTED, 50}};
  EXPECT_NE(fill()["blocks"].find("REJECTED 50"), std::string::npos);
  EXPECT_EQ(level_, DiagnosticStatus::OK) << "half of them";
  statistics_.blocks = {{BlockStatus::DEBLURRED, 60}, {BlockStatus::REJECTED, 61}};
  fill();
  EXPECT_EQ(level_, DiagnosticStatus::WARN);
  EXPECT_NE(summary_.find("11 of 21 blurred blocks rejected"), std::string::npos) << summary_;
}

TEST_F(DiagnosticReportTest, BlocksThatLeftTheFastPathAreCountedByReason) {
  EXPECT_EQ(fill().count("blocks on the float engine"), 0u);
  statistics_.fallback_counts = {{"gain", 7}, {"length", 2}};
  auto values = fill();
  EXPECT_EQ(values["blocks on the float engine"], "gain 7, length 2");
}

TEST_F(DiagnosticReportTest, ConfigurationThatCannotBeUsedIsAnError) {
  statistics_.configuration_error = "noise_to_signal_ratio = -1 is outside [1e-05, 1]";
  EXPECT_EQ(fill()["engine"], "none");
  EXPECT_EQ(level_, DiagnosticStatus::ERROR);
  EXPECT_EQ(summary_, "noise_to_signal_ratio = -1 is outside [1e-05, 1]");
}

TEST_F(DiagnosticReportTest, GyroscopeBufferAndItsAge) {
  EXPECT_EQ(fill()["gyroscope buffer [s]"], "empty");
  node_ns_ = 12'500'000'000;
  statistics_.gyro_available = {10'000'000'000, 12'000'000'000};
  auto values = fill();
  EXPECT_EQ(values["gyroscope buffer [s]"], "2.000");
  EXPECT_EQ(values["gyroscope age [s]"], "0.500");
}

TEST_F(DiagnosticReportTest, TimesAreThoseOfThePeriod) {
  FrameOutput output;
  output.waiting_ms = 10;
  output.total_ms = 4;
  report_.add(output);  // passed through: no stage ran
  output.waiting_ms = 30;
  output.field.emplace();
  output.times.deconvolution_ms = 2.5;
  report_.add(output);
  auto values = fill();
  EXPECT_EQ(values["waiting mean [ms]"], "20.00");
  EXPECT_EQ(values["waiting max [ms]"], "30.00");
  EXPECT_EQ(values["deconvolution mean [ms]"], "2.50");
  EXPECT_EQ(values.count("tracks mean [ms]"), 0u);
  EXPECT_EQ(fill().count("waiting mean [ms]"), 0u);
}

TEST_F(DiagnosticReportTest, OpticalFlowIsCountedAndItsSizeTold) {
  auto values = fill();
  EXPECT_EQ(values.count("blocks with optical flow"), 0u);
  EXPECT_EQ(values.count("optical flow, median [px]"), 0u);
  FrameOutput output;
  output.field.emplace();
  output.field->exposure_ns = 20'000'000;
  output.field->blocks.resize(8);
  for (int i = 0; i < 5; ++i) output.field->blocks[i].residual = ResidualVelocity{{30.0 * (i + 1), 40.0 * (i + 1)}, 5};
  output.residual_rotation.emplace();
  output.residual_rotation->rate_rad_s = {0.25, 0, -0.5};
  report_.add(output);
  output.residual_rotation->rate_rad_s = {0.75, 0, -0.5};
  report_.add(output);
  statistics_.count(output);
  values = fill();
  EXPECT_EQ(values["blocks with optical flow"], "5");
  EXPECT_EQ(values["optical flow, median [px]"], "3.00");
  EXPECT_EQ(values["residual rotation, mean [rad/s]"], "[0.500000, 0.000000, -0.500000]");
  EXPECT_EQ(level_, DiagnosticStatus::OK);
  values = fill();
  EXPECT_EQ(values["blocks with optical flow"], "5");
  EXPECT_EQ(values.count("optical flow, median [px]"), 0u) << "none since";
  EXPECT_EQ(values.count("residual rotation, mean [rad/s]"), 0u);
}

TEST_F(DiagnosticReportTest, AnErrorOfTheGyroscopeWarnsWithTheRemedy) {
  const auto summary_has = [&](const std::string& part) {
    fill(1, &DiagnosticStatuses::imu);
    EXPECT_EQ(level_, DiagnosticStatus::WARN);
    EXPECT_NE(summary_.find(part), std::string::npos) << summary_;
  };
  statistics_.bias_rad_s = {0.01, 0, 0};
  statistics_.gyro_error.emplace();
  statistics_.gyro_error->vector = {0.05, 0, -0.05};
  statistics_.gyro_error->seconds = 9.9;
  summary_has("the images rotate by [-0.050000, -0.000000, 0.050000] rad/s relative to the gyroscope for 10 s: a bias");
  summary_has(
      "leave gyro_bias empty and let the camera rest for a while, or set gyro_bias to [0.060000, 0.000000, -0.050000]");
  statistics_.gyro_error->kind = GyroError::Kind::EXTRINSIC;
  summary_has("R_cam_imu is off by about 4.1 deg");
  statistics_.gyro_error->kind = GyroError::Kind::TIME_OFFSET;
  statistics_.gyro_error->time_offset_s = -0.015;
  summary_has("after the gyroscope for 10 s: add -0.0150 s to time_offset");
  statistics_.gyro_error.reset();
  fill();
  EXPECT_EQ(level_, DiagnosticStatus::OK);
}

TEST_F(DiagnosticReportTest, ProblemsOfInputsBelongToTheirStatus) {
  const auto warns = [&](const std::string& kind, Status status) {
    statistics_.input_problems = {{kind, {LogLevel::WARNING, "text of " + kind, 1, true}}};
    fill(1, status);
    EXPECT_EQ(level_, DiagnosticStatus::WARN) << kind;
    EXPECT_EQ(summary_, "text of " + kind);
  };
  warns("imu unit by images", &DiagnosticStatuses::imu);
  warns("no imu", &DiagnosticStatuses::imu);
  warns("clocks", &DiagnosticStatuses::timing);
  for (const char* kind : {"no extrinsic", "R_cam_imu by images", "exposure stamp", "camera_info size", "readout_time",
                           "calibration file", "no calibration"}) {
    warns(kind, &DiagnosticStatuses::calibration);
  }
  for (const char* kind : {"mask size", "repeated pictures", "static content", "compressed image"}) {
    warns(kind, &DiagnosticStatuses::image);
  }
}

TEST_F(DiagnosticReportTest, LossesComeFirst) {
  statistics_.frames_in = statistics_.frames_out = 10;
  statistics_.imu_accepted = 100;
  FrameOutput output;
  output.field.emplace();
  report_.add(output);
  fill();
  EXPECT_EQ(statuses_.image.values.front().key, "output rate [Hz]");
  EXPECT_EQ(statuses_.imu.values.front().key, "gyroscope rate [Hz]");
  EXPECT_EQ(statuses_.timing.values.front().key, "processing mean [ms]");
  statistics_.passed_through[PassThroughReason::NO_GYRO] = 1;
  statistics_.imu_stray = 2;
  statistics_.time_jumps = 3;
  fill();
  EXPECT_EQ(statuses_.image.values.front().key, "passed through, NO_GYRO");
  EXPECT_EQ(statuses_.imu.values.front().key, "imu dropped, stray stamp");
  EXPECT_EQ(statuses_.timing.values.front().key, "time jumps");
}

// As many different ones as there can be without a warning.
TEST_F(DiagnosticReportTest, HealthyStatusesHaveAtMost15Values) {
  statistics_.frames_in = statistics_.frames_out = 1000;
  statistics_.waiting = 1;
  statistics_.imu_accepted = 10000;
  statistics_.gyro_available = {10'000'000'000, 12'000'000'000};
  statistics_.engine = "cpu";
  statistics_.blocks_from_images = 5;
  statistics_.fallback_counts = {{"gain", 7}, {"length", 2}, {"noise", 1}};
  for (const BlockStatus status :
       {BlockStatus::SHARP, BlockStatus::DEBLURRED, BlockStatus::TOO_LARGE, BlockStatus::NOISY, BlockStatus::TOO_CURVED,
        BlockStatus::MASKED, BlockStatus::STATIC_EDGE, BlockStatus::NO_GYRO, BlockStatus::REJECTED}) {
    statistics_.blocks[status] = 9;
  }
  for (const char* key : {"R_cam_imu", "time_offset", "readout_time", "gyro_bias"}) {
    statistics_.calibration.push_back({key, "known", false});
  }
  for (const std::uint8_t grade : {ImageQuality::DEBLURRED, ImageQuality::SHARP, ImageQuality::POOR}) {
    FrameOutput output;
    output.quality = boost::make_shared<ImageQuality>();
    output.quality->grade = grade;
    output.quality->score = 0.5f;
    output.exposure.emplace();
    output.exposure->origin = ExposureOrigin::IMAGES;
    output.exposure->exposure_ns = 10'000'000;
    output.exposure->log_stddev = 0.1;
    output.exposure_terms.emplace();
    output.exposure_terms->exposure_ns = 10'000'000;
    output.exposure_terms->speed_px_s = 100;
    output.exposure_terms->noise_to_contrast = 0.05;
    output.field.emplace();
    output.field->exposure_ns = 10'000'000;
    output.field->blocks.resize(1);
    output.field->blocks[0].residual = ResidualVelocity{{30.0, 40.0}, 5};
    output.residual_rotation.emplace();
    output.tracks = boost::make_shared<sensor_msgs::PointCloud>();
    output.global_shutter = boost::make_shared<sensor_msgs::Image>();
    report_.add(output);
  }
  fill();
  EXPECT_EQ(level_, DiagnosticStatus::OK) << summary_;
  for (const auto* status : {&statuses_.image, &statuses_.imu, &statuses_.calibration, &statuses_.timing}) {
    EXPECT_LE(status->values.size(), 15u);
    EXPECT_GE(status->values.size(), 4u);
    for (const auto& value : status->values) EXPECT_NE(value.value, "0") << value.key;
  }
}

TEST(OutputStatistics, AddsUpWhatLeaves) {
  OutputStatistics statistics;
  FrameOutput output;
  output.fallback_counts = {{"gain", 3}};
  statistics.count(output);
  output.fallback_counts = {{"gain", 2}, {"length", 1}};
  output.reason = PassThroughReason::NO_GYRO;
  statistics.count(output);
  EXPECT_EQ(statistics.frames_out, 2u);
  EXPECT_EQ(statistics.passed_through, (std::map<PassThroughReason, std::size_t>{{PassThroughReason::NO_GYRO, 1}}));
  EXPECT_EQ(statistics.fallback_counts, (std::map<std::string, std::size_t>{{"gain", 5}, {"length", 1}}));
}

}  // namespace
}  // namespace gyro_deblur::diagnostics_test
