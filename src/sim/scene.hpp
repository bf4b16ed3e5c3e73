// What is simulated: camera, IMU, textured planes and motion, read from YAML.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "sim/motion.hpp"

namespace YAML {
class Node;
}

namespace gyro_deblur::sim {

struct CameraModel {
  CameraCalibration calibration;
  double fps = 20;                   ///< [0.1, 1000] Hz
  std::vector<TimeNs> exposures_ns;  ///< each (0, 1 s]; used in turn, frame by frame
  TimeNs readout_ns = 0;             ///< |.| <= 1 s; signed as in ShutterTiming
  StampRow stamp_row = StampRow::FIRST;
  StampPhase stamp_phase = StampPhase::START;
  std::string encoding = "mono8";  ///< mono8, mono16, bgr8, rgb8 or bayer_{rggb,bggr,gbrg,grbg}8
  double noise = 0;                ///< [0, 64] grey levels of 8 bit: standard deviation of each pixel
};

struct ImuModel {
  double rate_hz = 200;  ///< [1, 10000]
  Eigen::Vector3d gyro_bias_rad_s = Eigen::Vector3d::Zero();
  double gyro_noise_rad_s = 0;  ///< [0, 10]: standard deviation of each sample
  Eigen::Vector3d accel_bias_m_s2 = Eigen::Vector3d::Zero();
  double accel_noise_m_s2 = 0;       ///< [0, 100]
  double gyro_saturation_rad_s = 0;  ///< [0, 1000]: each axis is clipped to this; 0: never
  TimeNs time_offset_ns = 0;         ///< |.| <= 10 s; IMU stamp = camera clock + time_offset
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
};

/// A textured rectangle. At zero rotation it faces a camera that looks along +z: its x is right and its y down.
struct Plane {
  cv::Mat texture;  ///< CV_8UC1 or CV_8UC3, stretched over the rectangle
  double width_m = 0, height_m = 0;
  Eigen::Quaterniond R_world_plane = Eigen::Quaterniond::Identity();
  Eigen::Vector3d center_m = Eigen::Vector3d::Zero();
};

struct Scene {
  CameraModel camera;
  ImuModel imu;
  std::vector<Plane> planes;                                      ///< the nearest wins; none: only background
  double background = 96;                                         ///< [0, 255] grey level where there is no plane
  Eigen::Vector3d gravity_m_s2 = Eigen::Vector3d(0, 9.80665, 0);  ///< world: y is down
  std::shared_ptr<const Motion> motion;
  int frames = 1;                               ///< [1, 1000000]
  std::uint64_t seed = 1;                       ///< of all noise
  TimeNs start_ns = 1'600'000'000'000'000'000;  ///< scene time 0 in the camera clock
  TimeNs lead_ns = 300'000'000;                 ///< [0, 60 s]: IMU before the first and after the last frame

  /// Exposure, readout and stamp convention of frame i.
  ShutterTiming timing(int frame) const;
  /// Start of exposure of row 0 of frame i, camera clock.
  TimeNs first_row_start(int frame) const;
  /// End of the simulation, camera clock.
  TimeNs end_ns() const;

  /// Throws OptionError: ranges above, a motion that covers the whole simulation, rows that start before it.
  void validate() const;
};

/// Reads a scene; config/scenes/handheld.yaml documents every key.
/// @param directory  file names in the scene are relative to it
/// @param name       of the source, for messages
/// Throws OptionError "NAME: KEY = VALUE is outside ..." for bad, missing and unknown keys.
Scene parse_scene(const YAML::Node& node, const std::string& directory, const std::string& name);

/// As parse_scene. Throws OptionError with the path when the file cannot be read or is not YAML.
Scene load_scene(const std::string& path);

}  // namespace gyro_deblur::sim
