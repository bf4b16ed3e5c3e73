// What a calibration of the timing is to find, and by how much it misses it.
#pragma once

#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur::test {

constexpr double kDeg = M_PI / 180;

/// What is to be found.
struct Truth {
  TimeNs time_offset_ns = 0, readout_ns = 0;
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
};

inline Eigen::Matrix3d rotation(const Eigen::Vector3d& rotation_rad) {
  return so3_exp(rotation_rad).toRotationMatrix();
}

/// The error of an estimate: in the units of the limits below.
struct Errors {
  double offset_ms, readout_percent, bias_rad_s, rotation_deg;
};

inline Errors errors_of(const TimingEstimate& estimate, const Truth& truth) {
  const Eigen::Vector3d bias(estimate.bias_rad_s[0].value, estimate.bias_rad_s[1].value, estimate.bias_rad_s[2].value);
  return {1e3 * (estimate.time_offset_s.value - to_seconds(truth.time_offset_ns)),
          truth.readout_ns == 0 ? 0 : 100 * (estimate.readout_s.value / to_seconds(truth.readout_ns) - 1),
          (bias - truth.bias_rad_s).cwiseAbs().maxCoeff(),
          Eigen::AngleAxisd(Eigen::Matrix3d(estimate.R_cam_imu.transpose() * truth.R_cam_imu)).angle() / kDeg};
}

inline void expect_close(const Errors& errors) {
  EXPECT_LT(std::abs(errors.offset_ms), 1);
  EXPECT_LT(std::abs(errors.readout_percent), 5);
  EXPECT_LT(errors.bias_rad_s, 0.005);
  EXPECT_LT(errors.rotation_deg, 0.5);
}

}  // namespace gyro_deblur::test
