// Reads a scene from YAML.
#include "sim/scene.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>
#include <utility>

#include <yaml-cpp/yaml.h>

#include "base/join.hpp"
#include "base/require_range.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/lens_models.hpp"
#include "sim/texture.hpp"

namespace gyro_deblur::sim {
namespace {

constexpr double kRadPerDeg = M_PI / 180;
constexpr double kMaxAngleDeg = 36000;  // revolutions are allowed, typing errors are not
constexpr double kMaxLengthM = 1e4;
constexpr double kMaxTimeS = 1e5;

// A map of the scene file whose keys are read by name and must all be known.
class Section {
 public:
  Section(const YAML::Node& node, std::string path, std::string file)
      : node_(node), path_(std::move(path)), file_(std::move(file)) {
    if (!node_.IsMap()) throw OptionError(at(node_) + (path_.empty() ? "scene" : path_) + " is not a map of keys");
  }

  /// The key is known from then on.
  bool has(const std::string& key) const {
    known_.insert(key);
    return static_cast<bool>(node_[key]);
  }

  /// "FILE:LINE: PATH.KEY"
  std::string name(const std::string& key) const {
    return at(has(key) ? node_[key] : node_) + (path_.empty() ? key : path_ + "." + key);
  }

  YAML::Node required(const std::string& key, const std::string& expected) {
    if (!has(key)) throw OptionError(name(key) + " is missing; expected " + expected);
    return node_[key];
  }

  double number(const std::string& key, double min, double max, const char* unit = "") {
    return checked(required(key, "a number"), name(key), min, max, unit);
  }
  double number_or(const std::string& key, double otherwise, double min, double max, const char* unit = "") {
    return has(key) ? number(key, min, max, unit) : otherwise;
  }
  std::uint64_t integer_or(const std::string& key, std::uint64_t otherwise, double min, double max) {
    const double value = number_or(key, static_cast<double>(otherwise), min, max);
    if (value != std::floor(value)) throw OptionError(name(key) + " = " + std::to_string(value) + " is not an integer");
    return static_cast<std::uint64_t>(value);
  }

  std::string text(const std::string& key) {
    const YAML::Node node = required(key, "a text");
    if (!node.IsScalar()) throw OptionError(name(key) + " is not a string");
    return node.Scalar();
  }
  std::string text_or(const std::string& key, const std::string& otherwise) { return has(key) ? text(key) : otherwise; }
  std::string choice(const std::string& key, const std::vector<std::string>& allowed, const char* otherwise) {
    std::string value = otherwise == nullptr ? text(key) : text_or(key, otherwise);
    if (std::find(allowed.begin(), allowed.end(), value) == allowed.end()) {
      throw OptionError(name(key) + " = '" + value + "' is not one of " + join(allowed));
    }
    return value;
  }

  std::vector<double> numbers(const std::string& key, std::size_t min_count, std::size_t max_count, double min,
                              double max, const char* unit = "") {
    const std::string count = min_count == max_count ? std::to_string(min_count)
                                                     : std::to_string(min_count) + " to " + std::to_string(max_count);
    const YAML::Node node = required(key, "a list of " + count + " numbers");
    if (!node.IsSequence() || node.size() < min_count || node.size() > max_count) {
      throw OptionError(name(key) + " is not a list of " + count + " numbers");
    }
    std::vector<double> values;
    for (std::size_t i = 0; i < node.size(); ++i) {
      values.push_back(checked(node[i], name(key) + "[" + std::to_string(i) + "]", min, max, unit));
    }
    return values;
  }
  Eigen::Vector3d vector(const std::string& key, double limit, const char* unit = "") {
    const std::vector<double> v = numbers(key, 3, 3, -limit, limit, unit);
    return {v[0], v[1], v[2]};
  }
  Eigen::Vector3d vector_or(const std::string& key, const Eigen::Vector3d& otherwise, double limit,
                            const char* unit = "") {
    return has(key) ? vector(key, limit, unit) : otherwise;
  }

  Section section(const std::string& key) {
    const YAML::Node node = required(key, "a map of keys");
    return Section(node, path_.empty() ? key : path_ + "." + key, file_);
  }
  std::vector<Section> sections_or_none(const std::string& key) {
    std::vector<Section> list;
    if (!has(key)) return list;
    if (!node_[key].IsSequence()) throw OptionError(name(key) + " is not a list");
    for (std::size_t i = 0; i < node_[key].size(); ++i) {
      list.emplace_back(node_[key][i], (path_.empty() ? key : path_ + "." + key) + "[" + std::to_string(i) + "]",
                        file_);
    }
    return list;
  }

  /// Throws when the map has a key that nobody asked for.
  void finish() const {
    for (const auto& entry : node_) {
      const std::string key = entry.first.Scalar();
      if (known_.count(key) != 0) continue;
      throw OptionError(at(entry.first) + (path_.empty() ? key : path_ + "." + key) +
                        " is not a known key; known here: " + join(known_));
    }
  }

