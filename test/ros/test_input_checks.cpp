// What inputs show to be wrong, and that log, list and frames say the same.
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "message_builders.hpp"
#include "processor_test.hpp"

namespace gyro_deblur::input_checks_test {
namespace {

using namespace test;

Exposure exposure_message(TimeNs stamp_ns, TimeNs exposure_ns, TimeNs readout_ns = 0) {
  Exposure exposure;
  exposure.header.stamp = to_ros_time(stamp_ns);
  exposure.exposure_time.fromNSec(exposure_ns);
  exposure.readout_time.fromNSec(readout_ns);
  return exposure;
}

class InputChecksTest : public ProcessorTest {
 protected:
  static constexpr TimeNs kPeriod = 50 * kMs;

  /// The text of a problem that is there and was logged; empty: it is not there.
  std::string problem(const std::string& kind) {
    const auto problems = processor_.statistics().input_problems;
    const auto found = problems.find(kind);
    if (found == problems.end() || !found->second.active) return "";
    EXPECT_GE(logged(found->second.text), 1u) << "the log says the same";
    return found->second.text;
  }
  void expect_problem(const std::string& kind, const std::vector<std::string>& parts) {
    const std::string text = problem(kind);
    for (const std::string& part : parts) EXPECT_NE(text.find(part), std::string::npos) << kind << ": " << text;
  }
  std::size_t count(PassThroughReason reason) const {
    std::size_t found = 0;
    for (const FrameOutput& output : outputs_) found += output.reason == reason;
    return found;
  }
  /// Frames at a steady rate, with samples up to each one's end, and the clocks go on.
  template <typename BeforeEach>
  void play(int from, int to, BeforeEach before_each) {
    for (int i = from; i < to; ++i) {
      const TimeNs stamp_ns = kStart + i * kPeriod;
      before_each(i, stamp_ns);
      add_imu(stamp_ns, stamp_ns + kPeriod - kImuPeriod);
      add_frame(stamp_ns);
      now_ns_ += kPeriod;
      steady_ns_ += kPeriod;
      advance();
    }
  }
  void play(int from, int to) {
    play(from, to, [](int, TimeNs) {});
  }
};

TEST_F(InputChecksTest, WhatOfACalibrationFileIsNotUnderstoodIsAProblemUntilItIsCorrected) {
  config_.calibration.emplace();
  config_.calibration->notes = {"/a.yaml: cam0.line_delay is not known", "/a.yaml: cam0.T_camera_imu is not known"};
  configure();
  const std::vector<std::string> both{"cam0.line_delay is not known; ", "cam0.T_camera_imu is not known"};
  expect_problem("calibration file", both);
  processor_.reset();
  expect_problem("calibration file", both);
  config_.calibration->notes.clear();
  configure();
  EXPECT_EQ(problem("calibration file"), "");
}

// --- exposure ---

TEST_F(InputChecksTest, ExposureAboveTheFramePeriodIsRefusedByValue) {
  play(0, 40, [this](int, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, 200 * kMs)); });
  // An exposure that long waits for samples while the period becomes known: nothing is deblurred by it.
  EXPECT_EQ(count(PassThroughReason::NONE), 0u);
  EXPECT_GE(count(PassThroughReason::NO_EXPOSURE_TIME), 35u);
  expect_passed_through(10, PassThroughReason::NO_EXPOSURE_TIME,
                        "the exposure message's exposure_time = 0.2 s is longer than the frame period 0.05 s: is its "
                        "unit right?");
  expect_problem("exposure", {"0.2 s", "frame period 0.05 s", "unit"});
  play(40, 45, [this](int, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, 20 * kMs)); });
  EXPECT_EQ(problem("exposure"), "") << "corrected";
  expect_deblurred(outputs_.size() - 1);
}

