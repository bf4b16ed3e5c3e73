// Reads each format of calibration files.
#include "config/calibration_formats.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <optional>
#include <regex>

#include <Eigen/Geometry>

#include "base/join.hpp"
#include "base/require_range.hpp"
#include "config/yaml_reading.hpp"
#include "config/yaml_section.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/lens_models.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void refuse_model(const Section& section, const std::string& key, const std::string& supported) {
  throw OptionError(section.name(key) + " = " + section.text(key) + " is not supported; " + supported);
}

/// The lens model that a file names under `key`.
/// @param name      what the file has there, as the table spells it
/// @param spelling  of a row of the table: its name in the file's format, "" where the format does not have it
template <typename Spelling>
LensModelRow find_lens_model(const Section& section, const std::string& key, const std::string& name,
                             const Spelling& spelling) {
  std::vector<std::string> supported;
  for (const LensModelRow& row : lens_models()) {
    const std::string known = spelling(row);
    if (known.empty()) continue;
    if (name == known) return row;
    supported.push_back(known);
  }
  refuse_model(section, key, "supported are " + join(supported, "and"));
}

/// Whole pixels, for numbers that some files write as 752.0.
void set_resolution(const Section& section, const std::string& key, const YAML::Node& size, CameraCalibration& camera) {
  const std::string allowed = "a list of 2 numbers";
  if (!size.IsSequence() || size.size() != 2) refuse(section.name(key), size, allowed);
  const auto pixels = [&](std::size_t i) {
    const double value = read_number(section.name(key), size[i], allowed);
    constexpr double kLargest = 1e6;
    if (value != std::floor(value) || std::abs(value) > kLargest) refuse(section.name(key), size, "whole pixels");
    return static_cast<int>(value);
  };
  camera.width_px = pixels(0);
  camera.height_px = pixels(1);
}

void set_intrinsics(const std::vector<double>& fx_fy_cx_cy, CameraCalibration& camera) {
  camera.fx_px = fx_fy_cx_cy[0];
  camera.fy_px = fx_fy_cx_cy[1];
  camera.cx_px = fx_fy_cx_cy[2];
  camera.cy_px = fx_fy_cx_cy[3];
}

CameraCalibration validated(const Section& section, const CameraCalibration& camera) {
  try {
    camera.validate();
  } catch (const OptionError& error) {
    throw OptionError(section.name("") + error.what());
  }
  return camera;
}

/// The coefficients that a file lists. Fewer than the format has may be a mistake: the log says so.
/// @param count  how many the format lists
std::vector<double> read_coefficients(const Section& section, const std::string& key, std::size_t count,
                                      SensorCalibration& calibration) {
  const std::vector<double> coefficients = section.numbers(key);
  if (coefficients.size() < count) {
    calibration.notes.push_back(section.name(key) + " has " + std::to_string(coefficients.size()) + " of " +
                                std::to_string(count) + " coefficients: the last ones are taken as 0");
  }
  return coefficients;
}

/// The model of a file where each number has a key.
void set_keyed(const Section& section, const LensModelRow& lens, const KeyedLens& keys, CameraCalibration& camera) {
  std::vector<double> intrinsics;
  for (const std::string& key : keys.intrinsics) intrinsics.push_back(section.number_at(key));
  set_intrinsics(intrinsics, camera);
  camera.model = lens.name;
  for (const std::string& key : keys.coefficients) camera.coefficients.push_back(section.number_at(key));
}

void set_T_cam_imu(const Eigen::Isometry3d& T_cam_imu, SensorCalibration& calibration) {
  calibration.R_cam_imu = T_cam_imu.linear();
  calibration.p_imu_cam_m = T_cam_imu.inverse().translation();
}

/// Notes the keys of a file that nobody has asked for.
void record_unknown_keys(const Section& root, SensorCalibration& calibration) {
  const std::vector<std::string> unknown = root.unknown_keys();
  if (unknown.empty()) return;
  calibration.notes.push_back(root.name("") + join(unknown, "and") + (unknown.size() > 1 ? " are" : " is") +
                              " not known and ignored: doc/guides/calibration.md lists the keys that are read");
}

