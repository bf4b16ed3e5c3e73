// Recorded folders of images and IMU samples, read into one form. Free of ROS.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// An image file with its times, camera clock.
struct RecordedFrame {
  TimeNs stamp_ns = 0;     ///< start of the first row's exposure, or whatever the recording's stamps mean
  TimeNs exposure_ns = 0;  ///< 0: not recorded
  std::string path;
};

/// An IMU sample, IMU clock and frame.
struct RecordedImu {
  TimeNs t_ns = 0;
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();
  std::optional<Eigen::Vector3d> acceleration_m_s2;
};

/// What a folder holds. Frames are ordered by stamp; IMU samples are in the order of the file.
struct Recording {
  CameraCalibration camera;
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p_imu_cam_m = Eigen::Vector3d::Zero();  ///< of the camera in the IMU frame
  TimeNs time_offset_ns = 0;                              ///< t_imu = t_cam + time_offset
  TimeNs readout_ns = 0;
  std::vector<RecordedFrame> frames;
  std::vector<RecordedImu> imu;
};

/// Rotation of its camera, on the camera's clock.
RotationTrack rotation_of(const Recording& recording);

/// EuRoC's ASL layout: `folder` is mav0 or holds it; `camera` is the sensor's folder, e.g. cam0. Stamps are taken as
/// they are. No exposure is recorded: `exposure_ns` (0: unknown) is given to every frame. All readers throw
/// std::runtime_error with the file, and the line where there is one, for what cannot be read, and OptionError for
/// calibrations and descriptions that cannot be used.
Recording read_euroc(const std::string& folder, const std::string& camera, TimeNs exposure_ns);

/// A folder of numbered images, files of their stamps and exposure times, and a file of IMU samples.
/// @param description_path  YAML with calibration and file formats: see config/recordings/
Recording read_frames(const std::string& folder, const std::string& description_path);

}  // namespace gyro_deblur