TEST_F(InputChecksTest, ParameterAboveTheFramePeriodIsNamedWithinASecond) {
  config_.shutter.exposure_ns = 200 * kMs;
  config_.on_exposure_conflict = OnExposureConflict::CONFIGURED;
  configure();
  play(0, 20);
  expect_problem("exposure_time", {"exposure_time = 0.2 s is longer than the frame period 0.05 s: is its unit right?"});
  EXPECT_EQ(problem("exposure_time").find("not used"), std::string::npos);
  EXPECT_EQ(count(PassThroughReason::NONE), 0u);
  expect_passed_through(outputs_.size() - 1, PassThroughReason::BAD_CONFIGURATION, "exposure_time = 0.2 s");
  config_.shutter.exposure_ns = 20 * kMs;
  configure();
  play(20, 30);
  EXPECT_EQ(problem("exposure_time"), "");
  expect_deblurred(outputs_.size() - 1);
}

TEST_F(InputChecksTest, ParameterAboveTheFramePeriodIsLeftToTheImages) {
  config_.shutter.exposure_ns = 200 * kMs;
  configure();
  play(0, 20);
  expect_problem("exposure_time", {"exposure_time = 0.2 s is longer than the frame period 0.05 s", "It is not used"});
  expect_passed_through(outputs_.size() - 1, PassThroughReason::NO_EXPOSURE_TIME, "is not known yet");
}

TEST_F(InputChecksTest, ExposureOfTheWholeFramePeriodIsAccepted) {
  config_.shutter.exposure_ns = kPeriod;
  config_.shutter.readout_ns = 0;
  configure();
  play(0, 100);
  EXPECT_GE(count(PassThroughReason::NONE), 98u);
  EXPECT_EQ(outputs_.size() - count(PassThroughReason::NONE), 0u);
  EXPECT_TRUE(processor_.statistics().input_problems.empty());
}

TEST_F(InputChecksTest, ImpossibleExposuresAreNamedByTheirSource) {
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  processor_.add_exposure(exposure_message(kStart, -5 * kMs));
  add_frame(kStart);
  advance();
  expect_passed_through(0, PassThroughReason::NO_EXPOSURE_TIME, "the exposure message's exposure_time = -0.005");
  expect_problem("exposure", {"-0.005 is outside [1e-06, 1] s", "exposure_source"});
  processor_.add_exposure(exposure_message(kStart + kMs, 20));  // seconds taken for microseconds
  add_frame(kStart + kMs);
  advance();
  expect_passed_through(1, PassThroughReason::NO_EXPOSURE_TIME, "2e-08 is outside");
  processor_.add_exposure_setting(33000 * kMs);
  add_frame(kStart + 2 * kMs);
  advance();
  expect_passed_through(2, PassThroughReason::NO_EXPOSURE_TIME, "the driver's exposure setting = 33 is outside");
}

// Before their first auto exposure drivers publish 0.
TEST_F(InputChecksTest, ExposureOfZeroIsNotKnownAndTheParameterServes) {
  play(0, 5, [this](int, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, 0, 10 * kMs)); });
  ASSERT_EQ(outputs_.size(), 5u) << "none waits";
  for (std::size_t i = 0; i < 5; ++i) {
    expect_deblurred(i);
    EXPECT_EQ(outputs_[i].field->exposure_ns, kExposure);
    EXPECT_EQ(outputs_[i].field->readout_ns, 10 * kMs) << "of the message: it is known";
  }
  expect_problem("exposure 0", {"0 s, taken as not known", "exposure_time = 0.030000000 s"});
  play(5, 8, [this](int, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, 20 * kMs)); });
  EXPECT_EQ(outputs_.back().field->exposure_ns, 20 * kMs);
  EXPECT_EQ(problem("exposure 0"), "");
}

TEST_F(InputChecksTest, ExposureOfZeroBetweenOnesThatAgreeIsTheirs) {
  play(0, 10,
       [this](int i, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, i == 5 ? 0 : 20 * kMs)); });
  ASSERT_EQ(outputs_.size(), 10u);
  for (const FrameOutput& output : outputs_) {
    ASSERT_TRUE(output.field);
    EXPECT_EQ(output.field->exposure_ns, 20 * kMs);
  }
}

TEST_F(InputChecksTest, ExposureOfZeroWithoutParameterSaysSo) {
  config_.shutter.exposure_ns = 0;
  configure();
  play(0, 5, [this](int, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, 0)); });
  ASSERT_GE(outputs_.size(), 3u);
  expect_passed_through(0, PassThroughReason::NO_EXPOSURE_TIME, "the exposure time is not known yet");
  expect_problem("exposure 0", {"0 s, taken as not known", "by the estimate from their blur"});
}