bool has_kalibr_camera(const YAML::Node& root) {
  return std::any_of(root.begin(), root.end(), [](const auto& entry) {
    return entry.first.IsScalar() && is_camera_name(entry.first.Scalar()) && entry.second.IsMap();
  });
}

/// The model of a camera of Kalibr, by its two keys.
const LensModelRow& find_kalibr_model(const Section& section) {
  const std::string camera_model = section.text("camera_model");
  std::vector<std::string> camera_models, distortion_models;
  for (const LensModelRow& row : lens_models()) {
    const std::string& known = row.kalibr.camera_model;
    if (known == camera_model) distortion_models.push_back(row.kalibr.distortion_model);
    if (!known.empty() && std::find(camera_models.begin(), camera_models.end(), known) == camera_models.end()) {
      camera_models.push_back(known);
    }
  }
  if (distortion_models.empty()) {
    refuse_model(section, "camera_model", "supported are " + join(camera_models, "and"));
  }
  const std::string distortion_model = section.text("distortion_model");
  const LensModelRow* without = nullptr;
  for (const LensModelRow& row : lens_models()) {
    if (row.kalibr.camera_model != camera_model) continue;
    if (row.kalibr.distortion_model == distortion_model) return row;
    without = &row;
  }
  if (distortion_model == "none") return *without;
  refuse_model(section, "distortion_model",
               "with camera_model " + camera_model + " supported are " + join(distortion_models, "and") +
                   "; calibrate again with one of these");
}

CameraCalibration read_kalibr_camera(const Section& section, SensorCalibration& calibration) {
  CameraCalibration camera;
  set_resolution(section, "resolution", section.get("resolution"), camera);
  const LensModelRow& lens = find_kalibr_model(section);
  camera.model = lens.name;
  std::vector<double> intrinsics = section.numbers("intrinsics", lens.kalibr.in_intrinsics + 4);
  const auto focal_lengths = intrinsics.begin() + static_cast<std::ptrdiff_t>(lens.kalibr.in_intrinsics);
  set_intrinsics({focal_lengths, intrinsics.end()}, camera);
  camera.coefficients.assign(intrinsics.begin(), focal_lengths);
  const bool distorts = section.text("distortion_model") != "none";
  if (!distorts && !section.has("distortion_coeffs")) return validated(section, camera);
  const std::vector<double> distortion =
      read_coefficients(section, "distortion_coeffs", distorts ? lens.kalibr.in_distortion : 0, calibration);
  try {
    if (!distorts) require_coefficients(lens_model("none"), distortion);
  } catch (const OptionError& error) {
    throw OptionError(section.name("") + error.what());
  }
  camera.coefficients.insert(camera.coefficients.end(), distortion.begin(), distortion.end());
  return validated(section, camera);
}

SensorCalibration read_kalibr(const Section& root, const std::string& camera_name) {
  if (!root.has(camera_name)) {
    std::string names;
    for (const auto& entry : root.node()) names += " " + entry.first.Scalar();
    throw OptionError(root.name(camera_name) + " is missing; the file has" + names +
                      ": set calibration_camera to one of them");
  }
  const Section section = root.child(camera_name);
  SensorCalibration calibration;
  calibration.camera = read_kalibr_camera(section, calibration);
  if (section.has("T_cam_imu")) set_T_cam_imu(section.transform("T_cam_imu"), calibration);
  if (section.has("T_imu_cam")) {  // OpenVINS writes the inverse
    const std::optional<Eigen::Matrix3d> other = calibration.R_cam_imu;
    set_T_cam_imu(section.transform("T_imu_cam").inverse(), calibration);
    if (other) {
      require_agreement(*other, section.name("T_cam_imu"), *calibration.R_cam_imu, section.name("T_imu_cam"));
    }
  }
  if (section.has("timeshift_cam_imu")) calibration.time_offset_ns = section.seconds("timeshift_cam_imu");
  section.ignore({"T_cn_cnm1", "cam_overlaps", "rostopic"});
  for (const auto& entry : root.node()) {
    if (entry.first.IsScalar() && is_camera_name(entry.first.Scalar())) root.ignore(entry.first.Scalar());
  }
  record_unknown_keys(root, calibration);
  return calibration;
}

