// cam0 of EuRoC's MAV: a lens that distorts as real ones do.
#pragma once

#include "gyro_deblur/camera.hpp"

namespace gyro_deblur::test {

inline CameraCalibration euroc_camera() {
  CameraCalibration c;
  c.width_px = 752;
  c.height_px = 480;
  c.fx_px = 458.654;
  c.fy_px = 457.296;
  c.cx_px = 367.215;
  c.cy_px = 248.375;
  c.model = "plumb_bob";
  c.coefficients = {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05};
  return c;
}

}  // namespace gyro_deblur::test