 private:
  std::string at(const YAML::Node& node) const {
    const YAML::Mark mark = node.Mark();
    return file_ + (mark.line >= 0 ? ":" + std::to_string(mark.line + 1) : "") + ": ";
  }

  static double checked(const YAML::Node& node, const std::string& name, double min, double max, const char* unit) {
    double value = 0;
    if (!node.IsScalar() || !YAML::convert<double>::decode(node, value)) {
      throw OptionError(name + (node.IsScalar() ? " = '" + node.Scalar() + "'" : "") + " is not a number");
    }
    require_range(name.c_str(), value, min, max, unit);
    return value;
  }

  YAML::Node node_;
  std::string path_, file_;
  mutable std::set<std::string> known_;  // keys that somebody asked for
};

/// An absolute path replaces the directory.
std::string resolve(const std::string& directory, const std::string& file) {
  return (std::filesystem::path(directory) / file).string();
}

CameraModel parse_camera(Section s) {
  CameraModel camera;
  CameraCalibration& c = camera.calibration;
  const std::vector<double> size = s.numbers("size", 2, 2, 1, 16384, "px");
  c.width_px = static_cast<int>(size[0]);
  c.height_px = static_cast<int>(size[1]);
  const std::vector<double> k = s.numbers("intrinsics", 4, 4, -1e5, 1e5, "px");
  c.fx_px = k[0];
  c.fy_px = k[1];
  c.cx_px = k[2];
  c.cy_px = k[3];
  c.model = s.choice("distortion_model", lens_model_names(), "none");
  if (s.has("distortion_coefficients")) c.coefficients = s.numbers("distortion_coefficients", 0, 8, -1e3, 1e3);
  camera.fps = s.number("fps", 0.1, 1000, "Hz");
  constexpr double kMinExposureS = 1e-6;
  if (s.has("exposure_time") && s.required("exposure_time", "").IsSequence()) {
    for (const double e : s.numbers("exposure_time", 1, 1000, kMinExposureS, 1, "s")) {
      camera.exposures_ns.push_back(to_ns(e));
    }
  } else {
    camera.exposures_ns = {to_ns(s.number("exposure_time", kMinExposureS, 1, "s"))};
  }
  camera.readout_ns = to_ns(s.number_or("readout_time", 0, -1, 1, "s"));
  const std::string row = s.choice("stamp_row", {"first", "middle", "last"}, "first");
  camera.stamp_row = row == "first" ? StampRow::FIRST : row == "middle" ? StampRow::MIDDLE : StampRow::LAST;
  const std::string phase = s.choice("stamp_phase", {"start", "middle", "end"}, "start");
  camera.stamp_phase = phase == "start" ? StampPhase::START : phase == "middle" ? StampPhase::MIDDLE : StampPhase::END;
  camera.encoding = s.choice(
      "encoding", {"mono8", "mono16", "bgr8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"},
      "mono8");
  camera.noise = s.number_or("noise", 0, 0, 64, "grey levels");
  s.finish();
  return camera;
}

ImuModel parse_imu(Section s) {
  ImuModel imu;
  imu.rate_hz = s.number_or("rate", imu.rate_hz, 1, 1e4, "Hz");
  imu.gyro_bias_rad_s = s.vector_or("gyro_bias", imu.gyro_bias_rad_s, 10, "rad/s");
  imu.gyro_noise_rad_s = s.number_or("gyro_noise", 0, 0, 10, "rad/s");
  imu.gyro_saturation_rad_s = s.number_or("gyro_saturation", 0, 0, 1000, "rad/s");
  imu.accel_bias_m_s2 = s.vector_or("accel_bias", imu.accel_bias_m_s2, 100, "m/s^2");
  imu.accel_noise_m_s2 = s.number_or("accel_noise", 0, 0, 100, "m/s^2");
  imu.time_offset_ns = to_ns(s.number_or("time_offset", 0, -10, 10, "s"));
  if (s.has("R_cam_imu")) {
    const std::vector<double> r = s.numbers("R_cam_imu", 9, 9, -1.001, 1.001);
    const Eigen::Matrix3d R = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r.data());
    imu.R_cam_imu = require_rotation(s.name("R_cam_imu").c_str(), R);
  }
  s.finish();
  return imu;
}

Eigen::Quaterniond rotation_or_identity(Section& s, const std::string& key) {
  const Eigen::Vector3d v = s.vector_or(key, Eigen::Vector3d::Zero(), kMaxAngleDeg, "deg") * kRadPerDeg;
  const double angle = v.norm();
  return angle == 0 ? Eigen::Quaterniond::Identity() : Eigen::Quaterniond(Eigen::AngleAxisd(angle, v / angle));
}

Plane parse_plane(Section s, const std::string& directory) {
  constexpr double kMinSizeM = 1e-3;
  Plane plane;
  const std::vector<double> size = s.numbers("size", 2, 2, kMinSizeM, kMaxLengthM, "m");
  plane.width_m = size[0];
  plane.height_m = size[1];
  plane.center_m = s.vector("position", kMaxLengthM, "m");
  plane.R_world_plane = rotation_or_identity(s, "rotation");
  const std::string texture = s.text_or("texture", "procedural");
  if (texture == "procedural") {
    std::vector<double> pixels = {2048, 0};
    pixels[1] = std::clamp(std::round(pixels[0] * plane.height_m / plane.width_m), 64.0, 8192.0);
    if (s.has("texture_size")) pixels = s.numbers("texture_size", 2, 2, 64, 8192, "px");
    const std::uint64_t seed = s.integer_or("texture_seed", 1, 0, 1e9);
    plane.texture = procedural_texture(static_cast<int>(pixels[0]), static_cast<int>(pixels[1]), seed);
  } else {
    try {
      plane.texture = load_texture(resolve(directory, texture));
    } catch (const OptionError& e) {
      throw OptionError(s.name("texture") + ": " + e.what());
    }
  }
  s.finish();
  return plane;
}

/// All 0 without the key.
/// @param factor  from the file's unit to radians or metres
VectorCurve parse_curve(Section& parent, const std::string& key, double limit, double factor, const char* unit) {
  VectorCurve curve;
  if (!parent.has(key)) return curve;
  Section s = parent.section(key);
  curve.offset = factor * s.vector_or("offset", Eigen::Vector3d::Zero(), limit, unit);
  curve.rate = factor * s.vector_or("rate", Eigen::Vector3d::Zero(), limit, (std::string(unit) + "/s").c_str());
  for (Section& item : s.sections_or_none("sines")) {
    Sine sine;
    sine.amplitude = factor * item.vector("amplitude", limit, unit);
    sine.frequency_hz = item.number("frequency", 0, 1000, "Hz");
    sine.phase_rad = kRadPerDeg * item.number_or("phase", 0, -kMaxAngleDeg, kMaxAngleDeg, "deg");
    if (item.has("window")) {
      const std::vector<double> w = item.numbers("window", 2, 2, -kMaxTimeS, kMaxTimeS, "s");
      if (!(w[1] > w[0])) throw OptionError(item.name("window") + " must end after it begins");
      sine.window = Span{w[0], w[1]};
    }
    item.finish();
    curve.sines.push_back(sine);
  }
  s.finish();
  return curve;
}

std::unique_ptr<Motion> parse_motion(Section s, const std::string& directory, const Eigen::Matrix3d& R_cam_imu) {
  const std::string type = s.choice("type", {"spline", "constant_rate", "gyro_trace", "trajectory", "orbit"}, nullptr);
  const auto position = [&s] { return parse_curve(s, "position", kMaxLengthM, 1, "m"); };
  std::unique_ptr<Motion> motion;
  if (type == "spline") {
    motion = make_curve_motion(parse_curve(s, "rotation", kMaxAngleDeg, kRadPerDeg, "deg"), position());
  } else if (type == "constant_rate") {
    const Eigen::Vector3d rate = kRadPerDeg * s.vector("rate", kMaxAngleDeg, "deg/s");
    motion = make_constant_rate_motion(rotation_or_identity(s, "orientation"), rate, position());
  } else if (type == "gyro_trace") {
    const std::vector<TraceSample> samples = load_gyro_trace(resolve(directory, s.text("file")));
    const double start = s.number_or("start", 0, 0, samples.back().t_s, "s");
    const double scale = s.number_or("scale", 1, -1000, 1000);
    motion =
        make_gyro_trace_motion(samples, start, scale, R_cam_imu, rotation_or_identity(s, "orientation"), position());
  } else if (type == "trajectory") {
    const std::vector<TrajectorySample> samples = load_trajectory(resolve(directory, s.text("file")));
    const double start = s.number_or("start", 0, 0, samples.back().t_s, "s");
    motion = make_trajectory_motion(samples, start);
  } else {
    Orbit orbit;
    orbit.center_m = s.vector_or("center", orbit.center_m, kMaxLengthM, "m");
    orbit.radius_m = s.number("radius", 1e-3, kMaxLengthM, "m");
    const Eigen::Vector3d axis = s.vector_or("axis", orbit.axis, kMaxLengthM);
    if (axis.norm() < 1e-6) throw OptionError(s.name("axis") + " has length 0");
    orbit.axis = axis.normalized();
    orbit.rate_rad_s = kRadPerDeg * s.number_or("rate", 0, -kMaxAngleDeg, kMaxAngleDeg, "deg/s");
    orbit.amplitude_rad = kRadPerDeg * s.number_or("amplitude", 0, -kMaxAngleDeg, kMaxAngleDeg, "deg");
    orbit.frequency_hz = s.number_or("frequency", 0, 0, 1000, "Hz");
    motion = make_orbit_motion(orbit);
  }
  s.finish();
  return motion;
}

}  // namespace