SensorCalibration read_euroc(const Section& root) {
  if (root.has("sensor_type") && root.text("sensor_type") != "camera") {
    refuse(root.name("sensor_type"), root.get("sensor_type"), "camera: give the path of the camera's sensor.yaml");
  }
  if (root.has("camera_model") && root.text("camera_model") != "pinhole") {
    refuse_model(root, "camera_model", "supported is pinhole");
  }
  SensorCalibration calibration;
  CameraCalibration camera;
  set_resolution(root, "resolution", root.get("resolution"), camera);
  set_intrinsics(root.numbers("intrinsics", 4), camera);
  const LensModelRow lens = find_lens_model(root, "distortion_model", root.text("distortion_model"),
                                            [](const LensModelRow& row) { return row.euroc.name; });
  camera.model = lens.name;
  camera.coefficients = read_coefficients(root, "distortion_coefficients", lens.euroc.in_distortion, calibration);
  calibration.camera = validated(root, camera);

  Eigen::Isometry3d T_body_imu = Eigen::Isometry3d::Identity();
  const fs::path imu_path = fs::absolute(root.path()).parent_path().parent_path() / "imu0" / "sensor.yaml";
  if (fs::is_regular_file(imu_path)) T_body_imu = Section::load(imu_path.string()).transform("T_BS");
  set_T_cam_imu(root.transform("T_BS").inverse() * T_body_imu, calibration);
  if (root.has("rate_hz")) {
    const double rate_hz = root.number("rate_hz");
    constexpr double kSlowestHz = 1e-3, kFastestHz = 1e6;
    require_range(root.name("rate_hz").c_str(), rate_hz, kSlowestHz, kFastestHz, "Hz");
    calibration.frame_period_ns = to_ns(1 / rate_hz);
  }
  root.ignore("comment");
  record_unknown_keys(root, calibration);
  return calibration;
}

/// Camodocal takes the names of its models in upper and in lower case; the table has them in upper case.
std::string upper_if_lower(const std::string& name) {
  const auto is_upper = [](unsigned char c) { return std::isupper(c) != 0; };
  if (std::any_of(name.begin(), name.end(), is_upper)) return name;
  std::string upper = name;
  for (char& c : upper) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return upper;
}

/// Intrinsics as VINS' camera library (camodocal) writes them.
CameraCalibration read_vins_camera(const Section& root) {
  CameraCalibration camera;
  const std::string model = root.text("model_type");
  camera.width_px = root.integer("image_width");
  camera.height_px = root.integer("image_height");
  root.ignore("camera_name");
  const LensModelRow lens = find_lens_model(root, "model_type", upper_if_lower(model),
                                            [](const LensModelRow& row) { return row.camodocal.name; });
  set_keyed(root, lens, lens.camodocal, camera);
  return validated(root, camera);
}

/// What else the configurations of VINS-Mono and VINS-Fusion have: topics, the tracker, the estimator.
void ignore_estimator_keys(const Section& root) {
  root.ignore({"imu", "num_of_cam", "imu_topic", "image_topic", "image0_topic", "image1_topic", "output_path",
               "image_width", "image_height", "estimate_extrinsic", "estimate_td", "ex_calib_result_path",
               "rolling_shutter_tr", "extrinsicRotation", "extrinsicTranslation"});
  root.ignore(
      {"max_cnt", "min_dist", "freq", "F_threshold", "show_track", "flow_back", "equalize", "fisheye", "fisheye_mask"});
  root.ignore({"max_solver_time", "max_num_iterations", "keyframe_parallax", "acc_n", "gyr_n", "acc_w", "gyr_w",
               "g_norm", "multiple_thread", "use_gpu", "use_gpu_acc_flow", "use_gpu_ceres"});
  root.ignore({"loop_closure", "load_previous_pose_graph", "fast_relocalization", "pose_graph_save_path",
               "pattern_file", "voc_file", "min_loop_num", "vins_out_path", "save_image", "visualize_imu_forward",
               "visualize_camera_size"});
  static const std::regex kOtherCamera("(body_T_cam\\d+|cam\\d+_calib)");
  for (const auto& entry : root.node()) {
    const std::string key = entry.first.IsScalar() ? entry.first.Scalar() : "";
    if (std::regex_match(key, kOtherCamera)) root.ignore(key);
  }
}

