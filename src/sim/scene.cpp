// Reads a scene from YAML.
#include "sim/scene.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <yaml-cpp/yaml.h>

#include "base/join.hpp"
#include "base/require_range.hpp"
#include "config/yaml_reading.hpp"
#include "config/yaml_section.hpp"
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

double number(const Section& s, const std::string& key, double min, double max, const char* unit = "") {
  const double value = s.number(key);
  require_range(s.name(key).c_str(), value, min, max, unit);
  return value;
}

double number_or(const Section& s, const std::string& key, double otherwise, double min, double max,
                 const char* unit = "") {
  return s.has(key) ? number(s, key, min, max, unit) : otherwise;
}

std::uint64_t integer_or(const Section& s, const std::string& key, std::uint64_t otherwise, double min, double max) {
  const double value = number_or(s, key, static_cast<double>(otherwise), min, max);
  if (value != std::floor(value)) refuse(s.name(key), s.get(key), "an integer");
  return static_cast<std::uint64_t>(value);
}

/// @param otherwise  null: the key has to be there
std::string choice(const Section& s, const std::string& key, const std::vector<std::string>& allowed,
                   const char* otherwise) {
  const std::string value = otherwise == nullptr || s.has(key) ? s.text(key) : otherwise;
  if (std::find(allowed.begin(), allowed.end(), value) == allowed.end()) {
    refuse(s.name(key), s.get(key), "one of " + join(allowed));
  }
  return value;
}

std::vector<double> numbers(const Section& s, const std::string& key, std::size_t min_count, std::size_t max_count,
                            double min, double max, const char* unit = "") {
  const std::vector<double> values = s.numbers(key);
  if (values.size() < min_count || values.size() > max_count) {
    const std::string least = min_count == max_count ? "" : std::to_string(min_count) + " to ";
    refuse(s.name(key), s.get(key), "a list of " + least + std::to_string(max_count) + " numbers");
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    require_range((s.name(key) + "[" + std::to_string(i) + "]").c_str(), values[i], min, max, unit);
  }
  return values;
}

Eigen::Vector3d vector(const Section& s, const std::string& key, double limit, const char* unit = "") {
  return Eigen::Vector3d(numbers(s, key, 3, 3, -limit, limit, unit).data());
}

Eigen::Vector3d vector_or(const Section& s, const std::string& key, const Eigen::Vector3d& otherwise, double limit,
                          const char* unit = "") {
  return s.has(key) ? vector(s, key, limit, unit) : otherwise;
}

/// The maps of a list; none without the key.
std::vector<Section> elements_or_none(const Section& s, const std::string& key) {
  std::vector<Section> list;
  if (!s.has(key)) return list;
  if (!s.get(key).IsSequence()) refuse(s.name(key), s.get(key), "a list");
  for (std::size_t i = 0; i < s.get(key).size(); ++i) list.push_back(s.element(key, i));
  return list;
}

/// An absolute path replaces the directory.
std::string resolve(const std::string& directory, const std::string& file) {
  return (std::filesystem::path(directory) / file).string();
}

CameraModel parse_camera(const Section& s) {
  CameraModel camera;
  CameraCalibration& c = camera.calibration;
  const std::vector<double> size = numbers(s, "size", 2, 2, 1, 16384, "px");
  c.width_px = static_cast<int>(size[0]);
  c.height_px = static_cast<int>(size[1]);
  const std::vector<double> k = numbers(s, "intrinsics", 4, 4, -1e5, 1e5, "px");
  c.fx_px = k[0];
  c.fy_px = k[1];
  c.cx_px = k[2];
  c.cy_px = k[3];
  c.model = choice(s, "distortion_model", lens_model_names(), "none");
  if (s.has("distortion_coefficients")) c.coefficients = numbers(s, "distortion_coefficients", 0, 8, -1e3, 1e3);
  camera.fps = number(s, "fps", 0.1, 1000, "Hz");
  constexpr double kMinExposureS = 1e-6;
  if (s.has("exposure_time") && s.get("exposure_time").IsSequence()) {
    for (const double e : numbers(s, "exposure_time", 1, 1000, kMinExposureS, 1, "s")) {
      camera.exposures_ns.push_back(to_ns(e));
    }
  } else {
    camera.exposures_ns = {to_ns(number(s, "exposure_time", kMinExposureS, 1, "s"))};
  }
  camera.readout_ns = to_ns(number_or(s, "readout_time", 0, -1, 1, "s"));
  const std::string row = choice(s, "stamp_row", {"first", "middle", "last"}, "first");
  camera.stamp_row = row == "first" ? StampRow::FIRST : row == "middle" ? StampRow::MIDDLE : StampRow::LAST;
  const std::string phase = choice(s, "stamp_phase", {"start", "middle", "end"}, "start");
  camera.stamp_phase = phase == "start" ? StampPhase::START : phase == "middle" ? StampPhase::MIDDLE : StampPhase::END;
  camera.encoding =
      choice(s, "encoding",
             {"mono8", "mono16", "bgr8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"}, "mono8");
  camera.noise = number_or(s, "noise", 0, 0, 64, "grey levels");
  return camera;
}

