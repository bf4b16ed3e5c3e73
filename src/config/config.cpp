#include "gyro_deblur/config.hpp"

#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <set>
#include <sstream>

#include <yaml-cpp/yaml.h>

#include "config/yaml_reading.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

void read(const std::string& key, const YAML::Node& node, double& value) {
  value = read_number(key, node, "a finite number");
}

void read(const std::string& key, const YAML::Node& node, int& value) {
  value = read_scalar<int>(key, node, "an integer");
}

void read(const std::string& key, const YAML::Node& node, bool& value) {
  value = read_scalar<bool>(key, node, "true or false");
}

void read(const std::string& key, const YAML::Node& node, std::string& value) {
  if (!node.IsScalar()) refuse(key, node, "a string");
  value = node.Scalar();
}

void read(const std::string& key, const YAML::Node& node, Eigen::Vector3d& value) {
  const std::string allowed = "a list of 3 finite numbers";
  if (!node.IsSequence() || node.size() != 3) refuse(key, node, allowed);
  for (std::size_t i = 0; i < 3; ++i) value[static_cast<int>(i)] = read_number(key, node[i], allowed);
}

/// Nine numbers by row, three rows of three, or an empty list for nothing.
void read(const std::string& key, const YAML::Node& node, std::optional<Eigen::Matrix3d>& value) {
  const std::string allowed = "a rotation as 9 numbers row by row or 3 rows of 3, or [] to take it from tf";
  if (!node.IsSequence()) refuse(key, node, allowed);
  if (node.size() == 0) {
    value.reset();
    return;
  }
  const bool nested = node.size() == 3;
  if (!nested && node.size() != 9) refuse(key, node, allowed);
  Eigen::Matrix3d matrix;
  for (std::size_t row = 0; row < 3; ++row) {
    if (nested && (!node[row].IsSequence() || node[row].size() != 3)) refuse(key, node, allowed);
    for (std::size_t col = 0; col < 3; ++col) {
      matrix(static_cast<int>(row), static_cast<int>(col)) =
          read_number(key, nested ? node[row][col] : node[3 * row + col], allowed);
    }
  }
  value = matrix;
}

template <typename Enum>
void read_enum(const std::string& key, const YAML::Node& node, const std::vector<std::pair<const char*, Enum>>& names,
               Enum& value) {
  std::string allowed = "one of";
  for (const auto& [name, enumerator] : names) {
    if (node.IsScalar() && node.Scalar() == name) {
      value = enumerator;
      return;
    }
    allowed += std::string(" ") + name;
  }
  refuse(key, node, allowed);
}

void read(const std::string& key, const YAML::Node& node, StampRow& value) {
  read_enum(key, node, {{"first", StampRow::FIRST}, {"middle", StampRow::MIDDLE}, {"last", StampRow::LAST}}, value);
}

void read(const std::string& key, const YAML::Node& node, StampPhase& value) {
  read_enum(key, node, {{"start", StampPhase::START}, {"middle", StampPhase::MIDDLE}, {"end", StampPhase::END}}, value);
}

void read(const std::string& key, const YAML::Node& node, RectifyTo& value) {
  read_enum(key, node,
            {{"middle_row", RectifyTo::MIDDLE_ROW},
             {"first_row", RectifyTo::FIRST_ROW},
             {"last_row", RectifyTo::LAST_ROW},
             {"stamp", RectifyTo::STAMP}},
            value);
}

void read(const std::string& key, const YAML::Node& node, OdometryClock& value) {
  read_enum(key, node, {{"camera", OdometryClock::CAMERA}, {"imu", OdometryClock::IMU}}, value);
}

void read(const std::string& key, const YAML::Node& node, TwistFrame& value) {
  read_enum(key, node, {{"child", TwistFrame::CHILD}, {"parent", TwistFrame::PARENT}}, value);
}

void read(const std::string& key, const YAML::Node& node, OnCalibrationConflict& value) {
  read_enum(key, node, {{"error", OnCalibrationConflict::ERROR}, {"configured", OnCalibrationConflict::CONFIGURED}},
            value);
}