SensorCalibration read_vins(const Section& root, const std::string& camera_name) {
  SensorCalibration calibration;
  const std::string calib_key = camera_name + "_calib", transform_key = "body_T_" + camera_name;
  if (root.has(calib_key)) {
    const fs::path intrinsics = fs::path(root.path()).parent_path() / root.text(calib_key);
    const Section section = Section::load(intrinsics.string());
    calibration.camera = read_vins_camera(section);
    record_unknown_keys(section, calibration);
  } else {
    calibration.camera = read_vins_camera(root);
  }
  constexpr int kNotKnown = 2;  // "Don't know anything about extrinsic parameters"
  const bool extrinsic_known = !root.has("estimate_extrinsic") || root.integer("estimate_extrinsic") != kNotKnown;
  if (extrinsic_known && root.has("extrinsicRotation") && !root.has(transform_key)) {
    const Eigen::Matrix3d R_imu_cam = root.matrix("extrinsicRotation", 3, 3);
    calibration.R_cam_imu = require_rotation(root.name("extrinsicRotation").c_str(), R_imu_cam).transpose();
    if (root.has("extrinsicTranslation")) {
      calibration.p_imu_cam_m = Eigen::Vector3d(root.matrix("extrinsicTranslation", 3, 1));
    }
  } else if (extrinsic_known) {
    set_T_cam_imu(root.transform(transform_key).inverse(), calibration);
  }
  // td: "read image clock + td = real image clock (IMU clock)".
  if (root.has("td")) calibration.time_offset_ns = root.seconds("td");
  if (root.has("rolling_shutter")) {
    calibration.readout_ns = root.integer("rolling_shutter") == 0 ? 0 : root.seconds("rolling_shutter_tr");
  }
  ignore_estimator_keys(root);
  record_unknown_keys(root, calibration);
  return calibration;
}

/// px, py, pz [m] and the quaternion qx, qy, qz, qw.
Eigen::Isometry3d read_basalt_transform(const Section& section) {
  const Eigen::Quaterniond q(section.number("qw"), section.number("qx"), section.number("qy"), section.number("qz"));
  constexpr double kRounding = 1e-3;  // of files that are written by hand
  if (!(std::abs(q.norm() - 1) < kRounding)) {
    throw OptionError(section.name("qx") + ", qy, qz, qw have the norm " + std::to_string(q.norm()) +
                      ", a rotation has 1");
  }
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = q.normalized().toRotationMatrix();
  T.translation() = Eigen::Vector3d(section.number("px"), section.number("py"), section.number("pz"));
  return T;
}

