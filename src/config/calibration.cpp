#include "gyro_deblur/calibration.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <limits>
#include <regex>
#include <sstream>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "base/listing.hpp"
#include "config/yaml_reading.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/lens_models.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;

/// A map of a calibration file; its errors begin with file and key.
class Section {
 public:
  /// @param prefix  ends with a dot, or is empty
  Section(std::string path, std::string prefix, YAML::Node node)
      : path_(std::move(path)), prefix_(std::move(prefix)), node_(std::move(node)) {}

  const std::string& path() const { return path_; }
  const YAML::Node& node() const { return node_; }
  std::string name(const std::string& key) const { return path_ + ": " + prefix_ + key; }
  bool has(const std::string& key) const { return node_.IsMap() && node_[key]; }

  YAML::Node get(const std::string& key) const {
    if (!has(key)) throw OptionError(name(key) + " is missing");
    return node_[key];
  }
  Section child(const std::string& key) const {
    const YAML::Node node = get(key);
    if (!node.IsMap()) refuse(name(key), node, "a map of keys");
    return {path_, prefix_ + key + ".", node};
  }
  std::string text(const std::string& key) const {
    const YAML::Node node = get(key);
    if (!node.IsScalar()) refuse(name(key), node, "a string");
    return node.Scalar();
  }
  double number(const std::string& key) const { return read_number(name(key), get(key), "a finite number"); }
  int integer(const std::string& key) const { return read_scalar<int>(name(key), get(key), "an integer"); }
  TimeNs seconds(const std::string& key) const { return read_seconds(name(key), get(key)); }

  std::vector<double> numbers(const std::string& key) const {
    const YAML::Node node = get(key);
    const std::string allowed = "a list of finite numbers";
    if (!node.IsSequence()) refuse(name(key), node, allowed);
    std::vector<double> values;
    for (const YAML::Node& element : node) values.push_back(read_number(name(key), element, allowed));
    return values;
  }
  std::vector<double> numbers(const std::string& key, std::size_t count) const {
    const std::vector<double> values = numbers(key);
    if (values.size() != count) refuse(name(key), get(key), "a list of " + std::to_string(count) + " numbers");
    return values;
  }

  /// A list of rows, or OpenCV's map of rows, cols and data.
  Eigen::MatrixXd matrix(const std::string& key, int rows, int cols) const {
    const YAML::Node node = get(key);
    const std::string allowed = "a matrix of " + std::to_string(rows) + "x" + std::to_string(cols) + " finite numbers";
    std::vector<double> values;
    if (node.IsMap()) {
      const Section map = child(key);
      if (map.integer("rows") != rows || map.integer("cols") != cols) refuse(name(key), node, allowed);
      values = map.numbers("data");
    } else if (node.IsSequence()) {
      for (const YAML::Node& row : node) {
        if (!row.IsSequence() || row.size() != static_cast<std::size_t>(cols)) refuse(name(key), node, allowed);
        for (const YAML::Node& element : row) values.push_back(read_number(name(key), element, allowed));
      }
    }
    if (values.size() != static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols)) {
      refuse(name(key), node, allowed);
    }
    return Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(values.data(), rows,
                                                                                                    cols);
  }
  Eigen::Matrix3d rotation(const std::string& key) const {
    return require_rotation(name(key).c_str(), Eigen::Matrix3d(matrix(key, 3, 3)));
  }
  /// A rigid transform as 4x4 numbers.
  Eigen::Isometry3d transform(const std::string& key) const {
    const Eigen::Matrix4d T = matrix(key, 4, 4);
    constexpr double kRounding = 1e-9;
    if ((T.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > kRounding) {
      refuse(name(key), get(key), "a transform: its last row has to be [0, 0, 0, 1]");
    }
    Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
    result.linear() = require_rotation(name(key).c_str(), T.topLeftCorner<3, 3>());
    result.translation() = T.topRightCorner<3, 1>();
    return result;
  }

 private:
  std::string path_, prefix_;
  YAML::Node node_;
};

[[noreturn]] void refuse_model(const Section& section, const std::string& key, const std::string& supported) {
  throw OptionError(section.name(key) + " = " + section.text(key) + " is not supported; " + supported);
}

/// The lens model that a file names under `key`.
/// @param name      what the file has there, as the table spells it
/// @param spelling  of a row of the table: its name in the file's format, "" where the format does not have it
/// @param advice    ends the message about a name that no row has
template <typename Spelling>
const LensModelRow& find_lens_model(const Section& section, const std::string& key, const std::string& name,
                                    const Spelling& spelling, const std::string& advice = "") {
  std::vector<std::string> supported;
  for (const LensModelRow& row : lens_models()) {
    const std::string known = spelling(row);
    if (known.empty()) continue;
    if (name == known) return row;
    supported.push_back(known);
  }
  refuse_model(section, key, "supported are " + listing(supported, "and") + advice);
}