TEST_F(InputChecksTest, SettingOfZeroIsNotKnown) {
  exposure_expected_ = true;
  config_.shutter.readout_ns = 0;
  configure();
  processor_.add_exposure_setting(0);
  play(0, 3);
  ASSERT_EQ(outputs_.size(), 3u) << "none waits";
  EXPECT_EQ(outputs_[0].field->exposure_ns, kExposure);
  processor_.add_exposure_setting(20 * kMs);
  play(3, 4);
  EXPECT_EQ(outputs_[3].field->exposure_ns, 20 * kMs);
}

// --- what never comes ---

/// The simulated clock stands: only the steady one goes on.
class StoppedClockTest : public InputChecksTest {
 protected:
  void pass_steady(TimeNs duration_ns) {
    for (TimeNs end_ns = steady_ns_ + duration_ns; steady_ns_ < end_ns; steady_ns_ += 20 * kMs) advance();
  }
};

TEST_F(StoppedClockTest, NoExposureTimeIsReportedWithinASecond) {
  exposure_expected_ = true;
  config_.shutter.exposure_ns = 0;
  configure();
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  add_frame(kStart);
  pass_steady(400 * kMs);
  EXPECT_EQ(problem("no exposure time"), "");
  pass_steady(400 * kMs);
  expect_problem("no exposure time", {"exposure_time is not set", "no exposure message", "exposure_source"});
  EXPECT_EQ(logged("exposure_time is not set"), 1u);
  processor_.add_exposure(exposure_message(kStart, 20 * kMs));
  advance();
  EXPECT_EQ(problem("no exposure time"), "");
  expect_deblurred(0);
}

TEST_F(StoppedClockTest, NoCameraInfoNoImuAndNoExtrinsicAreReportedWithinASecond) {
  config_.R_cam_imu.reset();
  configure();
  processor_.add_image(image_message(kStart));
  pass_steady(800 * kMs);
  expect_problem("no camera_info", {"no camera_info has come 0.6 s after the first image", "calibration_file"});
  expect_problem("no imu", {"no IMU message with angular rates", "connect imu"});
  EXPECT_EQ(problem("no exposure time"), "") << "the parameter has it";
  processor_.add_camera_info(camera_info(kStart));
  add_imu(kStart - 50 * kMs, kStart + 100 * kMs);
  pass_steady(40 * kMs);
  EXPECT_EQ(problem("no camera_info") + problem("no imu"), "");
  expect_problem("no extrinsic", {"\"imu\"", "\"camera\"", "R_cam_imu", "static transform"});
  extrinsic_ = Eigen::Matrix3d::Identity();
  advance();
  expect_deblurred(0);
  EXPECT_EQ(problem("no extrinsic"), "");
}

TEST_F(InputChecksTest, WhereEverythingComesNothingIsReported) {
  exposure_expected_ = true;
  play(0, 40, [this](int, TimeNs stamp_ns) { processor_.add_exposure(exposure_message(stamp_ns, 20 * kMs)); });
  EXPECT_TRUE(processor_.statistics().input_problems.empty());
  EXPECT_EQ(count(PassThroughReason::NONE), outputs_.size());
}

// --- IMU ---

TEST_F(InputChecksTest, SlowImuIsReportedByItsPeriod) {
  constexpr TimeNs kSlow = 100 * kMs;
  for (TimeNs t_ns = kStart - kSlow; t_ns <= kStart + 2 * kSecond; t_ns += kSlow) {
    processor_.add_imu(imu_message(t_ns, kFastRadS));
  }
  expect_problem("imu rate", {"every 0.1 s", "max_gyro_gap is 0.05 s", "100 Hz"});
  EXPECT_EQ(logged("far from those of the samples around it"), logged("imu sample dropped"))
      << "only before it is known";
  EXPECT_LE(processor_.statistics().imu_stray, 6u);
  add_frame(kStart + kSecond);
  advance();
  expect_passed_through(0, PassThroughReason::NO_GYRO, "farther apart than max_gyro_gap = 0.050000000 s");
  add_imu(kStart + 2 * kSecond + kImuPeriod, kStart + 3 * kSecond);
  EXPECT_EQ(problem("imu rate"), "") << "raised";
}

