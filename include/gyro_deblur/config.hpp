// The configuration file: one flat set of keys for the nodelet's private parameters and for deblur_bag --config.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/calibration.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

/// What to do when camera_info or tf say something else than the parameters and the calibration file.
enum class OnCalibrationConflict {
  ERROR,       ///< pass the frame through, and print both values
  CONFIGURED,  ///< the parameters and the file hold
};

/// What to do about rotation, time offset, readout time and bias that are not given.
enum class SelfCalibrationMode {
  AUTO,   ///< they are estimated from the images, and used once they are sure; what is given is checked
  NEVER,  ///< R_cam_imu is missing, the others are 0
};

/// Whether numbers were given, 0 included (only a calibration file replaces a 0). One that was not is 0 until it is
/// estimated. A configuration made in code gives them all.
struct GivenNumbers {
  bool time_offset = true;
  bool readout_time = true;
  bool gyro_bias = true;
  bool exposure_time = true;  ///< 0 means "not known" here, too
};

enum class ExposureUnit {
  SECONDS,
  MILLISECONDS,
  HUNDRED_MICROSECONDS,  ///< of V4L2's exposure_absolute, and of what is read from it
  TEN_MICROSECONDS,
  MICROSECONDS,
};

/// The messages that exposure times are read from.
struct ExposureSource {
  enum class Kind {
    AUTO,                 ///< gyro_deblur/Exposure or realsense2_camera/Metadata, by the type of the message
    MESSAGE,              ///< gyro_deblur/Exposure
    FIELD,                ///< a field of any message
    REALSENSE_METADATA,   ///< JSON of realsense2_camera/Metadata
    DYNAMIC_RECONFIGURE,  ///< a parameter of dynamic_reconfigure/Config
  };
  Kind kind = Kind::AUTO;
  ExposureUnit unit = ExposureUnit::SECONDS;  ///< of a number; times and durations have their own; AUTO knows it
  std::string field;                          ///< path of the field, key or parameter; empty for AUTO and MESSAGE

  void validate() const;  ///< throws OptionError
};

/// Channels of the messages of tracks, by the estimator that reads them.
enum class TrackLayout { VINS_MONO, VINS_FUSION };

/// Every parameter; doc/guides/parameters.md has the keys and their ranges. Each member has one row in
/// src/config/config_table.hpp, except for `given` and for what is read from calibration files. Constants as in
/// options.hpp.
struct Config {
  PipelineOptions pipeline;
  GyroOptions gyro;
  ShutterTiming shutter;  ///< of images without a message of their own; exposure_ns 0: not known
  ExposureSource exposure_source;
  OnExposureConflict on_exposure_conflict = OnExposureConflict::IMAGES;
  /// An image without an exposure of its own takes the last one before it that is no older; 0: none.
  TimeNs exposure_max_age_ns = 0;
  bool rectified_input = false;              ///< the image is undistorted: use camera_info's P and R
  std::optional<Eigen::Matrix3d> R_cam_imu;  ///< absent: from tf, else from the images
  GivenNumbers given;                        ///< of gyro and shutter, see parse_config()
  SelfCalibrationMode self_calibration = SelfCalibrationMode::AUTO;
  TrackerOptions tracker;
  TrackLayout track_layout = TrackLayout::VINS_MONO;
  std::vector<std::string> calibration_files;
  std::string calibration_camera = "cam0";       ///< which of a file's cameras
  std::optional<SensorCalibration> calibration;  ///< of the files; what they say has gone into the fields above
  OnCalibrationConflict on_calibration_conflict = OnCalibrationConflict::ERROR;
  TimeNs input_timeout_ns = 500'000'000;  ///< how long a frame waits for gyroscope, camera_info, exposure and tf
  int frame_queue_size = 30;              ///< frames that may wait
  TimeNs time_jump_ns = 500'000'000;      ///< constant: a stamp that goes back by more is a clock reset
  /// How long an image waits until the other one of its stereo pair is decided on; 0: each camera on its own.
  TimeNs stereo_sync_timeout_ns = 100'000'000;
  bool drop_poor = false;  ///< images of grade POOR (gyro_deblur/ImageQuality.msg) are not published
  std::string mask_file;   ///< of the pixels that show the scene, see PixelMask; empty: all do

  void validate() const;  ///< throws OptionError
};

/// Reads a map of keys in YAML (nothing: all defaults) and validates the result. Keys that are not known are appended
/// to `unknown` (when given) and otherwise ignored.
/// Throws OptionError that names the key, its value and what is allowed, and for a calibration file that contradicts
/// another or a key both values. A key that is 0 or empty takes the file's value. `given` are the numbers that a key or
/// a file has: a key that is absent or empty gives none.
/// @param folder  calibration files and the mask are relative to it; empty: to the working folder
Config parse_config(const std::string& yaml, std::vector<std::string>* unknown = nullptr,
                    const std::string& folder = "");

/// Reads a YAML file; calibration files and the mask are relative to its folder. Throws OptionError with the path when
/// it cannot be read or parsed.
Config load_config(const std::string& path, std::vector<std::string>* unknown = nullptr);

/// The message for an unknown key: "KEY is not known, ignored", or the value that holds where it is a constant.
std::string unknown_key_message(const std::string& key);

}  // namespace gyro_deblur
