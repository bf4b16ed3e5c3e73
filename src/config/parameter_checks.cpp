// Which values are allowed: what the rows of the table say, and what no single row can say.
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <variant>
#include <vector>

#include "base/require_range.hpp"
#include "config/parameters.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

/// The least number above an open end: in times the next nanosecond, and the least normal number above 0.
double next_above(double end) {
  using Limits = std::numeric_limits<double>;
  return end == 0 ? Limits::min() : std::nextafter(end, Limits::infinity());
}

void require(const Parameter& p, double value) {
  if (!p.limits) return;
  require_range(p.key.c_str(), value, p.limits->above ? next_above(p.limits->min) : p.limits->min, p.limits->max,
                p.limits->unit);
}

void require(const Parameter& p, int value) { require(p, static_cast<double>(value)); }

void require(const Parameter& p, TimeNs value_ns) {
  if (!p.limits) return;
  const double min_s = p.limits->above ? to_seconds(to_ns(p.limits->min) + 1) : p.limits->min;
  require_range(p.key.c_str(), to_seconds(value_ns), min_s, p.limits->max, p.limits->unit);
}

void require(const Parameter& p, const std::string& value) {
  if (p.choices.empty() || std::find(p.choices.begin(), p.choices.end(), value) != p.choices.end()) return;
  std::string message = p.key + " = \"" + value + "\" is not one of";
  for (const std::string& choice : p.choices) message += ' ' + choice;
  throw OptionError(message);
}

void require(const Parameter& p, const Eigen::Vector3d& value) {
  for (const double component : {value.x(), value.y(), value.z()}) require(p, component);
}

void require(const Parameter& p, const std::optional<Eigen::Matrix3d>& value) {
  if (value) require_rotation(p.key.c_str(), *value);
}

// Every value of these types is allowed.
void require(const Parameter&, bool) {}
void require(const Parameter&, const Choice&) {}
void require(const Parameter&, const std::vector<std::string>&) {}

/// The unit that was probably meant, for a time beyond a limit of some seconds.
std::string unit_hint(double value_s, double max_s) {
  for (const auto& [unit, per_second] : {std::pair{"milliseconds", 1e3}, std::pair{"microseconds", 1e6}}) {
    if (std::abs(value_s) > 1 && std::abs(value_s) / per_second <= max_s)
      return std::string(": is it in ") + unit + "?";
  }
  return {};
}

/// Detectors whose keypoints a descriptor cannot take. AKAZE describes in its own scale space only. ORB reads `octave`
/// as a pyramid level, where SIFT packs octave, layer and offset into it and so asks for a pyramid of millions of
/// levels.
const std::vector<std::string>& refused_detectors(const std::string& descriptor) {
  static const std::map<std::string, std::vector<std::string>> kRefused{
      {"AKAZE", {"SIFT", "ORB", "BRISK", "GFTT", "FAST"}}, {"ORB", {"SIFT"}}};
  static const std::vector<std::string> kNone;
  const auto found = kRefused.find(descriptor);
  return found == kRefused.end() ? kNone : found->second;
}

}  // namespace

std::string to_string(const Limits& limits) {
  std::ostringstream text;
  text << (limits.above ? '(' : '[') << limits.min << ", " << limits.max << ']';
  if (*limits.unit != '\0') text << ' ' << limits.unit;
  return text.str();
}

void Parameter::check(const Value& value) const {
  std::visit([this](const auto& v) { require(*this, v); }, value);
}

void BlurFieldOptions::validate() const {
  check_parameters(*this);
  if (block_size_px % 2 != 0) {
    throw OptionError("block_size = " + std::to_string(block_size_px) + " is odd; allowed are even sizes in " +
                      to_string(*find_parameter("block_size")->limits));
  }
  require_range("max_extent", max_extent_px, min_extent_px, find_parameter("max_extent")->limits->max, "px");
}

void ValidationOptions::validate() const { check_parameters(*this); }

void FilterOptions::validate() const { check_parameters(*this); }

void NoiseModel::validate() const { check_parameters(*this); }

void KeypointOptions::validate() const {
  check_parameters(*this);
  const std::vector<std::string>& refused = refused_detectors(descriptor);
  if (std::find(refused.begin(), refused.end(), detector) == refused.end()) return;
  std::string accepted;
  for (const std::string& name : find_parameter("keypoint_detector")->choices) {
    if (std::find(refused.begin(), refused.end(), name) == refused.end()) accepted += ' ' + name;
  }
  throw OptionError("keypoint_descriptor = \"" + descriptor +
                    "\" cannot describe the keypoints of keypoint_detector = \"" + detector + "\", only those of" +
                    accepted);
}

void TrackerOptions::validate() const {
  check_parameters(*this);
  if (window_px % 2 == 0) {
    throw OptionError("track_window = " + std::to_string(window_px) + " is even; allowed are odd sizes in " +
                      to_string(*find_constant("track_window")->limits));
  }
}

void GyroOptions::validate() const { check_parameters(*this); }

void ShutterTiming::validate() const {
  for (const Parameter* parameter : parameters_of<ShutterTiming>()) {
    const Value value = parameter->get(*this);
    try {
      parameter->check(value);
    } catch (const OptionError& error) {
      const double value_s = to_seconds(std::get<TimeNs>(value));  // only times are refused
      throw OptionError(error.what() + unit_hint(value_s, parameter->limits->max));
    }
  }
}

void PipelineOptions::validate() const {
  blur_field.validate();
  validation.validate();
  filter.validate();
  noise.validate();
  keypoints.validate();
  check_parameters(*this);
  if (flow_without_gyro == "always" && !optical_flow) {
    throw OptionError(
        "flow_without_gyro = \"always\" needs optical_flow = true, which is false: set optical_flow to true, or "
        "flow_without_gyro to absent or never");
  }
  static_cast<void>(BitDepth(significant_bits));
}

void Config::validate() const {
  using Kind = ExposureSource::Kind;
  if ((exposure_source.kind == Kind::FIELD || exposure_source.kind == Kind::DYNAMIC_RECONFIGURE) &&
      exposure_source.field.empty()) {
    throw OptionError(
        "exposure_field = \"\" is not the name of a field: set it, or exposure_source to auto, which needs none");
  }
  pipeline.validate();
  gyro.validate();
  ShutterTiming timing = shutter;
  if (timing.exposure_ns == 0) timing.exposure_ns = 1;  // not known; check the rest
  timing.validate();
  tracker.validate();
  check_parameters(exposure_source);
  check_parameters(*this);
}

bool operator==(const BlurFieldOptions& a, const BlurFieldOptions& b) { return same_parameters(a, b); }

bool operator==(const FilterOptions& a, const FilterOptions& b) { return same_parameters(a, b); }

bool operator==(const KeypointOptions& a, const KeypointOptions& b) { return same_parameters(a, b); }

}  // namespace gyro_deblur