ShutterTiming Scene::timing(int frame) const {
  ShutterTiming timing;
  timing.exposure_ns = camera.exposures_ns[static_cast<std::size_t>(frame) % camera.exposures_ns.size()];
  timing.readout_ns = camera.readout_ns;
  timing.stamp_row = camera.stamp_row;
  timing.stamp_phase = camera.stamp_phase;
  return timing;
}

TimeNs Scene::first_row_start(int frame) const {
  const TimeNs bottom_up = std::max<TimeNs>(0, -camera.readout_ns);  // then row 0 starts last
  return start_ns + lead_ns + bottom_up + to_ns(frame / camera.fps);
}

TimeNs Scene::end_ns() const {
  const TimeNs longest = *std::max_element(camera.exposures_ns.begin(), camera.exposures_ns.end());
  return first_row_start(frames - 1) + std::max<TimeNs>(0, camera.readout_ns) + longest + lead_ns;
}

void Scene::validate() const {
  camera.calibration.validate();
  require_range("camera.fps", camera.fps, 0.1, 1000, "Hz");
  if (camera.exposures_ns.empty())
    throw OptionError("camera.exposure_time is missing; give seconds, or a list of them");
  for (int i = 0; i < static_cast<int>(camera.exposures_ns.size()); ++i) timing(i).validate();
  require_range("camera.noise", camera.noise, 0, 64, "grey levels");
  if (!layout_of_encoding(camera.encoding))
    throw OptionError("camera.encoding = '" + camera.encoding +
                      "' is not one of mono8, mono16, bgr8, rgb8, bayer_rggb8, bayer_bggr8, bayer_gbrg8, bayer_grbg8");
  require_range("imu.rate", imu.rate_hz, 1, 1e4, "Hz");
  require_rotation("imu.R_cam_imu", imu.R_cam_imu);
  for (const Plane& plane : planes) {
    require_range("plane width", plane.width_m, 1e-3, kMaxLengthM, "m");
    require_range("plane height", plane.height_m, 1e-3, kMaxLengthM, "m");
  }
  require_range("background", background, 0, 255, "grey levels");
  require_range("frames", frames, 1, 1e6);
  require_range("lead_time", to_seconds(lead_ns), 0, 60, "s");
  if (!motion) throw OptionError("motion is missing; config/scenes/handheld.yaml documents it");
  const Span span = motion->span();
  const double duration = to_seconds(end_ns() - start_ns);
  if (span.begin_s > 0 || span.end_s < duration) {
    throw OptionError("motion covers " + std::to_string(span.begin_s) + " to " + std::to_string(span.end_s) +
                      " s of scene time, but the scene lasts from 0 to " + std::to_string(duration) + " s");
  }
}