/// The unit is part of the name, so that nobody has to guess it.
void read(const std::string& key, const YAML::Node& node, ExposureSource& value) {
  using Kind = ExposureSource::Kind;
  std::pair<Kind, ExposureUnit> kind;
  read_enum(key, node,
            {{"message", {Kind::MESSAGE, ExposureUnit::SECONDS}},
             {"field_us", {Kind::FIELD, ExposureUnit::MICROSECONDS}},
             {"field_ms", {Kind::FIELD, ExposureUnit::MILLISECONDS}},
             {"field_s", {Kind::FIELD, ExposureUnit::SECONDS}},
             {"realsense_metadata_us", {Kind::REALSENSE_METADATA, ExposureUnit::MICROSECONDS}},
             {"dynamic_reconfigure_us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MICROSECONDS}},
             {"dynamic_reconfigure_ms", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MILLISECONDS}},
             {"dynamic_reconfigure_s", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::SECONDS}}},
            kind);
  value.kind = kind.first;
  value.unit = kind.second;
}

using Reader = std::function<void(const std::string& key, const YAML::Node& node, Config& config)>;

/// Reads a value into the member that `member` picks out of a Config.
template <typename Member>
Reader into(Member member) {
  return [member](const std::string& key, const YAML::Node& node, Config& c) { read(key, node, member(c)); };
}

template <typename Member>
Reader seconds_into(Member member) {
  return [member](const std::string& key, const YAML::Node& node, Config& c) { member(c) = read_seconds(key, node); };
}

const std::map<std::string, Reader>& readers() {
  static const std::map<std::string, Reader> kReaders{
      {"exposure_time", seconds_into([](Config& c) -> TimeNs& { return c.shutter.exposure_ns; })},
      {"exposure_source", into([](Config & c) -> auto& { return c.exposure_source; })},
      {"exposure_field", into([](Config & c) -> auto& { return c.exposure_source.field; })},
      {"exposure_max_age", seconds_into([](Config& c) -> TimeNs& { return c.exposure_max_age_ns; })},
      {"readout_time", seconds_into([](Config& c) -> TimeNs& { return c.shutter.readout_ns; })},
      {"stamp_row", into([](Config & c) -> auto& { return c.shutter.stamp_row; })},
      {"stamp_phase", into([](Config & c) -> auto& { return c.shutter.stamp_phase; })},
      {"time_offset", seconds_into([](Config& c) -> TimeNs& { return c.gyro.time_offset_ns; })},
      {"rectified_input", into([](Config & c) -> auto& { return c.rectified_input; })},
      {"R_cam_imu", into([](Config & c) -> auto& { return c.R_cam_imu; })},
      {"on_calibration_conflict", into([](Config & c) -> auto& { return c.on_calibration_conflict; })},
      {"gyro_bias", into([](Config & c) -> auto& { return c.gyro.bias_rad_s; })},
      {"gyro_buffer_duration", seconds_into([](Config& c) -> TimeNs& { return c.gyro.buffer_ns; })},
      {"max_gyro_gap", seconds_into([](Config& c) -> TimeNs& { return c.gyro.max_gap_ns; })},
      {"gyro_range", into([](Config & c) -> auto& { return c.gyro.range_rad_s; })},
      {"gyro_timeout", seconds_into([](Config& c) -> TimeNs& { return c.gyro_timeout_ns; })},
      {"frame_queue_size", into([](Config & c) -> auto& { return c.frame_queue_size; })},
      {"bias_window", seconds_into([](Config& c) -> TimeNs& { return c.bias_window_ns; })},
      {"bias_max_stddev", into([](Config & c) -> auto& { return c.bias_max_stddev_rad_s; })},
      {"time_jump_threshold", seconds_into([](Config& c) -> TimeNs& { return c.time_jump_ns; })},
      {"p_cam_imu", into([](Config & c) -> auto& { return c.p_cam_imu_m; })},
      {"scene_depth", into([](Config & c) -> auto& { return c.translation.scene_depth_m; })},
      {"scene_depth_max_age", seconds_into([](Config& c) -> TimeNs& { return c.translation.depth_max_age_ns; })},
      {"odometry_max_age", seconds_into([](Config& c) -> TimeNs& { return c.translation.max_age_ns; })},
      {"odometry_max_speed", into([](Config & c) -> auto& { return c.translation.max_speed_m_s; })},
      {"odometry_max_acceleration", into([](Config & c) -> auto& { return c.translation.max_acceleration_m_s2; })},
      {"odometry_max_stddev", into([](Config & c) -> auto& { return c.translation.max_stddev_m_s; })},
      {"odometry_clock", into([](Config & c) -> auto& { return c.odometry_clock; })},
      {"odometry_twist_frame", into([](Config & c) -> auto& { return c.odometry_twist_frame; })},
      {"max_tracks", into([](Config & c) -> auto& { return c.tracker.max_tracks; })},
      {"track_min_distance", into([](Config & c) -> auto& { return c.tracker.min_distance_px; })},
      {"track_border", into([](Config & c) -> auto& { return c.tracker.border_px; })},
      {"track_max_round_trip", into([](Config & c) -> auto& { return c.tracker.max_round_trip_px; })},
      {"track_max_epipolar", into([](Config & c) -> auto& { return c.tracker.max_epipolar_px; })},
      {"track_window", into([](Config & c) -> auto& { return c.tracker.window_px; })},
      {"track_levels", into([](Config & c) -> auto& { return c.tracker.levels; })},
      {"rectify_to", into([](Config & c) -> auto& { return c.pipeline.rectify_to; })},
      {"engine", into([](Config & c) -> auto& { return c.pipeline.engine; })},
      {"threads", into([](Config & c) -> auto& { return c.pipeline.threads; })},
      {"block_size", into([](Config & c) -> auto& { return c.pipeline.blur_field.block_size_px; })},
      {"min_extent", into([](Config & c) -> auto& { return c.pipeline.blur_field.min_extent_px; })},
      {"max_extent", into([](Config & c) -> auto& { return c.pipeline.blur_field.max_extent_px; })},
      {"max_bend", into([](Config & c) -> auto& { return c.pipeline.blur_field.max_bend_px; })},
      {"gamma", into([](Config & c) -> auto& { return c.pipeline.kernel.gamma; })},
      {"kernel_length_factor", into([](Config & c) -> auto& { return c.pipeline.kernel.length_factor; })},
      {"kernel_smoothing", into([](Config & c) -> auto& { return c.pipeline.kernel.smoothing_px; })},
      {"validate", into([](Config & c) -> auto& { return c.pipeline.validation.enabled; })},
      {"tau", into([](Config & c) -> auto& { return c.pipeline.validation.tau; })},
      {"tau_contrast", into([](Config & c) -> auto& { return c.pipeline.validation.tau_contrast; })},
      {"detector", into([](Config & c) -> auto& { return c.pipeline.keypoints.detector; })},
      {"descriptor", into([](Config & c) -> auto& { return c.pipeline.keypoints.descriptor; })},
      {"max_features", into([](Config & c) -> auto& { return c.pipeline.keypoints.max_features; })},
      {"grid_cols", into([](Config & c) -> auto& { return c.pipeline.keypoints.grid_cols; })},
      {"grid_rows", into([](Config & c) -> auto& { return c.pipeline.keypoints.grid_rows; })},
  };
  return kReaders;
}

