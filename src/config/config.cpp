// Reads and checks the configuration; names the new parameter if a former name is used.
#include "gyro_deblur/config.hpp"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <sstream>
#include <stdexcept>
#include <type_traits>
#include <variant>

#include <yaml-cpp/yaml.h>

#include "config/parameters.hpp"
#include "config/yaml_reading.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

// One for each type of value: reads the node into it, or throws OptionError.

void read(const Parameter& p, const YAML::Node& node, bool& value) {
  value = read_scalar<bool>(p.key, node, "true or false");
}

void read(const Parameter& p, const YAML::Node& node, int& value) { value = read_integer(p.key, node); }

void read(const Parameter& p, const YAML::Node& node, double& value) {
  value = read_number(p.key, node, "a finite number");
}

void read(const Parameter& p, const YAML::Node& node, TimeNs& value) { value = read_seconds(p.key, node); }

void read(const Parameter& p, const YAML::Node& node, std::string& value) {
  if (!node.IsScalar()) refuse(p.key, node, "a string");
  value = node.Scalar();
}

void read(const Parameter& p, const YAML::Node& node, Choice& value) {
  std::string allowed = "one of";
  for (const std::string& choice : p.choices) allowed += " " + choice;
  if (!node.IsScalar() || std::find(p.choices.begin(), p.choices.end(), node.Scalar()) == p.choices.end()) {
    refuse(p.key, node, allowed);
  }
  value.name = node.Scalar();
}

/// One path, a list of paths, or nothing.
void read(const Parameter& p, const YAML::Node& node, std::vector<std::string>& paths) {
  paths.clear();
  if (node.IsScalar()) {
    if (!node.Scalar().empty()) paths.push_back(node.Scalar());
    return;
  }
  if (!node.IsSequence()) refuse(p.key, node, "a path or a list of paths");
  for (const YAML::Node& path : node) {
    if (!path.IsScalar()) refuse(p.key, node, "a path or a list of paths");
    paths.push_back(path.Scalar());
  }
}

void read(const Parameter& p, const YAML::Node& node, Eigen::Vector3d& value) {
  const std::string allowed = "a list of 3 finite numbers";
  if (!node.IsSequence() || node.size() != 3) refuse(p.key, node, allowed);
  for (std::size_t i = 0; i < 3; ++i) value[static_cast<int>(i)] = read_number(p.key, node[i], allowed);
}

/// Nine numbers by row, three rows of three, or an empty list for nothing.
void read(const Parameter& p, const YAML::Node& node, std::optional<Eigen::Matrix3d>& value) {
  const std::string allowed =
      "a rotation as 9 numbers row by row or 3 rows of 3, or [] to take it from tf or the images";
  if (is_empty(node)) {
    value.reset();
    return;
  }
  if (!node.IsSequence()) refuse(p.key, node, allowed);
  const bool nested = node.size() == 3;
  if (!nested && node.size() != 9) refuse(p.key, node, allowed);
  Eigen::Matrix3d matrix;
  for (std::size_t row = 0; row < 3; ++row) {
    if (nested && (!node[row].IsSequence() || node[row].size() != 3)) refuse(p.key, node, allowed);
    for (std::size_t col = 0; col < 3; ++col) {
      matrix(static_cast<int>(row), static_cast<int>(col)) =
          read_number(p.key, nested ? node[row][col] : node[3 * row + col], allowed);
    }
  }
  value = matrix;
}

