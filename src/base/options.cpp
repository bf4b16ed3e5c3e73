// Which options are allowed: what the rows of the tables say, and what no single row can say.
#include "gyro_deblur/options.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>

#include "base/option_table.hpp"
#include "base/require_range.hpp"
#include "gyro_deblur/image_format.hpp"

namespace gyro_deblur {
namespace {

/// The least number above an open end, and the least normal number above 0.
double next_above(double end) {
  using Doubles = std::numeric_limits<double>;
  return end == 0 ? Doubles::min() : std::nextafter(end, Doubles::infinity());
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

void require_allowed(const Row& row, double value) {
  if (!row.limits) return;
  require_range(row.key, value, row.limits->above ? next_above(row.limits->min) : row.limits->min, row.limits->max,
                row.limits->unit);
}

void require_allowed(const Row& row, TimeNs value_ns) {
  if (!row.limits) return;
  const double min_s = row.limits->above ? to_seconds(to_ns(row.limits->min) + 1) : row.limits->min;
  require_range(row.key, to_seconds(value_ns), min_s, row.limits->max, row.limits->unit);
}

void require_allowed(const Row& row, const std::string& value) {
  if (row.choices.empty() || std::find(row.choices.begin(), row.choices.end(), value) != row.choices.end()) return;
  std::string message = std::string(row.key) + " = \"" + value + "\" is not one of";
  for (const char* choice : row.choices) message += std::string(" ") + choice;
  throw OptionError(message);
}

void require_allowed(const Row& row, const Eigen::Vector3d& value) {
  for (const double component : {value.x(), value.y(), value.z()}) require_allowed(row, component);
}

void BlurFieldOptions::validate() const {
  check_parameters(*this);
  if (block_size_px % 2 != 0) {
    throw OptionError("block_size = " + std::to_string(block_size_px) + " is odd; allowed are even sizes in " +
                      to_string(kBlockSizes));
  }
  require_range("max_extent", max_extent_px, min_extent_px, kMaxExtents.max, "px");
}

void ValidationOptions::validate() const { check_parameters(*this); }

void FilterOptions::validate() const { check_parameters(*this); }

void NoiseModel::validate() const { check_parameters(*this); }

void KeypointOptions::validate() const {
  check_parameters(*this);
  const std::vector<std::string>& refused = refused_detectors(descriptor);
  if (std::find(refused.begin(), refused.end(), detector) == refused.end()) return;
  std::string accepted;
  for (const char* name : kDetectors) {
    if (std::find(refused.begin(), refused.end(), name) == refused.end()) accepted += std::string(" ") + name;
  }
  throw OptionError("keypoint_descriptor = \"" + descriptor +
                    "\" cannot describe the keypoints of keypoint_detector = \"" + detector + "\", only those of" +
                    accepted);
}

void TrackerOptions::validate() const {
  check_parameters(*this);
  if (window_px % 2 == 0) {
    throw OptionError("track_window = " + std::to_string(window_px) + " is even; allowed are odd sizes in " +
                      to_string(kTrackWindows));
  }
}

void GyroOptions::validate() const { check_parameters(*this); }

void PipelineOptions::validate() const {
  check_parameters(*this);
  if (flow_without_gyro == "always" && !optical_flow) {
    throw OptionError(
        "flow_without_gyro = \"always\" needs optical_flow = true, which is false: set optical_flow to true, or "
        "flow_without_gyro to absent or never");
  }
  static_cast<void>(BitDepth(significant_bits));
}

bool operator==(const BlurFieldOptions& a, const BlurFieldOptions& b) { return same_parameters(a, b); }

bool operator==(const FilterOptions& a, const FilterOptions& b) { return same_parameters(a, b); }

bool operator==(const KeypointOptions& a, const KeypointOptions& b) { return same_parameters(a, b); }

}  // namespace gyro_deblur