ImuModel parse_imu(const Section& s) {
  ImuModel imu;
  imu.rate_hz = number_or(s, "rate", imu.rate_hz, 1, 1e4, "Hz");
  imu.gyro_bias_rad_s = vector_or(s, "gyro_bias", imu.gyro_bias_rad_s, 10, "rad/s");
  imu.gyro_noise_rad_s = number_or(s, "gyro_noise", 0, 0, 10, "rad/s");
  imu.gyro_saturation_rad_s = number_or(s, "gyro_saturation", 0, 0, 1000, "rad/s");
  imu.accel_bias_m_s2 = vector_or(s, "accel_bias", imu.accel_bias_m_s2, 100, "m/s^2");
  imu.accel_noise_m_s2 = number_or(s, "accel_noise", 0, 0, 100, "m/s^2");
  imu.time_offset_ns = to_ns(number_or(s, "time_offset", 0, -10, 10, "s"));
  if (s.has("R_cam_imu")) {
    const std::vector<double> r = numbers(s, "R_cam_imu", 9, 9, -1.001, 1.001);
    const Eigen::Matrix3d R = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r.data());
    imu.R_cam_imu = require_rotation(s.name("R_cam_imu").c_str(), R);
  }
  return imu;
}

Eigen::Quaterniond rotation_or_identity(const Section& s, const std::string& key) {
  const Eigen::Vector3d v = vector_or(s, key, Eigen::Vector3d::Zero(), kMaxAngleDeg, "deg") * kRadPerDeg;
  const double angle = v.norm();
  return angle == 0 ? Eigen::Quaterniond::Identity() : Eigen::Quaterniond(Eigen::AngleAxisd(angle, v / angle));
}

Plane parse_plane(const Section& s, const std::string& directory) {
  constexpr double kMinSizeM = 1e-3;
  Plane plane;
  const std::vector<double> size = numbers(s, "size", 2, 2, kMinSizeM, kMaxLengthM, "m");
  plane.width_m = size[0];
  plane.height_m = size[1];
  plane.center_m = vector(s, "position", kMaxLengthM, "m");
  plane.R_world_plane = rotation_or_identity(s, "rotation");
  const std::string texture = s.has("texture") ? s.text("texture") : "procedural";
  if (texture == "procedural") {
    std::vector<double> pixels = {2048, 0};
    pixels[1] = std::clamp(std::round(pixels[0] * plane.height_m / plane.width_m), 64.0, 8192.0);
    if (s.has("texture_size")) pixels = numbers(s, "texture_size", 2, 2, 64, 8192, "px");
    const std::uint64_t seed = integer_or(s, "texture_seed", 1, 0, 1e9);
    plane.texture = procedural_texture(static_cast<int>(pixels[0]), static_cast<int>(pixels[1]), seed);
  } else {
    try {
      plane.texture = load_texture(resolve(directory, texture));
    } catch (const OptionError& e) {
      throw OptionError(s.name("texture") + ": " + e.what());
    }
  }
  return plane;
}

/// All 0 without the key.
/// @param factor  from the file's unit to radians or metres
VectorCurve parse_curve(const Section& parent, const std::string& key, double limit, double factor, const char* unit) {
  VectorCurve curve;
  if (!parent.has(key)) return curve;
  const Section s = parent.child(key);
  curve.offset = factor * vector_or(s, "offset", Eigen::Vector3d::Zero(), limit, unit);
  curve.rate = factor * vector_or(s, "rate", Eigen::Vector3d::Zero(), limit, (std::string(unit) + "/s").c_str());
  for (const Section& item : elements_or_none(s, "sines")) {
    Sine sine;
    sine.amplitude = factor * vector(item, "amplitude", limit, unit);
    sine.frequency_hz = number(item, "frequency", 0, 1000, "Hz");
    sine.phase_rad = kRadPerDeg * number_or(item, "phase", 0, -kMaxAngleDeg, kMaxAngleDeg, "deg");
    if (item.has("window")) {
      const std::vector<double> w = numbers(item, "window", 2, 2, -kMaxTimeS, kMaxTimeS, "s");
      if (!(w[1] > w[0])) throw OptionError(item.name("window") + " must end after it begins");
      sine.window = Span{w[0], w[1]};
    }
    curve.sines.push_back(sine);
  }
  return curve;
}