/// Takes the calibration file's values into the configuration. A key that contradicts one (0 and empty do not) wins
/// with on_calibration_conflict: configured, and is refused otherwise.
void apply_calibration(const SensorCalibration& calibration, Config& config) {
  const std::string key = "the parameter";
  const bool key_holds = config.on_calibration_conflict == OnCalibrationConflict::CONFIGURED;
  if (calibration.R_cam_imu && !(key_holds && config.R_cam_imu)) {
    if (config.R_cam_imu) {
      require_agreement(require_rotation("R_cam_imu", *config.R_cam_imu), key, *calibration.R_cam_imu,
                        calibration.origin);
    }
    config.R_cam_imu = calibration.R_cam_imu;
  }
  const auto apply_time = [&](const char* name, const std::optional<TimeNs>& value_ns, TimeNs& target_ns,
                              bool& is_given) {
    if (!value_ns || (key_holds && target_ns != 0)) return;
    is_given = true;
    if (target_ns != 0) require_agreement(name, target_ns, key, *value_ns, calibration.origin);
    target_ns = *value_ns;
  };
  apply_time("time_offset", calibration.time_offset_ns, config.gyro.time_offset_ns, config.given.time_offset);
  apply_time("readout_time", calibration.readout_ns, config.shutter.readout_ns, config.given.readout_time);
  if (calibration.frame_period_ns) {
    require_plausible_readout("readout_time", config.shutter.readout_ns, *calibration.frame_period_ns);
  }
}

/// A list that came as a string, "[0, 0, 0]", as `<param value="...">` of a launch file gives it.
template <typename T>
YAML::Node unquoted_list(const YAML::Node& node) {
  constexpr bool kIsList = std::is_same_v<T, Eigen::Vector3d> || std::is_same_v<T, std::optional<Eigen::Matrix3d>> ||
                           std::is_same_v<T, std::vector<std::string>>;
  if (!kIsList || !is_quoted(node) || node.Scalar().empty() || node.Scalar().front() != '[') return node;
  try {
    return YAML::Load(node.Scalar());
  } catch (const YAML::Exception&) {
    return node;
  }
}

/// Throws OptionError for a value that a parameter had under a former name.
void refuse_former_value(const std::string& key, const YAML::Node& node) {
  static const std::map<std::pair<std::string, std::string>, std::string> kPresentValues{
      {{"engine", "plane"}, "fourier"},
      {{"regularization", "noise"}, "adaptive"},
      {{"validation", "paper"}, "gradient"}};
  if (!node.IsScalar()) return;
  const auto present = kPresentValues.find({key, node.Scalar()});
  if (present != kPresentValues.end()) refuse(key, node, "known any more: it is now called " + present->second);
}

/// Sets what the keys say. Calibration files are not opened yet.
Config read_keys(const YAML::Node& node, std::vector<std::string>* unknown) {
  Config config;
  config.given = {false, false, false, false};
  if (node.IsNull()) return config;
  if (!node.IsMap())
    throw OptionError("the configuration is not a map of keys: " + describe(node) + "; write KEY: VALUE lines");
  std::set<std::string> seen;
  for (const auto& entry : node) {
    if (!entry.first.IsScalar())
      throw OptionError("configuration key " + describe(entry.first) + " is not the name of a parameter");
    const std::string& key = entry.first.Scalar();
    if (!seen.insert(key).second)
      throw OptionError(key + " = " + describe(entry.second) + " is given a second time: remove one of the two");
    if (const Parameter* parameter = find_parameter(key)) {
      if (parameter->may_be_empty() && is_empty(entry.second)) continue;
      refuse_former_value(key, entry.second);
      parameter->set_given(config, true);
      Value value = parameter->standard();
      std::visit([&](auto& v) { read(*parameter, unquoted_list<std::decay_t<decltype(v)>>(entry.second), v); }, value);
      parameter->set(config, value);
    } else if (unknown != nullptr) {
      unknown->push_back(key);
    }
  }
  return config;
}

Config parse_node(const YAML::Node& node, std::vector<std::string>* unknown, const std::string& folder) {
  Config config = read_keys(node, unknown);
  if (!config.mask_file.empty()) config.mask_file = (std::filesystem::path(folder) / config.mask_file).string();
  if (!config.calibration_files.empty()) {
    std::vector<SensorCalibration> sources;
    for (const std::string& file : config.calibration_files) {
      // An absolute path replaces the folder.
      sources.push_back(load_calibration((std::filesystem::path(folder) / file).string(), config.calibration_camera));
    }
    config.calibration = merge_calibrations(sources);
    apply_calibration(*config.calibration, config);
  }
  config.validate();
  return config;
}

}  // namespace