/// Basalt's JSON (gitlab.com/VladyslavUsenko/basalt, data/*_calib.json).
SensorCalibration read_basalt(const Section& root, const std::string& camera_name) {
  const Section all = root.child("value0");
  const std::size_t index = std::stoul(camera_name.substr(std::string("cam").size()));
  SensorCalibration calibration;
  CameraCalibration camera;
  const Section section = all.element("intrinsics", index);
  const LensModelRow lens = find_lens_model(section, "camera_type", section.text("camera_type"),
                                            [](const LensModelRow& row) { return row.basalt.name; });
  set_keyed(section, lens, lens.basalt, camera);
  section.child("intrinsics").ignore("rpmax");  // the end of its range, which follows from the coefficients
  const YAML::Node sizes = all.get("resolution");
  if (!sizes.IsSequence() || index >= sizes.size())
    refuse(all.name("resolution"), sizes, "a list with a size for each camera");
  set_resolution(all, "resolution", sizes[index], camera);
  calibration.camera = validated(section, camera);

  if (all.has("T_imu_cam")) {
    const Eigen::Isometry3d T_imu_cam = read_basalt_transform(all.element("T_imu_cam", index));
    // Basalt calibrates cameras before the IMU. Until then the first camera's transform is the identity.
    const Eigen::Isometry3d first = read_basalt_transform(all.element("T_imu_cam", 0));
    if (first.matrix() == Eigen::Matrix4d::Identity()) {
      calibration.notes.push_back(all.name("T_imu_cam") +
                                  "[0] is the identity, as before the IMU is calibrated, and not used: calibrate the "
                                  "IMU, or set R_cam_imu");
    } else {
      set_T_cam_imu(T_imu_cam.inverse(), calibration);
    }
  }
  if (all.has("cam_time_offset_ns")) {  // added to the images' stamps
    const double offset_ns = all.number("cam_time_offset_ns");
    constexpr double kLongestNs = 1e15;  // as of times in seconds
    require_range(all.name("cam_time_offset_ns").c_str(), offset_ns, -kLongestNs, kLongestNs, "ns");
    calibration.time_offset_ns = std::llround(offset_ns);
  }
  all.ignore({"accel_bias_std", "accel_noise_std", "calib_accel_bias", "calib_gyro_bias", "gyro_bias_std",
              "gyro_noise_std", "imu_update_rate", "mocap_time_offset_ns", "mocap_to_imu_offset_ns", "T_imu_marker",
              "T_mocap_world", "vignette"});
  record_unknown_keys(root, calibration);
  return calibration;
}

SensorCalibration read_camera_info(const Section& root) {
  CameraCalibration camera;
  camera.width_px = root.integer("image_width");
  camera.height_px = root.integer("image_height");
  const Eigen::Matrix3d K = root.matrix("camera_matrix", 3, 3);
  set_intrinsics({K(0, 0), K(1, 1), K(0, 2), K(1, 2)}, camera);
  try {
    camera.model = camera_info_model(root.text("distortion_model")).name;
  } catch (const OptionError& error) {
    throw OptionError(root.name("") + error.what());
  }
  const Section coefficients = root.child("distortion_coefficients");
  coefficients.ignore({"rows", "cols"});
  camera.coefficients = coefficients.numbers("data");
  SensorCalibration calibration;
  calibration.camera = validated(root, camera);
  root.ignore({"camera_name", "rectification_matrix", "projection_matrix"});
  record_unknown_keys(root, calibration);
  return calibration;
}

}  // namespace

bool is_camera_name(const std::string& key) {
  static const std::regex kName("cam\\d{1,3}");
  return std::regex_match(key, kName);
}

SensorCalibration read_calibration_file(const std::string& path, const std::string& camera) {
  const Section root = Section::load(path);
  if (root.node().IsMap()) {
    const auto has = [node = root.node()](const char* key) { return static_cast<bool>(node[key]); };
    if (has_kalibr_camera(root.node())) return read_kalibr(root, camera);
    if (has("value0")) return read_basalt(root, camera);
    if (has("sensor_type") || has("T_BS")) return read_euroc(root);
    for (const char* key : {"projection_parameters", "body_T_cam0", "extrinsicRotation", "cam0_calib", "model_type"}) {
      if (has(key)) return read_vins(root, camera);
    }
    if (has("camera_matrix")) return read_camera_info(root);
  }
  throw OptionError(root.path() +
                    ": is none of Kalibr's camchain (cam0: {camera_model: ...}), EuRoC's sensor.yaml (sensor_type: "
                    "camera), VINS' configuration (body_T_cam0, projection_parameters), Basalt's "
                    "calibration (value0: {intrinsics: ...}) and camera_calibration's YAML (camera_matrix)");
}

}  // namespace gyro_deblur