std::unique_ptr<Motion> parse_motion(const Section& s, const std::string& directory, const Eigen::Matrix3d& R_cam_imu) {
  const std::string type = choice(s, "type", {"curve", "constant_rate", "gyro_trace", "trajectory", "orbit"}, nullptr);
  const auto position = [&s] { return parse_curve(s, "position", kMaxLengthM, 1, "m"); };
  std::unique_ptr<Motion> motion;
  if (type == "curve") {
    motion = make_curve_motion(parse_curve(s, "rotation", kMaxAngleDeg, kRadPerDeg, "deg"), position());
  } else if (type == "constant_rate") {
    const Eigen::Vector3d rate = kRadPerDeg * vector(s, "rate", kMaxAngleDeg, "deg/s");
    motion = make_constant_rate_motion(rotation_or_identity(s, "orientation"), rate, position());
  } else if (type == "gyro_trace") {
    const std::vector<TraceSample> samples = load_gyro_trace(resolve(directory, s.text("file")));
    const double start = number_or(s, "start", 0, 0, samples.back().t_s, "s");
    const double scale = number_or(s, "scale", 1, -1000, 1000);
    motion =
        make_gyro_trace_motion(samples, start, scale, R_cam_imu, rotation_or_identity(s, "orientation"), position());
  } else if (type == "trajectory") {
    const std::vector<TrajectorySample> samples = load_trajectory(resolve(directory, s.text("file")));
    const double start = number_or(s, "start", 0, 0, samples.back().t_s, "s");
    motion = make_trajectory_motion(samples, start);
  } else {
    Orbit orbit;
    orbit.center_m = vector_or(s, "center", orbit.center_m, kMaxLengthM, "m");
    orbit.radius_m = number(s, "radius", 1e-3, kMaxLengthM, "m");
    const Eigen::Vector3d axis = vector_or(s, "axis", orbit.axis, kMaxLengthM);
    if (axis.norm() < 1e-6) throw OptionError(s.name("axis") + " has length 0");
    orbit.axis = axis.normalized();
    orbit.rate_rad_s = kRadPerDeg * number_or(s, "rate", 0, -kMaxAngleDeg, kMaxAngleDeg, "deg/s");
    orbit.amplitude_rad = kRadPerDeg * number_or(s, "amplitude", 0, -kMaxAngleDeg, kMaxAngleDeg, "deg");
    orbit.frequency_hz = number_or(s, "frequency", 0, 0, 1000, "Hz");
    motion = make_orbit_motion(orbit);
  }
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
  if (!node.IsMap()) refuse(name + ": scene", node, "a map of keys");
  const Section s(name, node);
  Scene scene;
  scene.frames = static_cast<int>(integer_or(s, "frames", 1, 1, 1e6));
  scene.seed = integer_or(s, "seed", scene.seed, 0, 1e9);
  scene.start_ns = to_ns(number_or(s, "start_time", to_seconds(scene.start_ns), 1, 4e9, "s"));
  scene.lead_ns = to_ns(number_or(s, "lead_time", to_seconds(scene.lead_ns), 0, 60, "s"));
  scene.gravity_m_s2 = vector_or(s, "gravity", scene.gravity_m_s2, 100, "m/s^2");
  scene.background = number_or(s, "background", scene.background, 0, 255, "grey levels");
  scene.camera = parse_camera(s.child("camera"));
  if (s.has("imu")) scene.imu = parse_imu(s.child("imu"));
  for (const Section& plane : elements_or_none(s, "planes")) scene.planes.push_back(parse_plane(plane, directory));
  scene.motion = parse_motion(s.child("motion"), directory, scene.imu.R_cam_imu);
  s.require_known_keys("config/scenes/handheld.yaml has every key");
  try {
    scene.validate();
  } catch (const OptionError& e) {
    throw OptionError(name + ": " + e.what());
  }
  return scene;
}

Scene load_scene(const std::string& path) {
  return parse_scene(load_yaml_file(path), std::filesystem::path(path).parent_path().string(), path);
}

}  // namespace gyro_deblur::sim