TEST_F(InputChecksTest, RatesBeyondAnyGyroscopeAskForTheirUnit) {
  add_imu(kStart, kStart + 100 * kMs, 160);
  expect_problem("imu unit", {"160 \"rad/s\"", "2000 degrees/s", "34.9", "degrees/s?", "sensor_msgs/Imu has rad/s"});
  EXPECT_EQ(logged("are they in degrees/s"), 1u);
  add_imu(kStart + 105 * kMs, kStart + 6 * kSecond, 2);
  EXPECT_EQ(problem("imu unit"), "");
}

TEST_F(InputChecksTest, AFewWrongRatesAreNoUnit) {
  for (int i = 0; i < 1000; ++i) {
    processor_.add_imu(imu_message(kStart + i * kImuPeriod, i % 200 == 0 ? 300 : 1));
  }
  EXPECT_TRUE(processor_.statistics().input_problems.empty());
  config_.gyro.range_rad_s = 70;  // a fast one
  configure();
  add_imu(kStart + 10 * kSecond, kStart + 11 * kSecond, 60);
  EXPECT_TRUE(processor_.statistics().input_problems.empty());
}

TEST_F(InputChecksTest, ImuWithoutRatesIsReportedAtOnce) {
  sensor_msgs::Imu imu = imu_message(kStart, 0);
  imu.angular_velocity_covariance[0] = -1;
  processor_.add_imu(imu);
  expect_problem("imu without gyroscope", {"angular_velocity_covariance[0] = -1", "unite_imu_method"});
  add_imu(kStart + kImuPeriod, kStart + 200 * kMs);
  EXPECT_EQ(problem("imu without gyroscope"), "");
}

// --- clocks ---

constexpr TimeNs kYears = 50LL * 365 * 24 * 3600 * kSecond;

TEST_F(InputChecksTest, ClocksYearsApartAreReportedWithTheOffsetAndWorkWithIt) {
  const auto play_apart = [this](int from, int to) {
    for (int i = from; i < to; ++i) {
      const TimeNs stamp_ns = kStart + i * kPeriod;
      add_imu(stamp_ns + kYears, stamp_ns + kYears + kPeriod - kImuPeriod);
      add_frame(stamp_ns);
      now_ns_ += kPeriod;
      steady_ns_ += kPeriod;
      advance();
    }
  };
  play_apart(0, 18);
  expect_problem("clocks", {"do not overlap", "1576800000.0", "behind", "time_offset: 1576800000.0"});
  config_.gyro.time_offset_ns = kYears;
  configure();
  const std::size_t before = outputs_.size();
  play_apart(18, 40);
  EXPECT_EQ(problem("clocks"), "");
  ASSERT_GT(outputs_.size(), before + 15);
  expect_deblurred(outputs_.size() - 1);
}

TEST_F(InputChecksTest, ClocksApartTheOtherWay) {
  for (int i = 0; i < 18; ++i) {
    const TimeNs stamp_ns = kYears + kStart + i * kPeriod;
    add_imu(kStart + i * kPeriod, kStart + (i + 1) * kPeriod - kImuPeriod);
    add_frame(stamp_ns);
    steady_ns_ += kPeriod;
    advance();
  }
  expect_problem("clocks", {"do not overlap", "ahead", "time_offset: -1576799999.9"});
}

TEST_F(InputChecksTest, StreamsThatPauseAreNoClocksApart) {
  play(0, 10);
  for (int i = 0; i < 200; ++i) {  // the camera pauses
    add_imu(kStart + (10 + i) * kPeriod, kStart + (11 + i) * kPeriod - kImuPeriod);
    steady_ns_ += kPeriod;
    now_ns_ += kPeriod;
    advance();
  }
  play(210, 220);
  for (int i = 220; i < 300; ++i) {  // the IMU pauses
    add_frame(kStart + i * kPeriod);
    steady_ns_ += kPeriod;
    now_ns_ += kPeriod;
    advance();
  }
  play(300, 320);
  EXPECT_EQ(problem("clocks"), "");
  EXPECT_EQ(logged("do not overlap"), 0u);
}

}  // namespace
}  // namespace gyro_deblur::input_checks_test
