// The exposure of simulated recordings.
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "calibrate/recorded_exposure.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::recording_exposure_test {
namespace {

constexpr TimeNs kMs = 1'000'000;
constexpr int kFrames = 24;

/// A camera that rotates on the spot before a wall, as fast as `speed` times 2 rad/s.
sim::Scene rotating_camera(const std::vector<TimeNs>& exposures_ns, double speed) {
  sim::Scene scene;
  CameraCalibration& calibration = scene.camera.calibration;
  calibration.width_px = 376;
  calibration.height_px = 240;
  calibration.fx_px = calibration.fy_px = 229;
  calibration.cx_px = 183.6;
  calibration.cy_px = 124.2;
  calibration.model = "none";
  scene.camera.fps = 20;
  scene.camera.exposures_ns = exposures_ns;
  scene.camera.readout_ns = 15 * kMs;
  scene.camera.noise = 2;
  scene.imu.rate_hz = 200;
  sim::Plane wall;
  wall.texture = sim::procedural_texture(1400, 1000, 11);
  wall.width_m = 8.4;
  wall.height_m = 6.0;
  wall.center_m = {0, 0, 2};
  scene.planes = {wall};
  sim::VectorCurve angle;
  angle.sines = {{Eigen::Vector3d(0.14, 0.25, 0.07) * speed, 1.1, 0.2, {}},
                 {Eigen::Vector3d(-0.1, 0.07, 0.17) * speed, 1.7, 1.0, {}}};
  scene.motion = sim::make_curve_motion(angle, {});
  scene.frames = kFrames;
  return scene;
}

/// @param exposures_ns  of the frames in turn
RecordedExposure recorded(const std::vector<TimeNs>& exposures_ns, double speed, bool with_gyro,
                          double given_over_true = 0) {
  sim::Simulator simulator(rotating_camera(exposures_ns, speed));
  std::optional<RotationTrack> motion;
  if (with_gyro) {
    std::vector<GyroSample> samples;
    for (const sim::ImuSample& sample : simulator.imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
    motion.emplace(samples, GyroOptions(), Eigen::Matrix3d::Identity());
  }
  ShutterTiming shutter;
  shutter.readout_ns = 15 * kMs;
  RecordedExposureEstimator estimator(simulator.camera().calibration(), shutter, {}, std::move(motion));
  for (int i = 0; i < kFrames; ++i) {
    const sim::Frame frame = simulator.frame(i);
    const TimeNs true_ns = frame.timing.exposure_ns;
    std::optional<TimeNs> given_ns;
    if (given_over_true > 0) given_ns = std::llround(given_over_true * static_cast<double>(true_ns));
    estimator.add(frame.stamp_ns, frame.stamp_ns + true_ns / 2, frame.image, PixelLayout::GRAY, given_ns);
  }
  return estimator.result();
}

/// exposures_ns in the order of frames: one for each.
std::vector<TimeNs> gliding() {
  std::vector<TimeNs> exposures_ns;
  for (int i = 0; i < kFrames; ++i) exposures_ns.push_back(std::llround(12e6 * std::pow(2.5, i / (kFrames - 1.0))));
  return exposures_ns;
}

TEST(RecordedExposure, IsThatOfTheCamera) {
  for (const bool with_gyro : {true, false}) {
    SCOPED_TRACE(with_gyro);
    const RecordedExposure exposure = recorded({20 * kMs}, 1, with_gyro);
    ASSERT_TRUE(exposure.is_known);
    EXPECT_FALSE(exposure.varies);
    EXPECT_GT(exposure.estimates, 10U);
    const double log_error = std::log(static_cast<double>(exposure.exposure_ns) / (20.0 * kMs));
    EXPECT_LT(std::abs(log_error), with_gyro ? 0.03 : 0.1);
    EXPECT_LT(std::abs(log_error), 3 * exposure.log_stddev);
    EXPECT_LT(exposure.log_stddev, with_gyro ? 0.02 : 0.07);
    EXPECT_EQ(exposure.exposure_of(exposure.images[3].stamp_ns), exposure.exposure_ns);
  }
}

TEST(RecordedExposure, SpectrumHasTheZerosOfThePath) {
  const RecordedExposure exposure = recorded({20 * kMs}, 1, true);
  const auto log_power = [&exposure](double waves) {
    for (const ExposureSpectrumPoint& point : exposure.spectrum) {
      if (std::abs(point.waves - waves) < 0.01) return point.log_power;
    }
    ADD_FAILURE() << "nothing at " << waves;
    return 0.0;
  };
  EXPECT_LT(log_power(1.05), log_power(1.35) - 0.5);
  EXPECT_LT(log_power(1.95), log_power(2.35) - 0.3);
}

TEST(RecordedExposure, ThatVariesHasARange) {
  const RecordedExposure exposure = recorded(gliding(), 1.2, true);
  ASSERT_TRUE(exposure.is_known);
  EXPECT_TRUE(exposure.varies);
  EXPECT_LT(exposure.low_ns, 17 * kMs);
  EXPECT_GT(exposure.high_ns, 24 * kMs);
  const std::vector<TimeNs> truth_ns = gliding();
  const TimeNs last_ns = exposure.exposure_of(exposure.images.back().stamp_ns);
  EXPECT_NEAR(static_cast<double>(last_ns) / static_cast<double>(truth_ns.back()), 1, 0.1);
}

TEST(RecordedExposure, OfSharpImagesIsNotKnown) {
  for (const bool with_gyro : {true, false}) {
    const RecordedExposure exposure = recorded({20 * kMs}, 0.05, with_gyro);
    EXPECT_FALSE(exposure.is_known);
    EXPECT_EQ(exposure.missing, ExposureNeed::MOTION);
    EXPECT_EQ(exposure.exposure_of(exposure.images[3].stamp_ns), 0);
  }
}

TEST(RecordedExposure, IsComparedWithMessages) {
  for (const double given_over_true : {1.0, 0.5}) {
    const RecordedExposure exposure = recorded({20 * kMs}, 1, true, given_over_true);
    ASSERT_TRUE(exposure.over_given);
    EXPECT_NEAR(exposure.over_given->ratio * given_over_true, 1, 0.03);
  }
}

}  // namespace
}  // namespace gyro_deblur::recording_exposure_test
