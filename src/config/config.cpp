// Reads and checks the configuration.
#include "gyro_deblur/config.hpp"

#include <algorithm>
#include <filesystem>
#include <set>
#include <sstream>
#include <tuple>
#include <type_traits>

#include <yaml-cpp/yaml.h>

#include "config/config_table.hpp"
#include "config/yaml_reading.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

// One for each type of value: reads the node into it, or throws OptionError.

void read(const Row& row, const YAML::Node& node, bool& value) {
  value = read_scalar<bool>(row.key, node, "true or false");
}

void read(const Row& row, const YAML::Node& node, int& value) { value = read_integer(row.key, node); }

void read(const Row& row, const YAML::Node& node, double& value) {
  value = read_number(row.key, node, "a finite number");
}

void read(const Row& row, const YAML::Node& node, TimeNs& value) { value = read_seconds(row.key, node); }

void read(const Row& row, const YAML::Node& node, std::string& value) {
  if (!node.IsScalar()) refuse(row.key, node, "a string");
  value = node.Scalar();
}

template <typename Enum>
void assign(const Enum& named, Enum& value) {
  value = named;
}

void assign(const ExposureMessage& named, ExposureSource& value) { std::tie(value.kind, value.unit) = named; }

template <typename T>
std::enable_if_t<HasNames<T>::value> read(const Row& row, const YAML::Node& node, T& value) {
  std::string allowed = "one of";
  for (const auto& [name, named] : names_of(value)) {
    if (node.IsScalar() && node.Scalar() == name) return assign(named, value);
    allowed += std::string(" ") + name;
  }
  refuse(row.key, node, allowed);
}

/// One path, a list of paths, or nothing.
void read(const Row& row, const YAML::Node& node, std::vector<std::string>& paths) {
  paths.clear();
  if (node.IsScalar()) {
    if (!node.Scalar().empty()) paths.push_back(node.Scalar());
    return;
  }
  if (!node.IsSequence()) refuse(row.key, node, "a path or a list of paths");
  for (const YAML::Node& path : node) {
    if (!path.IsScalar()) refuse(row.key, node, "a path or a list of paths");
    paths.push_back(path.Scalar());
  }
}

void read(const Row& row, const YAML::Node& node, Eigen::Vector3d& value) {
  const std::string allowed = "a list of 3 finite numbers";
  if (!node.IsSequence() || node.size() != 3) refuse(row.key, node, allowed);
  for (std::size_t i = 0; i < 3; ++i) value[static_cast<int>(i)] = read_number(row.key, node[i], allowed);
}

/// Nine numbers by row, three rows of three, or an empty list for nothing.
void read(const Row& row, const YAML::Node& node, std::optional<Eigen::Matrix3d>& value) {
  const std::string allowed =
      "a rotation as 9 numbers row by row or 3 rows of 3, or [] to take it from tf or the images";
  if (is_empty(node)) {
    value.reset();
    return;
  }
  if (!node.IsSequence()) refuse(row.key, node, allowed);
  const bool nested = node.size() == 3;
  if (!nested && node.size() != 9) refuse(row.key, node, allowed);
  Eigen::Matrix3d matrix;
  for (std::size_t i = 0; i < 3; ++i) {
    if (nested && (!node[i].IsSequence() || node[i].size() != 3)) refuse(row.key, node, allowed);
    for (std::size_t j = 0; j < 3; ++j) {
      matrix(static_cast<int>(i), static_cast<int>(j)) =
          read_number(row.key, nested ? node[i][j] : node[3 * i + j], allowed);
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

/// Sets what the key says. False: it is not known.
bool read_key(const std::string& key, const YAML::Node& node, Config* config) {
  bool is_known = false;
  for_each_parameter(*config, [&](const Row& row, auto& value) {
    if (key != row.key || row.change == Change::NEVER) return;
    is_known = true;
    const auto number = std::find_if(std::begin(kGivenNumbers), std::end(kGivenNumbers),
                                     [&](const GivenNumber& given) { return key == given.key; });
    const bool may_be_empty = number != std::end(kGivenNumbers);
    if (may_be_empty && is_empty(node)) return;
    if (may_be_empty) config->given.*number->given = true;
    read(row, unquoted_list<std::decay_t<decltype(value)>>(node), value);
  });
  return is_known;
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
    if (!read_key(key, entry.second, &config) && unknown != nullptr) unknown->push_back(key);
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

/// The value of a constant.
template <typename T>
std::string to_text(const T& value) {
  std::ostringstream text;
  if constexpr (HasNames<T>::value) {
    text << name_of(value);
  } else if constexpr (std::is_same_v<T, TimeNs>) {
    text << to_seconds(value);
  } else if constexpr (std::is_arithmetic_v<T>) {
    text << value;
  }
  return text.str();
}

/// "it is VALUE. REASON" if that is a constant's key, else nothing.
std::string constant_text(const std::string& key) {
  std::string text;
  for_each_parameter(Config(), [&](const Row& row, const auto& value) {
    if (key != row.key || row.change != Change::NEVER) return;
    const bool has_unit = row.limits && *row.limits->unit != '\0';
    text = "it is " + to_text(value) + (has_unit ? std::string(" ") + row.limits->unit : "") + ". " + row.text;
  });
  return text;
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

void set_parameter(const std::string& key, const std::string& yaml, Config* config) {
  read_key(key, YAML::Load(yaml), config);
  for_each_parameter(*config, [&key](const Row& row, const auto& value) {
    if (key == row.key) require_allowed(row, value);
  });
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

void ExposureSource::validate() const {
  if ((kind == Kind::FIELD || kind == Kind::DYNAMIC_RECONFIGURE) && field.empty()) {
    throw OptionError(
        "exposure_field = \"\" is not the name of a field: set it, or exposure_source to auto, which needs none");
  }
}

void Config::validate() const {
  Config checked = *this;
  if (shutter.exposure_ns == 0) checked.shutter.exposure_ns = 1;  // not known; check the rest
  check_parameters(checked);
}

std::string unknown_key_message(const std::string& key) {
  const std::string constant = constant_text(key);
  return constant.empty() ? key + " is not known, ignored" : key + " is a constant, ignored: " + constant;
}

}  // namespace gyro_deblur