// Keys that parse_config takes together, after the others.
constexpr char kFileKey[] = "calibration_file";
constexpr char kCameraKey[] = "calibration_camera";

/// One path, a list of paths, or nothing.
std::vector<std::string> read_paths(const YAML::Node& node) {
  std::vector<std::string> paths;
  if (node.IsScalar()) {
    if (!node.Scalar().empty()) paths.push_back(node.Scalar());
    return paths;
  }
  if (!node.IsSequence()) refuse(kFileKey, node, "a path or a list of paths");
  for (const YAML::Node& path : node) {
    if (!path.IsScalar()) refuse(kFileKey, node, "a path or a list of paths");
    paths.push_back(path.Scalar());
  }
  return paths;
}

/// Puts what a calibration file says into the configuration, where no key has said the same already. Keys hold against
/// the file with on_calibration_conflict: configured, and must not contradict it otherwise.
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
  if (calibration.R_cam_imu && calibration.p_imu_cam_m && !(key_holds && !config.p_cam_imu_m.isZero())) {
    const Eigen::Vector3d p_cam_imu_m = -(*calibration.R_cam_imu * *calibration.p_imu_cam_m);
    constexpr double kAllowedM = 1e-3;
    if (!config.p_cam_imu_m.isZero() && (config.p_cam_imu_m - p_cam_imu_m).norm() > kAllowedM) {
      std::ostringstream text;
      text << "p_cam_imu is [" << config.p_cam_imu_m.transpose() << "] m in " << key << ", but ["
           << p_cam_imu_m.transpose() << "] m in " << calibration.origin;
      throw OptionError(text.str());
    }
    config.p_cam_imu_m = p_cam_imu_m;
  }
  const auto apply_time = [&](const char* name, const std::optional<TimeNs>& value_ns, TimeNs& target_ns) {
    if (!value_ns || (key_holds && target_ns != 0)) return;
    if (target_ns != 0) require_agreement(name, target_ns, key, *value_ns, calibration.origin);
    target_ns = *value_ns;
  };
  apply_time("time_offset", calibration.time_offset_ns, config.gyro.time_offset_ns);
  apply_time("readout_time", calibration.readout_ns, config.shutter.readout_ns);
  if (calibration.frame_period_ns) {
    require_plausible_readout("readout_time", config.shutter.readout_ns, *calibration.frame_period_ns);
  }
}

}  // namespace

