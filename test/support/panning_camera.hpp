// A small camera that rotates about its y axis: blur along x.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur::test {

constexpr int kWidth = 320, kHeight = 240;
constexpr double kFocalPx = 300;

inline CameraCalibration small_camera() {
  CameraCalibration c;
  c.width_px = kWidth;
  c.height_px = kHeight;
  c.fx_px = c.fy_px = kFocalPx;
  c.cx_px = (kWidth - 1) / 2.0;
  c.cy_px = (kHeight - 1) / 2.0;
  return c;
}

/// Two seconds at a constant rate.
inline RotationTrack pan(double rate_rad_s, TimeNs from_ns = 0) {
  std::vector<GyroSample> samples;
  for (TimeNs t = from_ns; t <= from_ns + 2'000'000'000; t += 5'000'000) samples.push_back({t, {0, rate_rad_s, 0}});
  return RotationTrack(samples, {}, Eigen::Matrix3d::Identity());
}

}  // namespace gyro_deblur::test
