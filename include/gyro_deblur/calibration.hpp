// Calibration files as people have them, in one internal form.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Calibration of one camera and its IMU. Values that a source does not have are absent.
struct SensorCalibration {
  std::string origin;                       ///< file and camera, for messages
  std::optional<CameraCalibration> camera;  ///< of the whole image, as the sensor delivers it
  std::optional<Eigen::Matrix3d> R_cam_imu;
  std::optional<Eigen::Vector3d> p_imu_cam_m;  ///< origin of the camera in IMU coordinates
  std::optional<TimeNs> time_offset_ns;        ///< t_imu = t_cam + time_offset
  std::optional<TimeNs> readout_ns;            ///< first to one past the last row
  std::optional<TimeNs> frame_period_ns;       ///< > 0
  std::vector<std::string> notes;  ///< what of a file was not understood: sentences that begin with its path
};

/// Reads a calibration file. Its keys say which format it has:
/// - Kalibr's camchain.yaml and camchain-imucam.yaml (github.com/ethz-asl/kalibr/wiki/yaml-formats), also those of
///   OpenVINS: pinhole with radtan, equidistant or none, ds, eucm, and omni with radtan or none; `T_cam_imu` or its
///   inverse `T_imu_cam`, `timeshift_cam_imu`;
/// - EuRoC's sensor.yaml of a camera (Burri et al., IJRR 2016): pinhole with radial-tangential or equidistant, `T_BS`
///   from camera to body, `rate_hz`. The IMU's own `T_BS` is read from ../imu0/sensor.yaml where that is; without it
///   the body is the IMU;
/// - VINS-Mono's and VINS-Fusion's configuration (github.com/HKUST-Aerial-Robotics): `body_T_cam0`, or
///   `extrinsicRotation` and `extrinsicTranslation`, from camera to IMU; `td`, `rolling_shutter_tr`, intrinsics of the
///   models PINHOLE, KANNALA_BRANDT and MEI in the same file or in that of `cam0_calib`;
/// - Basalt's JSON (gitlab.com/VladyslavUsenko/basalt): `camera_type` ds, eucm, kb4, pinhole or pinhole-radtan8,
///   `T_imu_cam`, `cam_time_offset_ns`;
/// - camera_calibration's YAML (`camera_matrix`): intrinsics alone.
/// Other lens models are refused by name. Keys that are not known are named in `notes`.
/// @param camera  which of several, e.g. "cam1"
/// Throws OptionError that begins with the path and names the key: one that is missing or has the wrong form, a value
/// that is not finite, a matrix that is no rotation, a readout longer than the frame period.
SensorCalibration load_calibration(const std::string& path, const std::string& camera = "cam0");

/// What the sources say together. Throws OptionError that prints both values where two of them contradict each other.
SensorCalibration merge_calibrations(const std::vector<SensorCalibration>& sources);

/// Throw OptionError that prints both values unless they agree as well as the digits of printed calibrations let them:
/// projections to 0.1 px anywhere in the image, rotations to 0.1 degrees, times to 1 us.
/// @param name_a, name_b  where the values are from, for the message
void require_agreement(const CameraCalibration& a, const std::string& name_a, const CameraCalibration& b,
                       const std::string& name_b);
void require_agreement(const Eigen::Matrix3d& R_cam_imu_a, const std::string& name_a,
                       const Eigen::Matrix3d& R_cam_imu_b, const std::string& name_b);
void require_agreement(const char* quantity, TimeNs a_ns, const std::string& name_a, TimeNs b_ns,
                       const std::string& name_b);

/// The values on one line.
std::string to_string(const CameraCalibration& camera);
/// Nine numbers by row on one line.
std::string to_string(const Eigen::Matrix3d& matrix);

}  // namespace gyro_deblur
