// Timing from images: simulated footage through the tracker.
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "calibrate/frame_tracker.hpp"
#include "calibrate/timing_calibration.hpp"
#include "sim/simulator.hpp"
#include "timing_truth.hpp"

namespace gyro_deblur::timing_footage_test {
namespace {

using namespace test;

void print_row(const std::string& name, const TimingEstimate& e, const Truth& t) {
  const Errors errors = errors_of(e, t);
  std::printf(
      "| %s | %.3f | %.3f +- %.3f | %.3f | %.3f +- %.3f (%+.2f %%) | [%.4f, %.4f, %.4f] | [%.4f, %.4f, %.4f] +- "
      "%.4f | %.3f | %.2f -> %.2f |\n",
      name.c_str(), 1e-6 * static_cast<double>(t.time_offset_ns), 1e3 * e.time_offset_s.value,
      1e3 * e.time_offset_s.stddev, 1e-6 * static_cast<double>(t.readout_ns), 1e3 * e.readout_s.value,
      1e3 * e.readout_s.stddev, errors.readout_percent, t.bias_rad_s.x(), t.bias_rad_s.y(), t.bias_rad_s.z(),
      e.bias_rad_s[0].value, e.bias_rad_s[1].value, e.bias_rad_s[2].value, e.bias_rad_s[0].stddev, errors.rotation_deg,
      e.median_without_px, e.median_px);
}

struct Case {
  const char* name;
  Truth truth;
  const char* model;
  std::vector<double> coefficients;
  double sway_m;  ///< sideways, at 2 m from the scene
};

sim::Scene scene_of(const Case& c, int frames) {
  sim::Scene scene;
  CameraCalibration& calibration = scene.camera.calibration;
  calibration.width_px = 376;
  calibration.height_px = 240;
  calibration.fx_px = 229.4;
  calibration.fy_px = 228.7;
  calibration.cx_px = 183.6;
  calibration.cy_px = 124.2;
  calibration.model = c.model;
  calibration.coefficients = c.coefficients;
  scene.camera.fps = 20;
  scene.camera.exposures_ns = {8'000'000, 12'000'000};
  scene.camera.readout_ns = c.truth.readout_ns;
  scene.camera.noise = 2;
  scene.imu.rate_hz = 200;
  scene.imu.gyro_bias_rad_s = c.truth.bias_rad_s;
  scene.imu.gyro_noise_rad_s = 0.003;
  scene.imu.time_offset_ns = c.truth.time_offset_ns;
  scene.imu.R_cam_imu = c.truth.R_cam_imu;
  sim::Plane wall;
  wall.texture = sim::procedural_texture(1400, 1000, 11);
  wall.width_m = 8.4;
  wall.height_m = 6.0;
  wall.center_m = {0, 0, 2};
  scene.planes = {wall};
  sim::VectorCurve angle, position;
  angle.sines = {{Eigen::Vector3d(4, 7, 2) * kDeg, 1.1, 0.2, {}},
                 {Eigen::Vector3d(-3, 2, 5) * kDeg, 1.7, 1.0, {}},
                 {Eigen::Vector3d(1, -2, 3) * kDeg, 0.4, 2.0, {}}};
  position.sines = {{Eigen::Vector3d(1, 0.6, 0.4) * c.sway_m, 0.7, 0.5, {}}};
  scene.motion = sim::make_curve_motion(angle, position);
  scene.frames = frames;
  scene.lead_ns = 800'000'000;
  return scene;
}

TEST(TimingFootage, MeetsTheLimits) {
  const std::vector<Case> cases{
      {"rolling, 25 ms",
       {4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})},
       "plumb_bob",
       {-0.28, 0.07, 0.0002, 0.00002},
       0},
      {"rolling, 33 ms, swaying",
       {-87'000'000, 33'000'000, {-0.03, 0.01, 0.02}, rotation({2.2, 2.2, 0})},
       "none",
       {},
       0.01},
      {"bottom-up, 20 ms, fisheye",
       {231'000'000, -20'000'000, {0.02, 0.02, -0.01}, rotation({-1.2, 1.2, -1.2})},
       "equidistant",
       {-0.01, 0.02, -0.01, 0.002},
       0},
      {"global", {0, 0, {0.05, -0.04, 0.0}, Eigen::Matrix3d::Identity()}, "none", {}, 0},
  };
  std::printf(
      "| footage | offset [ms] | estimate | readout [ms] | estimate | bias [rad/s] | estimate | rotation error [deg] | "
      "residual [px] |\n|---|---|---|---|---|---|---|---|---|\n");
  for (const Case& c : cases) {
    constexpr int kFrames = 60;
    sim::Simulator simulator(scene_of(c, kFrames));
    FrameTracker tracker(100);  // as calibrate
    for (int i = 0; i < kFrames; ++i) {
      const sim::Frame frame = simulator.frame(i);
      tracker.add({frame.stamp_ns, frame.timing.exposure_ns}, frame.image);
    }
    std::vector<GyroSample> samples;
    for (const sim::ImuSample& sample : simulator.imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
    const TimingEstimate estimate = estimate_timing(simulator.camera(), tracker.take(), samples, {});
    print_row(c.name, estimate, c.truth);
    SCOPED_TRACE(c.name);
    expect_close(errors_of(estimate, c.truth));
    if (c.truth.readout_ns == 0) {
      EXPECT_LT(std::abs(estimate.readout_s.value), 0.001);
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::timing_footage_test