Config parse_config(const std::string& yaml, std::vector<std::string>* unknown, const std::string& folder) {
  YAML::Node node;
  try {
    node = YAML::Load(yaml);
  } catch (const YAML::Exception& error) {
    throw OptionError(std::string("the configuration is not YAML: ") + error.what());
  }
  return parse_node(node, unknown, folder);
}

Config load_config(const std::string& path, std::vector<std::string>* unknown) {
  YAML::Node node;
  try {
    node = YAML::LoadFile(path);
  } catch (const YAML::Exception& error) {
    throw OptionError("configuration " + path + " cannot be read: " + error.what());
  }
  try {
    return parse_node(node, unknown, std::filesystem::path(path).parent_path().string());
  } catch (const OptionError& error) {
    throw OptionError("configuration " + path + ": " + error.what());
  }
}

namespace {

std::string to_text(int value) { return std::to_string(value); }
std::string to_text(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}
std::string to_text(TimeNs value_ns) { return to_text(to_seconds(value_ns)); }
std::string to_text(const Choice& value) { return value.name; }
template <typename T>
std::string to_text(const T&) {
  throw std::logic_error("no constant has this type");
}

/// The value of a constant with its unit.
std::string value_of(const Parameter& constant) {
  const std::string value = std::visit([](const auto& v) { return to_text(v); }, constant.standard());
  return value + (constant.limits && *constant.limits->unit != '\0' ? std::string(" ") + constant.limits->unit : "");
}

}  // namespace

std::string unknown_key_message(const std::string& key) {
  static const std::map<std::string, std::string> kPresentNames{{"backend", "engine"},
                                                                {"descriptor", "keypoint_descriptor"},
                                                                {"detector", "keypoint_detector"},
                                                                {"drop_bad", "drop_poor"},
                                                                {"false_acceptance", "validation_false_accept_rate"},
                                                                {"gamma", "noise_to_signal_ratio"},
                                                                {"gamma_rule", "regularization"},
                                                                {"gyro_timeout", "input_timeout"},
                                                                {"kernel_length_factor", "filter_length_factor"},
                                                                {"kernel_smoothing", "filter_smoothing"},
                                                                {"max_bend", "curved_path_threshold"},
                                                                {"max_features", "max_keypoints"},
                                                                {"motion_from_images", "optical_flow"},
                                                                {"noise_gain", "photon_gain"},
                                                                {"stereo_patience", "stereo_sync_timeout"}};
  static const std::string kSeenByImages = "optical_flow sees translation without it";
  static const std::map<std::string, std::string> kReplacements{
      {"bridge_gyro_gaps", "it is now called flow_without_gyro, and true is now always"},
      {"validate", "it is now part of validation, and false is now validation: none"},
      {"grid_cols", "columns and rows are now keypoint_grid"},
      {"grid_rows", "columns and rows are now keypoint_grid"},
      {"scene_depth", kSeenByImages},
      {"scene_depth_max_age", kSeenByImages},
      {"odometry_max_age", kSeenByImages},
      {"odometry_max_speed", kSeenByImages},
      {"odometry_max_acceleration", kSeenByImages},
      {"odometry_max_stddev", kSeenByImages},
      {"odometry_clock", kSeenByImages},
      {"odometry_twist_frame", kSeenByImages},
      {"p_cam_imu", kSeenByImages}};
  const auto present = kPresentNames.find(key);
  const std::string& name = present == kPresentNames.end() ? key : present->second;
  if (const Parameter* constant = find_constant(name)) {
    return key + " is no parameter any more, ignored: it is " + value_of(*constant) + ". " + constant->text;
  }
  if (present != kPresentNames.end()) return key + " is not known, ignored: it is now called " + name;
  const auto replacement = kReplacements.find(key);
  return key + " is not known, ignored" + (replacement == kReplacements.end() ? "" : ": " + replacement->second);
}

}  // namespace gyro_deblur
