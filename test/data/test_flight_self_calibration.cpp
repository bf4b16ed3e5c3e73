// What a camera that flies through a room learns of its IMU, and how soon: recorded trajectories through the simulator.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "calibrate/image_rate.hpp"
#include "calibrate/self_calibration.hpp"
#include "flight_timing.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur {
namespace {

/// What is to be met: it costs one to three percent of the matches.
constexpr double kOffsetMs = 5, kRotationDeg = 5, kBiasRadS = 0.02, kReadoutMs = 4;

/// Of a lens that is not known; the distortion of EuRoC's lens shortens it by some percent.
constexpr double kShortestFocal = 0.88, kLongestFocal = 1.08;

/// What is known of the lens at first.
enum class Given { INTRINSICS, NOTHING };

/// The calibration estimated in a flight, with nothing given but exposure times, and the intrinsics or not.
/// @param flight   of test::recorded_flights()
/// @param known_s  rotation and offset have to be known before that
void expect_learned(std::size_t flight, double seconds, double speed, TimeNs exposure_ns, TimeNs readout_ns,
                    double known_s, Given given = Given::INTRINSICS) {
  const std::string folder = GYRO_DEBLUR_DATA_DIR;
  if (!std::filesystem::exists(folder + "/trajectories")) GTEST_SKIP() << "no " << folder << "/trajectories";
  const test::FlightCase c{test::recorded_flights().at(flight), seconds, speed, exposure_ns, readout_ns};
  sim::Simulator simulator(test::flight_scene(c, folder));
  const sim::ImuModel& imu = simulator.scene().imu;
  const std::vector<sim::ImuSample> samples = simulator.imu();
  // The middle row of a readout that is not known is exposed later by half of it.
  const double offset_s = to_seconds(imu.time_offset_ns + readout_ns / 2);
  ImageRateTracker tracker;
  SelfCalibration calibration;
  std::size_t next = 0;
  double since_s = 0;
  const bool lens_known = given == Given::INTRINSICS;
  const CameraCalibration& truth = simulator.camera().calibration();
  CameraCalibration assumed = truth;
  if (!lens_known) {
    assumed.model = "none";
    assumed.coefficients.clear();
    assumed.fx_px = assumed.fy_px = 0.7 * assumed.width_px;
    assumed.cx_px = 0.5 * (assumed.width_px - 1);
    assumed.cy_px = 0.5 * (assumed.height_px - 1);
  }
  for (int i = 0; i < simulator.frames(); ++i) {
    const sim::Frame frame = simulator.frame(i);
    for (; next < samples.size() && samples[next].t_ns <= frame.stamp_ns; ++next) {
      calibration.add_sample({samples[next].t_ns, samples[next].rate_rad_s});
    }
    const RowExposure exposure(frame.stamp_ns, frame.image.rows, {exposure_ns, 0});
    if (const auto rate = tracker.add(frame.image, Camera(assumed), exposure, lens_known)) calibration.add_rate(*rate);
    if (!calibration.is_due()) continue;
    calibration.update();
    const LearnedCalibration& learned = calibration.learned();
    const double t_s = to_seconds(frame.stamp_ns - simulator.stamp(0));
    if (since_s == 0 && learned.R_cam_imu.known && learned.time_offset_s.known) since_s = t_s;
    const double off_ms = 1e3 * std::abs(learned.time_offset_s.value - offset_s);
    const double off_deg =
        Eigen::AngleAxisd(Eigen::Matrix3d(learned.R_cam_imu.value.transpose() * imu.R_cam_imu)).angle() * 180 / M_PI;
    const double off_rad_s = (learned.bias_rad_s.value - imu.gyro_bias_rad_s).norm();
    if (learned.time_offset_s.known) {
      EXPECT_LT(off_ms, kOffsetMs) << "at " << t_s << " s";
    }
    if (learned.R_cam_imu.known) {
      EXPECT_LT(off_deg, kRotationDeg) << "at " << t_s << " s";
    }
    if (learned.bias_rad_s.known) {
      EXPECT_LT(off_rad_s, kBiasRadS) << "at " << t_s << " s";
    }
    if (learned.focal_length.known) {
      EXPECT_FALSE(lens_known);
      EXPECT_GT(learned.focal_length.value * truth.width_px / truth.fx_px, kShortestFocal) << "at " << t_s << " s";
      EXPECT_LT(learned.focal_length.value * truth.width_px / truth.fx_px, kLongestFocal) << "at " << t_s << " s";
    }
  }
  EXPECT_GT(since_s, 0);
  EXPECT_LT(since_s, known_s);
  const LearnedCalibration& learned = calibration.learned();
  EXPECT_TRUE(learned.readout_s.known) << learned.readout_s.missing;
  EXPECT_NEAR(1e-6 * static_cast<double>(readout_ns), 1e3 * learned.readout_s.value, kReadoutMs);
  EXPECT_TRUE(learned.focal_length.known || lens_known) << learned.focal_length.missing;
  std::printf("known after %.1f s; offset %.2f ms, readout %.2f ms, focal length %.0f %% of the true one\n", since_s,
              1e3 * (learned.time_offset_s.value - offset_s), 1e3 * learned.readout_s.value,
              lens_known ? 100 : 100 * learned.focal_length.value * truth.width_px / truth.fx_px);
}

TEST(FlightSelfCalibration, Euroc) { expect_learned(0, 8, 1, 15'000'000, 0, 6); }
TEST(FlightSelfCalibration, EurocFastLongExposureRollingShutter) {
  expect_learned(0, 12, 1.7, 30'000'000, 20'000'000, 6);
}
TEST(FlightSelfCalibration, EurocOther) { expect_learned(1, 8, 1, 30'000'000, 0, 6); }
TEST(FlightSelfCalibration, HandHeldRollingShutter) { expect_learned(2, 10, 1, 15'000'000, 20'000'000, 6); }
TEST(FlightSelfCalibration, EurocWithoutIntrinsics) { expect_learned(0, 12, 1, 15'000'000, 0, 6, Given::NOTHING); }
TEST(FlightSelfCalibration, EurocOtherWithoutIntrinsics) {
  expect_learned(1, 12, 1.7, 30'000'000, 0, 6, Given::NOTHING);
}
TEST(FlightSelfCalibration, HandHeldRollingShutterWithoutIntrinsics) {
  expect_learned(2, 12, 1, 15'000'000, 20'000'000, 6, Given::NOTHING);
}

}  // namespace
}  // namespace gyro_deblur
