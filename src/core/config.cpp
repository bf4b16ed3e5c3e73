#include "gyro_deblur/config.hpp"

#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <set>

#include <yaml-cpp/yaml.h>

#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

/// A quoted scalar has the tag "!": it is a string, even where its text is a number.
bool is_quoted(const YAML::Node& node) { return node.IsScalar() && node.Tag() == "!"; }

/// The value on one line, shortened for messages.
std::string describe(const YAML::Node& node) {
  if (is_quoted(node)) return '"' + node.Scalar() + '"';
  YAML::Emitter emitter;
  emitter.SetSeqFormat(YAML::Flow);
  emitter.SetMapFormat(YAML::Flow);
  emitter << node;
  std::string text = emitter.good() ? emitter.c_str() : "?";
  constexpr std::size_t kLongest = 80;
  if (text.size() > kLongest) text = text.substr(0, kLongest) + "...";
  return text;
}

[[noreturn]] void refuse(const std::string& key, const YAML::Node& node, const std::string& allowed) {
  throw OptionError(key + " = " + describe(node) + " is not " + allowed);
}

template <typename T>
T read_scalar(const std::string& key, const YAML::Node& node, const std::string& allowed) {
  T value;
  if (!node.IsScalar() || is_quoted(node) || !YAML::convert<T>::decode(node, value)) refuse(key, node, allowed);
  return value;
}

double read_number(const std::string& key, const YAML::Node& node, const std::string& allowed) {
  const double value = read_scalar<double>(key, node, allowed);
  if (!std::isfinite(value)) refuse(key, node, allowed);
  return value;
}

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

void read_seconds(const std::string& key, const YAML::Node& node, TimeNs& value_ns) {
  // No duration here is longer than a minute; the bound only keeps the conversion from overflowing.
  constexpr double kLongestS = 1e6;
  const double seconds = read_number(key, node, "a finite number of seconds");
  require_range(key.c_str(), seconds, -kLongestS, kLongestS, "s");
  value_ns = to_ns(seconds);
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

using Reader = std::function<void(const std::string& key, const YAML::Node& node, Config& config)>;

/// Reads a value into the member that `member` picks out of a Config.
template <typename Member>
Reader into(Member member) {
  return [member](const std::string& key, const YAML::Node& node, Config& c) { read(key, node, member(c)); };
}

template <typename Member>
Reader seconds_into(Member member) {
  return [member](const std::string& key, const YAML::Node& node, Config& c) { read_seconds(key, node, member(c)); };
}

const std::map<std::string, Reader>& readers() {
  static const std::map<std::string, Reader> kReaders{
      {"exposure_time", seconds_into([](Config& c) -> TimeNs& { return c.shutter.exposure_ns; })},
      {"readout_time", seconds_into([](Config& c) -> TimeNs& { return c.shutter.readout_ns; })},
      {"stamp_row", into([](Config & c) -> auto& { return c.shutter.stamp_row; })},
      {"stamp_phase", into([](Config & c) -> auto& { return c.shutter.stamp_phase; })},
      {"time_offset", seconds_into([](Config& c) -> TimeNs& { return c.gyro.time_offset_ns; })},
      {"rectified_input", into([](Config & c) -> auto& { return c.rectified_input; })},
      {"R_cam_imu", into([](Config & c) -> auto& { return c.R_cam_imu; })},
      {"gyro_bias", into([](Config & c) -> auto& { return c.gyro.bias_rad_s; })},
      {"gyro_buffer_duration", seconds_into([](Config& c) -> TimeNs& { return c.gyro.buffer_ns; })},
      {"max_gyro_gap", seconds_into([](Config& c) -> TimeNs& { return c.gyro.max_gap_ns; })},
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
      {"track_max_round_trip", into([](Config & c) -> auto& { return c.tracker.max_round_trip_px; })},
      {"track_max_epipolar", into([](Config & c) -> auto& { return c.tracker.max_epipolar_px; })},
      {"track_window", into([](Config & c) -> auto& { return c.tracker.window_px; })},
      {"track_levels", into([](Config & c) -> auto& { return c.tracker.levels; })},
      {"rectify_to", into([](Config & c) -> auto& { return c.pipeline.rectify_to; })},
      {"backend", into([](Config & c) -> auto& { return c.pipeline.backend; })},
      {"threads", into([](Config & c) -> auto& { return c.pipeline.threads; })},
      {"block_size", into([](Config & c) -> auto& { return c.pipeline.blur_field.block_size_px; })},
      {"min_extent", into([](Config & c) -> auto& { return c.pipeline.blur_field.min_extent_px; })},
      {"max_extent", into([](Config & c) -> auto& { return c.pipeline.blur_field.max_extent_px; })},
      {"gamma", into([](Config & c) -> auto& { return c.pipeline.kernel.gamma; })},
      {"kernel_length_factor", into([](Config & c) -> auto& { return c.pipeline.kernel.length_factor; })},
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

}  // namespace

void Config::validate() const {
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

Config parse_config(const YAML::Node& node, std::vector<std::string>* unknown) {
  Config config;
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
      } else if (unknown != nullptr) {
        unknown->push_back(key);
      }
    }
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
    return parse_config(node, unknown);
  } catch (const OptionError& error) {
    throw OptionError("configuration " + path + ": " + error.what());
  }
}

}  // namespace gyro_deblur