/// Whole pixels, for numbers that some files write as 752.0.
int to_pixels(const Section& section, const std::string& key, double value) {
  if (value != std::floor(value) || std::abs(value) > 1e6) refuse(section.name(key), section.get(key), "whole pixels");
  return static_cast<int>(value);
}

void set_resolution(const Section& section, CameraCalibration& camera) {
  const std::vector<double> size = section.numbers("resolution", 2);
  camera.width_px = to_pixels(section, "resolution", size[0]);
  camera.height_px = to_pixels(section, "resolution", size[1]);
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

void set_T_cam_imu(const Eigen::Isometry3d& T_cam_imu, SensorCalibration& calibration) {
  calibration.R_cam_imu = T_cam_imu.linear();
  calibration.p_imu_cam_m = T_cam_imu.inverse().translation();
}

bool is_camera_name(const std::string& key) {
  static const std::regex kName("cam\\d+");
  return std::regex_match(key, kName);
}

bool has_kalibr_camera(const YAML::Node& root) {
  return std::any_of(root.begin(), root.end(), [](const auto& entry) {
    return entry.first.IsScalar() && is_camera_name(entry.first.Scalar()) && entry.second.IsMap();
  });
}

SensorCalibration read_kalibr(const Section& root, const std::string& camera_name) {
  if (!root.has(camera_name)) {
    std::string names;
    for (const auto& entry : root.node()) names += " " + entry.first.Scalar();
    throw OptionError(root.name(camera_name) + " is missing; the file has" + names);
  }
  const Section section = root.child(camera_name);
  if (section.text("camera_model") != "pinhole") refuse_model(section, "camera_model", "supported is pinhole");
  CameraCalibration camera;
  set_resolution(section, camera);
  set_intrinsics(section.numbers("intrinsics", 4), camera);
  const LensModelRow& lens = find_lens_model(
      section, "distortion_model", section.text("distortion_model"),
      [](const LensModelRow& row) { return row.kalibr.name; }, "; calibrate again with one of these");
  camera.model = lens.name;
  if (lens.kalibr.coefficients > 0 || section.has("distortion_coeffs")) {
    camera.coefficients = section.numbers("distortion_coeffs", lens.kalibr.coefficients);
  }

  SensorCalibration calibration;
  calibration.camera = validated(section, camera);
  if (section.has("T_cam_imu")) set_T_cam_imu(section.transform("T_cam_imu"), calibration);
  if (section.has("timeshift_cam_imu")) calibration.time_offset_ns = section.seconds("timeshift_cam_imu");
  return calibration;
}

Section load_section(const std::string& path) { return {path, "", load_yaml_file(path)}; }

SensorCalibration read_euroc(const Section& root) {
  if (root.has("sensor_type") && root.text("sensor_type") != "camera") {
    refuse(root.name("sensor_type"), root.get("sensor_type"), "camera: name the camera's file");
  }
  if (root.has("camera_model") && root.text("camera_model") != "pinhole") {
    refuse_model(root, "camera_model", "supported is pinhole");
  }
  CameraCalibration camera;
  set_resolution(root, camera);
  set_intrinsics(root.numbers("intrinsics", 4), camera);
  const LensModelRow& lens = find_lens_model(root, "distortion_model", root.text("distortion_model"),
                                             [](const LensModelRow& row) { return row.euroc.name; });
  camera.model = lens.name;
  camera.coefficients = root.numbers("distortion_coefficients", lens.euroc.coefficients);

  SensorCalibration calibration;
  calibration.camera = validated(root, camera);
  Eigen::Isometry3d T_body_imu = Eigen::Isometry3d::Identity();
  const fs::path imu_path = fs::absolute(root.path()).parent_path().parent_path() / "imu0" / "sensor.yaml";
  if (fs::is_regular_file(imu_path)) T_body_imu = load_section(imu_path.string()).transform("T_BS");
  set_T_cam_imu(root.transform("T_BS").inverse() * T_body_imu, calibration);
  if (root.has("rate_hz")) {
    const double rate_hz = root.number("rate_hz");
    constexpr double kSlowestHz = 1e-3, kFastestHz = 1e6;
    require_range(root.name("rate_hz").c_str(), rate_hz, kSlowestHz, kFastestHz, "Hz");
    calibration.frame_period_ns = to_ns(1 / rate_hz);
  }
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
  const Section projection = root.child("projection_parameters");
  const LensModelRow& lens = find_lens_model(root, "model_type", upper_if_lower(model),
                                             [](const LensModelRow& row) { return row.camodocal.name; });
  std::vector<double> intrinsics;
  for (const std::string& key : lens.camodocal.intrinsics) intrinsics.push_back(projection.number(key));
  set_intrinsics(intrinsics, camera);
  camera.model = lens.name;
  const Section section = root.child(lens.camodocal.section);
  for (const std::string& key : lens.camodocal.coefficients) camera.coefficients.push_back(section.number(key));
  return validated(root, camera);
}

SensorCalibration read_vins(const Section& root, const std::string& camera_name) {
  SensorCalibration calibration;
  const std::string calib_key = camera_name + "_calib", transform_key = "body_T_" + camera_name;
  if (root.has(calib_key)) {
    const fs::path intrinsics = fs::path(root.path()).parent_path() / root.text(calib_key);
    calibration.camera = read_vins_camera(load_section(intrinsics.string()));
  } else {
    calibration.camera = read_vins_camera(root);
  }
  constexpr int kNotKnown = 2;  // "Don't know anything about extrinsic parameters"
  const bool extrinsic_known = !root.has("estimate_extrinsic") || root.integer("estimate_extrinsic") != kNotKnown;
  if (extrinsic_known && root.has("extrinsicRotation") && !root.has(transform_key)) {
    calibration.R_cam_imu = root.rotation("extrinsicRotation").transpose();
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
  return calibration;
}

SensorCalibration read_camera_info(const Section& root) {
  CameraCalibration camera;
  camera.width_px = root.integer("image_width");
  camera.height_px = root.integer("image_height");
  const Eigen::Matrix3d K = root.matrix("camera_matrix", 3, 3);
  set_intrinsics({K(0, 0), K(1, 1), K(0, 2), K(1, 2)}, camera);
  try {
    camera.model = require_distortion_model(root.text("distortion_model"));
  } catch (const OptionError& error) {
    throw OptionError(root.name("") + error.what());
  }
  camera.coefficients = root.child("distortion_coefficients").numbers("data");
  SensorCalibration calibration;
  calibration.camera = validated(root, camera);
  return calibration;
}

SensorCalibration read_any(const Section& root, const std::string& camera) {
  if (root.node().IsMap()) {
    if (has_kalibr_camera(root.node())) return read_kalibr(root, camera);
    if (root.has("sensor_type") || root.has("T_BS")) return read_euroc(root);
    for (const char* key : {"projection_parameters", "body_T_cam0", "extrinsicRotation", "cam0_calib", "model_type"}) {
      if (root.has(key)) return read_vins(root, camera);
    }
    if (root.has("camera_matrix")) return read_camera_info(root);
  }
  throw OptionError(root.path() +
                    ": is none of Kalibr's camchain (cam0: {camera_model: ...}), EuRoC's sensor.yaml (sensor_type: "
                    "camera), VINS' configuration (body_T_cam0, projection_parameters) and camera_calibration's YAML "
                    "(camera_matrix)");
}

template <typename A, typename B>
[[noreturn]] void refuse_conflict(const std::string& quantity, const A& a, const std::string& name_a, const B& b,
                                  const std::string& name_b, const std::string& difference) {
  std::ostringstream text;
  text << quantity << " is " << a << " in " << name_a << ", but " << b << " in " << name_b << " (they differ by "
       << difference << ")";
  throw OptionError(text.str());
}

}  // namespace

std::string to_string(const CameraCalibration& camera) {
  std::ostringstream text;
  text.precision(10);
  text << camera.width_px << "x" << camera.height_px << " px, fx " << camera.fx_px << ", fy " << camera.fy_px << ", cx "
       << camera.cx_px << ", cy " << camera.cy_px << ", " << camera.model << " [";
  for (std::size_t i = 0; i < camera.coefficients.size(); ++i) text << (i > 0 ? ", " : "") << camera.coefficients[i];
  text << "]";
  return text.str();
}

std::string to_string(const Eigen::Matrix3d& matrix) {
  static const Eigen::IOFormat kOneLine(6, Eigen::DontAlignCols, ", ", ", ", "", "", "[", "]");
  std::ostringstream text;
  constexpr double kDigits = 1e9;  // rounding leaves neither 2e-16 nor -0
  const Eigen::Matrix3d rounded = ((matrix * kDigits).array().round() / kDigits + 0.0).matrix();
  text << rounded.format(kOneLine);
  return text.str();
}

void require_agreement(const CameraCalibration& a, const std::string& name_a, const CameraCalibration& b,
                       const std::string& name_b) {
  constexpr double kAllowedPx = 0.1;
  const auto conflict = [&](const std::string& difference) {
    refuse_conflict("the camera's calibration", to_string(a), name_a, to_string(b), name_b, difference);
  };
  if (a.width_px != b.width_px || a.height_px != b.height_px) conflict("the size");
  const Camera camera_a(a), camera_b(b);
  // Where neither lens model reaches, they need not agree.
  constexpr int kSteps = 8;
  double largest_px = 0;
  for (int row = 0; row <= kSteps; ++row) {
    for (int col = 0; col <= kSteps; ++col) {
      const Eigen::Vector2d pixel((a.width_px - 1.0) * col / kSteps, (a.height_px - 1.0) * row / kSteps);
      const Eigen::Vector3d ray_a = camera_a.ray(pixel);
      if (!ray_a.allFinite() && !camera_b.ray(pixel).allFinite()) continue;
      const double distance_px = (camera_b.project(ray_a) - pixel).norm();
      // One model reaches this place and the other does not.
      largest_px =
          std::max(largest_px, std::isfinite(distance_px) ? distance_px : std::numeric_limits<double>::infinity());
    }
  }
  if (!(largest_px <= kAllowedPx)) {
    std::ostringstream difference;
    difference.precision(3);
    difference << "up to " << largest_px << " px in the image";
    conflict(difference.str());
  }
}

void require_agreement(const Eigen::Matrix3d& R_cam_imu_a, const std::string& name_a,
                       const Eigen::Matrix3d& R_cam_imu_b, const std::string& name_b) {
  constexpr double kAllowedDeg = 0.1;
  const double angle_deg =
      Eigen::AngleAxisd(Eigen::Matrix3d(R_cam_imu_a.transpose() * R_cam_imu_b)).angle() * 180 / M_PI;
  if (angle_deg <= kAllowedDeg) return;
  std::ostringstream difference;
  difference.precision(3);
  difference << angle_deg << " degrees";
  refuse_conflict("R_cam_imu", to_string(R_cam_imu_a), name_a, to_string(R_cam_imu_b), name_b, difference.str());
}

void require_agreement(const char* quantity, TimeNs a_ns, const std::string& name_a, TimeNs b_ns,
                       const std::string& name_b) {
  constexpr TimeNs kAllowedNs = 1000;
  if (std::abs(a_ns - b_ns) <= kAllowedNs) return;
  const auto text = [](TimeNs t_ns) { return std::to_string(to_seconds(t_ns)) + " s"; };
  refuse_conflict(quantity, text(a_ns), name_a, text(b_ns), name_b, text(std::abs(a_ns - b_ns)));
}

SensorCalibration load_calibration(const std::string& path, const std::string& camera) {
  const std::string file = fs::is_directory(path) ? (fs::path(path) / camera / "sensor.yaml").string() : path;
  if (!is_camera_name(camera)) throw OptionError("camera \"" + camera + "\" is not one of cam0, cam1, ...");
  SensorCalibration calibration;
  try {
    calibration = read_any(load_section(file), camera);
  } catch (const YAML::Exception& error) {
    throw OptionError(file + ": " + error.what());
  }
  calibration.origin = file;
  if (calibration.readout_ns && calibration.frame_period_ns) {
    require_plausible_readout((file + ": readout").c_str(), *calibration.readout_ns, *calibration.frame_period_ns);
  }
  return calibration;
}

SensorCalibration merge_calibrations(const std::vector<SensorCalibration>& sources) {
  SensorCalibration merged;
  // Which source said what, for conflicts.
  const auto take = [](auto& target, std::string& from, const auto& value, const std::string& origin,
                       const auto& compare) {
    if (!value) return;
    if (!target) {
      target = value;
      from = origin;
    } else {
      compare(*target, from, *value, origin);
    }
  };
  std::string camera, rotation, position, offset, readout, period;
  for (const SensorCalibration& source : sources) {
    merged.origin += (merged.origin.empty() ? "" : " and ") + source.origin;
    const auto same_time = [](const char* quantity) {
      return [quantity](TimeNs a, const std::string& name_a, TimeNs b, const std::string& name_b) {
        require_agreement(quantity, a, name_a, b, name_b);
      };
    };
    take(merged.camera, camera, source.camera, source.origin,
         [](const auto& a, const auto& name_a, const auto& b, const auto& name_b) {
           require_agreement(a, name_a, b, name_b);
         });
    take(merged.R_cam_imu, rotation, source.R_cam_imu, source.origin,
         [](const auto& a, const auto& name_a, const auto& b, const auto& name_b) {
           require_agreement(a, name_a, b, name_b);
         });
    // Deblurring takes no notice of where the camera sits, so that a difference does no harm.
    take(merged.p_imu_cam_m, position, source.p_imu_cam_m, source.origin, [](const auto&...) {});
    take(merged.time_offset_ns, offset, source.time_offset_ns, source.origin, same_time("time_offset"));
    take(merged.readout_ns, readout, source.readout_ns, source.origin, same_time("readout_time"));
    take(merged.frame_period_ns, period, source.frame_period_ns, source.origin, same_time("the frame period"));
  }
  if (merged.readout_ns && merged.frame_period_ns) {
    require_plausible_readout((readout + ": readout").c_str(), *merged.readout_ns, *merged.frame_period_ns);
  }
  return merged;
}

}  // namespace gyro_deblur