Scene parse_scene(const YAML::Node& node, const std::string& directory, const std::string& name) {
  Section s(node, "", name);
  Scene scene;
  scene.frames = static_cast<int>(s.integer_or("frames", 1, 1, 1e6));
  scene.seed = s.integer_or("seed", scene.seed, 0, 1e9);
  scene.start_ns = to_ns(s.number_or("start_time", to_seconds(scene.start_ns), 1, 4e9, "s"));
  scene.lead_ns = to_ns(s.number_or("lead_time", to_seconds(scene.lead_ns), 0, 60, "s"));
  scene.gravity_m_s2 = s.vector_or("gravity", scene.gravity_m_s2, 100, "m/s^2");
  scene.background = s.number_or("background", scene.background, 0, 255, "grey levels");
  scene.camera = parse_camera(s.section("camera"));
  if (s.has("imu")) scene.imu = parse_imu(s.section("imu"));
  for (const Section& plane : s.sections_or_none("planes")) scene.planes.push_back(parse_plane(plane, directory));
  scene.motion = parse_motion(s.section("motion"), directory, scene.imu.R_cam_imu);
  s.finish();
  try {
    scene.validate();
  } catch (const OptionError& e) {
    throw OptionError(name + ": " + e.what());
  }
  return scene;
}

Scene load_scene(const std::string& path) {
  YAML::Node node;
  try {
    node = YAML::LoadFile(path);
  } catch (const YAML::BadFile&) {
    throw OptionError(path + ": cannot be read");
  } catch (const YAML::Exception& e) {
    throw OptionError(path + ": " + e.what());
  }
  return parse_scene(node, std::filesystem::path(path).parent_path().string(), path);
}

}  // namespace gyro_deblur::sim
