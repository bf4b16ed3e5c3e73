// The calibration of timing on a simulated flight, against what is true.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "calibrate/frame_tracker.hpp"
#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "room_flight.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::test {

struct FlightCase {
  RecordedFlight flight;
  double seconds = 40;
  double speed = 1;  ///< 1: as recorded
  TimeNs exposure_ns = 15'000'000, readout_ns = 20'000'000;
  int width_px = 376;  ///< of the image; the camera is EuRoC's of 752x480
  std::uint64_t seed = 1;
};

inline sim::Scene flight_scene(const FlightCase& c, const std::string& folder) {
  sim::Scene scene = room_flight_scene(c.flight, folder, c.seconds, c.speed);
  const double scale = c.width_px / 752.0;
  CameraCalibration& calibration = scene.camera.calibration;
  calibration.width_px = c.width_px;
  calibration.height_px = static_cast<int>(480 * scale);
  calibration.fx_px = 458.654 * scale;
  calibration.fy_px = 457.296 * scale;
  calibration.cx_px = (367.215 + 0.5) * scale - 0.5;
  calibration.cy_px = (248.375 + 0.5) * scale - 0.5;
  calibration.model = "plumb_bob";
  calibration.coefficients = {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05};
  scene.camera.exposures_ns = {c.exposure_ns};
  scene.camera.readout_ns = c.readout_ns;
  scene.camera.noise = 1.5;
  scene.imu.rate_hz = 200;
  scene.imu.gyro_bias_rad_s = {0.012, -0.021, 0.033};
  scene.imu.gyro_noise_rad_s = 0.003;
  scene.imu.time_offset_ns = 7'300'000;
  scene.imu.R_cam_imu = so3_exp({0.02, -0.03, 0.015}).toRotationMatrix() * c.flight.R_cam_imu;
  scene.seed = c.seed;
  return scene;
}

/// Estimate less truth: offset, readout [s], bias [rad/s], rotation vector [rad] about the camera's axes.
using TimingErrors = Eigen::Matrix<double, 8, 1>;

struct FlightTiming {
  TimingEstimate estimate;
  TimingErrors errors, stddevs;

  double offset_ms() const { return 1e3 * std::abs(errors[0]); }
  double readout_ms() const { return 1e3 * std::abs(errors[1]); }
  double bias_rad_s() const { return errors.segment<3>(2).cwiseAbs().maxCoeff(); }
  double rotation_deg() const { return errors.tail<3>().norm() * 180 / M_PI; }
  /// Mean of the squares of the errors in standard deviations: about 1 where these are right.
  double normalised_square() const { return errors.cwiseQuotient(stddevs).squaredNorm() / 8; }
};

/// Renders, tracks and estimates, from nothing but the intrinsics.
inline FlightTiming calibrate_flight(const FlightCase& c, const std::string& folder) {
  sim::Simulator simulator(flight_scene(c, folder));
  FrameTracker tracker(100);  // as calibrate
  for (int i = 0; i < simulator.frames(); ++i) {
    const sim::Frame frame = simulator.frame(i);
    tracker.add({frame.stamp_ns, frame.timing.exposure_ns}, frame.image);
  }
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& sample : simulator.imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
  const sim::ImuModel& imu = simulator.scene().imu;
  FlightTiming timing;
  timing.estimate = estimate_timing(simulator.camera(), tracker.take(), samples, {});
  const TimingEstimate& e = timing.estimate;
  const Eigen::AngleAxisd rotation_error(Eigen::Matrix3d(e.R_cam_imu * imu.R_cam_imu.transpose()));
  timing.errors << e.time_offset_s.value - to_seconds(imu.time_offset_ns), e.readout_s.value - to_seconds(c.readout_ns),
      e.bias_rad_s[0].value - imu.gyro_bias_rad_s[0], e.bias_rad_s[1].value - imu.gyro_bias_rad_s[1],
      e.bias_rad_s[2].value - imu.gyro_bias_rad_s[2], rotation_error.angle() * rotation_error.axis();
  timing.stddevs << e.time_offset_s.stddev, e.readout_s.stddev, e.bias_rad_s[0].stddev, e.bias_rad_s[1].stddev,
      e.bias_rad_s[2].stddev, e.rotation_stddev_rad;
  return timing;
}

}  // namespace gyro_deblur::test
