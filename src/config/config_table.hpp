// The parameters of a configuration beyond those of its parts: a row for each member, with key, allowed values and
// text.
#pragma once

#include <utility>

#include "base/option_table.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/shutter_table.hpp"

namespace gyro_deblur {

inline Names<OnCalibrationConflict> names_of(OnCalibrationConflict) {
  return {{"error", OnCalibrationConflict::ERROR}, {"configured", OnCalibrationConflict::CONFIGURED}};
}

inline Names<SelfCalibrationMode> names_of(SelfCalibrationMode) {
  return {{"auto", SelfCalibrationMode::AUTO}, {"never", SelfCalibrationMode::NEVER}};
}

inline Names<OnExposureConflict> names_of(OnExposureConflict) {
  return {{"images", OnExposureConflict::IMAGES}, {"configured", OnExposureConflict::CONFIGURED}};
}

inline Names<TrackLayout> names_of(TrackLayout) {
  return {{"vins_mono", TrackLayout::VINS_MONO}, {"vins_fusion", TrackLayout::VINS_FUSION}};
}

/// Kind and unit together; the unit is part of the name, so that nobody has to guess it.
using ExposureMessage = std::pair<ExposureSource::Kind, ExposureUnit>;

inline bool operator==(const ExposureSource& source, const ExposureMessage& message) {
  return source.kind == message.first && source.unit == message.second;
}

inline Names<ExposureMessage> names_of(const ExposureSource&) {
  using Kind = ExposureSource::Kind;
  return {{"auto", {Kind::AUTO, ExposureUnit::SECONDS}},
          {"message", {Kind::MESSAGE, ExposureUnit::SECONDS}},
          {"field_us", {Kind::FIELD, ExposureUnit::MICROSECONDS}},
          {"field_10us", {Kind::FIELD, ExposureUnit::TEN_MICROSECONDS}},
          {"field_100us", {Kind::FIELD, ExposureUnit::HUNDRED_MICROSECONDS}},
          {"field_ms", {Kind::FIELD, ExposureUnit::MILLISECONDS}},
          {"field_s", {Kind::FIELD, ExposureUnit::SECONDS}},
          {"realsense_metadata_us", {Kind::REALSENSE_METADATA, ExposureUnit::MICROSECONDS}},
          {"realsense_metadata_100us", {Kind::REALSENSE_METADATA, ExposureUnit::HUNDRED_MICROSECONDS}},
          {"dynamic_reconfigure_us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MICROSECONDS}},
          {"dynamic_reconfigure_10us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::TEN_MICROSECONDS}},
          {"dynamic_reconfigure_100us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::HUNDRED_MICROSECONDS}},
          {"dynamic_reconfigure_ms", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MILLISECONDS}},
          {"dynamic_reconfigure_s", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::SECONDS}}};
}

inline void require_allowed(const Row& row, const std::optional<Eigen::Matrix3d>& value) {
  if (value) require_rotation(row.key, *value);
}

/// Whether a number was given, of those that may be empty: then they are not known.
struct GivenNumber {
  const char* key;
  bool GivenNumbers::*given;
};
inline constexpr GivenNumber kGivenNumbers[] = {{"time_offset", &GivenNumbers::time_offset},
                                                {"readout_time", &GivenNumbers::readout_time},
                                                {"gyro_bias", &GivenNumbers::gyro_bias},
                                                {"exposure_time", &GivenNumbers::exposure_time}};

template <typename V>
void visit(Table<ExposureSource>, V&& visitor) {
  visitor({"exposure_field",
           "Field or parameter that holds the exposure time, for example exposure_time or exposures[0].shutterms."},
          &ExposureSource::field);
}

template <typename V>
void visit(Table<Config>, V&& visitor) {
  using O = Config;
  visitor.group("calibration files",
                "Formats: Kalibr's camchain-imucam.yaml (also used by OpenVINS), EuRoC's sensor.yaml, the "
                "configuration of VINS-Mono and VINS-Fusion, Basalt's JSON, camera_calibration's YAML. Values of a "
                "file need no key below. If both give a value, they have to agree.");
  visitor({"calibration_file",
           "Path of a calibration file, or a list of paths, relative to the configuration file. The nodelet needs "
           "absolute paths. '': none."},
          &O::calibration_files);
  visitor({"calibration_camera", "Name of the camera within the calibration file: cam0, cam1, ..."},
          &O::calibration_camera);
  visitor({"on_calibration_conflict",
           "What happens when calibrations contradict each other. error: parameters that contradict the calibration "
           "file are refused, and frames are passed through unchanged if camera_info or tf contradict either. "
           "configured: parameters win over the file, and both over camera_info and tf."},
          &O::on_calibration_conflict);
  visitor.part(&O::shutter);
  visitor({"exposure_source",
           "Content of the exposure topic. auto: gyro_deblur/Exposure or RealSense metadata, recognised by the message "
           "type. message: gyro_deblur/Exposure. field_UNIT: the field exposure_field of any message. "
           "realsense_metadata_UNIT: RealSense metadata (us for infrared, 100us for colour cameras); exposure_field is "
           "actual_exposure unless set. dynamic_reconfigure_UNIT: the parameter exposure_field of a driver's "
           "parameter_updates."},
          &O::exposure_source);
  visitor.part(&O::exposure_source);
  visitor({"on_exposure_conflict",
           "What happens when the blur contradicts an exposure time by more than 8 % for 2 s, or exposure_time is "
           "longer than the frame period. images: the estimate from the images replaces exposure_time, but not "
           "exposure messages. configured: the given time stays in use; while exposure_time is longer than the frame "
           "period, frames are passed through unchanged. Both report it."},
          &O::on_exposure_conflict);
  visitor({"exposure_max_age", within(0, 60, "s"),
           "How long the last exposure message is used for images that have none of their own. 0: never."},
          &O::exposure_max_age_ns);
  visitor({"rectified_input",
           "true: the images are rectified, and P and R of camera_info describe them. false: D and K describe them."},
          &O::rectified_input);
  visitor.group("image");
  visitor({"mask",
           "PNG or PGM file (mono8, as large as the images). Pixels of 0, such as a lens rim or a part of the "
           "vehicle, are not deblurred, tracked or described. Relative paths as in calibration_file. The topic mask "
           "replaces the file. '': none."},
          &O::mask_file);
  visitor.part(&O::gyro);
  visitor({"R_cam_imu",
           "Rotation from IMU to camera coordinates (of Kalibr's T_cam_imu), row by row. []: taken from tf, otherwise "
           "see self_calibration."},
          &O::R_cam_imu);
  visitor({"self_calibration",
           "auto: the images give readout_time, time_offset, R_cam_imu and gyro_bias where these are empty, and a "
           "focal length where there are no intrinsics; an estimate is used once it is certain. Values that are set "
           "stay in use (only a calibration file replaces a 0), and a contradiction is reported. never: nothing is "
           "estimated or compared."},
          &O::self_calibration);
  visitor({"input_timeout", within(0, 10, "s"),
           "Longest time that a frame waits for gyroscope samples, camera_info, exposure and tf."},
          &O::input_timeout_ns);
  visitor({"frame_queue_size", within(1, 1000),
           "Most frames that wait for other messages. When more arrive, the oldest is passed through unchanged."},
          &O::frame_queue_size);
  visitor({"time_jump_threshold", within(0.01, 10, "s"),
           "More than stamps of one clock are out of order, less than a bag that is played again goes back.",
           Change::NEVER},
          &O::time_jump_ns);
  visitor.group("stereo");
  visitor({"stereo_sync_timeout", within(0, 10, "s"),
           "Longest time that an image waits for the other image of its stereo pair. Cameras in one process that share "
           "an IMU deblur both images of a pair or neither. 0: each camera on its own."},
          &O::stereo_sync_timeout_ns);
  visitor.group("image quality");
  visitor({"drop_poor",
           "true: an image of grade POOR is not published, nor its keypoints and tracks. false: one image is published "
           "for every image received.",
           Change::WHILE_RUNNING},
          &O::drop_poor);
  visitor.part(&O::pipeline);
  visitor.part(&O::tracker);
  visitor({"track_layout",
           "Order of the channels of feature_tracks and global_shutter/feature_tracks. vins_mono: that of VINS-Mono's "
           "estimator. vins_fusion: that of VINS-Fusion's estimator, where all points belong to its camera 0."},
          &O::track_layout);
}

/// Sets one key, if it is known, to a value in YAML. Throws std::exception when the key does not allow the value. What
/// several keys together do not allow is not checked, and calibration files are not read.
void set_parameter(const std::string& key, const std::string& yaml, Config* config);

}  // namespace gyro_deblur