void Config::validate() const {
  require_range("exposure_max_age", to_seconds(exposure_max_age_ns), 0, 60, "s");
  using Kind = ExposureSource::Kind;
  if ((exposure_source.kind == Kind::FIELD || exposure_source.kind == Kind::DYNAMIC_RECONFIGURE) &&
      exposure_source.field.empty()) {
    throw OptionError("exposure_field = \"\" is not the name of a field: this exposure_source needs one");
  }
  pipeline.validate();
  gyro.validate();
  ShutterTiming timing = shutter;
  if (timing.exposure_ns == 0) timing.exposure_ns = 1;  // each frame brings its own; check the rest
  timing.validate();
  if (R_cam_imu) require_rotation("R_cam_imu", *R_cam_imu);
  for (int axis = 0; axis < 3; ++axis) require_range("p_cam_imu", p_cam_imu_m[axis], -100, 100, "m");
  translation.validate();
  tracker.validate();
  require_range("gyro_timeout", to_seconds(gyro_timeout_ns), 0, 10, "s");
  require_range("frame_queue_size", frame_queue_size, 1, 1000);
  require_range("bias_window", to_seconds(bias_window_ns), 0.1, 10, "s");
  require_range("bias_max_stddev", bias_max_stddev_rad_s, std::numeric_limits<double>::min(), 1, "rad/s");
  require_range("time_jump_threshold", to_seconds(time_jump_ns), 0.01, 10, "s");
}

Config parse_config(const YAML::Node& node, std::vector<std::string>* unknown, const std::string& folder) {
  Config config;
  std::vector<std::string> calibration_files;
  std::string calibration_camera = "cam0";
  if (!node.IsNull()) {
    if (!node.IsMap()) throw OptionError("the configuration is not a map of keys: " + describe(node));
    std::set<std::string> seen;
    for (const auto& entry : node) {
      if (!entry.first.IsScalar()) throw OptionError("configuration key " + describe(entry.first) + " is not a string");
      const std::string& key = entry.first.Scalar();
      if (!seen.insert(key).second) throw OptionError(key + " = " + describe(entry.second) + " is given a second time");
      const auto reader = readers().find(key);
      if (reader != readers().end()) {
        reader->second(key, entry.second, config);
      } else if (key == kFileKey) {
        calibration_files = read_paths(entry.second);
      } else if (key == kCameraKey) {
        read(key, entry.second, calibration_camera);
      } else if (unknown != nullptr) {
        unknown->push_back(key);
      }
    }
  }
  if (!calibration_files.empty()) {
    std::vector<SensorCalibration> sources;
    for (const std::string& file : calibration_files) {
      // An absolute path replaces the folder.
      sources.push_back(load_calibration((std::filesystem::path(folder) / file).string(), calibration_camera));
    }
    config.calibration = merge_calibrations(sources);
    apply_calibration(*config.calibration, config);
  }
  config.validate();
  return config;
}

Config load_config(const std::string& path, std::vector<std::string>* unknown) {
  YAML::Node node;
  try {
    node = YAML::LoadFile(path);
  } catch (const YAML::Exception& error) {
    throw OptionError("configuration " + path + " cannot be read: " + error.what());
  }
  try {
    return parse_config(node, unknown, std::filesystem::path(path).parent_path().string());
  } catch (const OptionError& error) {
    throw OptionError("configuration " + path + ": " + error.what());
  }
}

}  // namespace gyro_deblur
