// Which options are allowed: what the rows of the tables say, and what no single row can say.
#include "gyro_deblur/options.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/format.hpp"
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

/// AKAZE describes in its own scale space only. ORB reads `octave` as a pyramid level, where SIFT packs octave, layer
/// and offset into it and so asks for a pyramid of millions of levels.
bool can_describe(const std::string& descriptor, const std::string& detector) {
  if (descriptor == "AKAZE") return detector == "AKAZE";
  return descriptor != "ORB" || detector != "SIFT";
}

}  // namespace

std::string to_string(const Limits& limits) {
  return format("%c%g, %g]%s%s", limits.above ? '(' : '[', limits.min, limits.max, *limits.unit != '\0' ? " " : "",
                limits.unit);
}

void require_range(const char* name, double value, double min, double max, const char* unit) {
  if (value >= min && value <= max) return;
  // Ten digits distinguish an open end one nanosecond from its bound.
  throw OptionError(
      format("%s = %.10g is outside [%.10g, %.10g]%s%s", name, value, min, max, *unit != '\0' ? " " : "", unit));
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

void KeypointOptions::validate() const {
  check_parameters(*this);
  if (can_describe(descriptor, detector)) return;
  std::string accepted;
  for (const char* name : kDetectors) {
    if (can_describe(descriptor, name)) accepted += std::string(" ") + name;
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
