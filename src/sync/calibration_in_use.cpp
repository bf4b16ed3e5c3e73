// Chooses between given and estimated calibrations and reports contradictions.
#include "sync/calibration_in_use.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "base/format.hpp"
#include "gyro_deblur/calibration.hpp"
#include "sync/missing_inputs.hpp"

namespace gyro_deblur {
namespace {

constexpr char kFocalLength[] = "focal_length";

std::string text_of(const std::string& key, double value) {
  return key == kFocalLength ? format("%.3f of the image's larger side", value) : format("%.4f s", value);
}
std::string text_of(const std::string&, const Eigen::Vector3d& bias_rad_s) {
  return vector_text(bias_rad_s) + " rad/s";
}
std::string text_of(const std::string&, const Eigen::Matrix3d& R) { return to_string(R); }

/// A standard deviation, or a difference, in the unit of such a value.
std::string distance_text(const std::string& key, const Learned<double>&, double distance) {
  return key == kFocalLength ? format("%.3f", distance) : format("%.1f ms", 1e3 * distance);
}
std::string distance_text(const std::string&, const Learned<Eigen::Vector3d>&, double distance) {
  return format("%.4f rad/s", distance);
}
std::string distance_text(const std::string&, const Learned<Eigen::Matrix3d>&, double distance) {
  return format("%.1f degrees", kDegPerRad * distance);
}

/// A row, of a value that is given.
template <typename Value>
CalibrationRow given_row(const std::string& key, const Value& value, const std::string& source, bool learns,
                         const Learned<Value>& learned) {
  std::string text = text_of(key, value) + " (" + source + ")";
  if (learned.known) {
    text += ", images differ from it by " + distance_text(key, learned, difference(value, learned.value)) + " (+- " +
            distance_text(key, learned, learned.stddev) + ")";
  } else if (learns) {
    text += ", not checked yet: " + learned.missing;
  }
  return {key, text, false};
}

/// A row for a value that is not given.
/// @param without  what is done meanwhile
template <typename Value>
CalibrationRow learned_row(const std::string& key, bool learns, const Learned<Value>& taken, const std::string& missing,
                           const std::string& without, bool is_remembered) {
  if (taken.known && learns) {
    return {key,
            text_of(key, taken.value) + " (+- " + distance_text(key, taken, taken.stddev) + "), by the images of " +
                format("%.0f s", taken.seconds) + (is_remembered ? " before this start" : ""),
            true};
  }
  return {key, "not known, " + without + ": " + (learns ? missing : "self_calibration is never"), false};
}

}  // namespace

CalibrationInUse::CalibrationInUse(InputProblems* problems)
    : problems_(*problems), learned_(SelfCalibration().learned()), taken_(learned_) {}

void CalibrationInUse::set_config(const Config& config) {
  given_ = config;
  use();
}

// Values that change with every estimate would shake the motion from frame to frame.
template <typename Value>
bool CalibrationInUse::take(const std::string& key, const Learned<Value>& newest, Learned<Value>* taken) {
  constexpr double kSurer = 0.6, kAnother = 2, kContradicting = 4;
  if (!newest.known) {
    if (!taken->known) *taken = newest;
    return false;
  }
  const double change = difference(newest.value, taken->value);
  if (taken->known && newest.stddev > kSurer * taken->stddev && change < kAnother * newest.stddev) return false;
  if (remembered_.erase(key) > 0 && change > kContradicting * std::hypot(newest.stddev, taken->stddev)) {
    problems_.log(LogLevel::WARNING, key + " of the last start is dropped: it was " + text_of(key, taken->value) +
                                         ", the images now give " + text_of(key, newest.value));
  }
  *taken = newest;
  return true;
}

void CalibrationInUse::remember(const LearnedCalibration& before) {
  const auto take_over = [this](const char* key, bool is_given, const auto& value, auto* taken) {
    if (is_given || !value.known || taken->known) return;
    *taken = value;
    remembered_.insert(key);
  };
  take_over("R_cam_imu", given_.R_cam_imu.has_value(), before.R_cam_imu, &taken_.R_cam_imu);
  take_over("readout_time", given_.given.readout_time, before.readout_s, &taken_.readout_s);
  const bool had_offset = taken_.time_offset_s.known;
  take_over("time_offset", given_.given.time_offset, before.time_offset_s, &taken_.time_offset_s);
  if (!had_offset && taken_.time_offset_s.known) taken_.time_offset_s.value += readout_in_offset_s();
  take_over("gyro_bias", given_.given.gyro_bias, before.bias_rad_s, &taken_.bias_rad_s);
  take_over(kFocalLength, false, before.focal_length, &taken_.focal_length);
  if (remembered_.count(kFocalLength) > 0) taken_.focal_image_px = before.focal_image_px;
  use();
}

void CalibrationInUse::forget() {
  learned_ = taken_ = SelfCalibration().learned();
  remembered_.clear();
  use();
  check();
}

LearnedCalibration CalibrationInUse::by_images() const {
  LearnedCalibration used = taken_;
  used.R_cam_imu.known = used.R_cam_imu.known && learns() && !given_.R_cam_imu;
  // Without half of an unknown readout time: the next start may know it.
  used.time_offset_s = time_offset();
  used.time_offset_s.known =
      used.time_offset_s.known && learns() && !given_.given.time_offset && (has_readout() || taken_.readout_s.known);
  used.readout_s.known = used.readout_s.known && learns() && !given_.given.readout_time;
  used.bias_rad_s.known = used.bias_rad_s.known && learns() && !given_.given.gyro_bias;
  used.focal_length.known = used.focal_length.known && learns() && lens_known_ != true;
  return used;
}

void CalibrationInUse::use() {
  config_ = given_;
  R_cam_imu_.reset();
  if (!learns()) return;
  if (!given_.given.readout_time && taken_.readout_s.known) {
    config_.shutter.readout_ns = to_ns(taken_.readout_s.value / readout_share_);
  }
  if (!given_.given.time_offset && taken_.time_offset_s.known) config_.gyro.time_offset_ns = to_ns(time_offset().value);
  if (!given_.given.gyro_bias && taken_.bias_rad_s.known) config_.gyro.bias_rad_s = taken_.bias_rad_s.value;
  if (!given_.R_cam_imu && taken_.R_cam_imu.known) R_cam_imu_ = taken_.R_cam_imu.value;
}

double CalibrationInUse::readout_in_offset_s() const {
  if (has_readout() || !taken_.readout_s.known) return 0;
  // Learned for rows that are exposed at once, when the stamp says.
  return readout_to_middle(given_.shutter.stamp_row) * taken_.readout_s.value;
}

Learned<double> CalibrationInUse::time_offset() const {
  Learned<double> offset = taken_.time_offset_s;
  offset.value -= readout_in_offset_s();
  return offset;
}

std::string CalibrationInUse::missing_rotation() const {
  return learns() ? learned_.R_cam_imu.missing : "self_calibration is never";
}

std::optional<double> CalibrationInUse::focal_length(int width_px, int height_px) const {
  const bool fits = taken_.focal_length.known && taken_.focal_image_px == std::max(width_px, height_px);
  return learns() && fits ? std::optional(taken_.focal_length.value) : std::nullopt;
}

bool CalibrationInUse::learn(const LearnedCalibration& learned, double readout_share, bool readout_by_messages) {
  learned_ = learned;
  readout_share_ = readout_share;
  const double before_s = readout_in_offset_s();
  readout_by_messages_ = readout_by_messages;
  taken_.time_offset_s.value += readout_in_offset_s() - before_s;
  std::set<std::string> known_before;
  for (const CalibrationRow& row : table()) {
    if (row.by_images) known_before.insert(row.key);
  }
  bool changed = take("R_cam_imu", learned.R_cam_imu, &taken_.R_cam_imu);
  changed = take("readout_time", learned.readout_s, &taken_.readout_s) || changed;
  changed = take("time_offset", learned.time_offset_s, &taken_.time_offset_s) || changed;
  changed = take("gyro_bias", learned.bias_rad_s, &taken_.bias_rad_s) || changed;
  if (learned.focal_length.known && learned.focal_image_px != taken_.focal_image_px) {
    taken_.focal_length = {};
    taken_.focal_image_px = learned.focal_image_px;
  }
  changed = take(kFocalLength, learned.focal_length, &taken_.focal_length) || changed;
  use();
  check();
  if (!learns()) return false;
  for (const CalibrationRow& row : table()) {
    if (row.by_images && known_before.count(row.key) == 0)
      problems_.log(LogLevel::INFO, row.key + " is estimated from the images and used: " + row.text);
  }
  return changed;
}

std::string CalibrationInUse::source(bool file_has_it) const {
  return file_has_it ? given_.calibration->origin : "parameter";
}

UsedCalibration CalibrationInUse::used() const {
  const SensorCalibration file = given_.calibration.value_or(SensorCalibration());
  UsedCalibration used;
  if (given_.R_cam_imu) {
    used.R_cam_imu = {{*given_.R_cam_imu, source(file.R_cam_imu.has_value())}};
  } else if (from_tf_) {
    used.R_cam_imu = {{*from_tf_, "tf"}};
  }
  // Half of an unknown readout time would pass for an offset.
  if (given_.given.time_offset && (has_readout() || taken_.readout_s.known)) {
    used.time_offset_ns = {{given_.gyro.time_offset_ns, source(file.time_offset_ns.has_value())}};
  }
  if (given_.given.readout_time) {
    used.readout_ns = {
        {to_ns(to_seconds(given_.shutter.readout_ns) * readout_share_), source(file.readout_ns.has_value())}};
  }
  if (given_.given.gyro_bias) used.bias_rad_s = {{given_.gyro.bias_rad_s, "parameter"}};
  return used;
}

void CalibrationInUse::check() {
  std::map<std::string, std::string> found{
      {"R_cam_imu", ""}, {"time_offset", ""}, {"readout_time", ""}, {"gyro_bias", ""}};
  if (learns()) {
    LearnedCalibration learned = learned_;
    learned.time_offset_s = time_offset();
    for (const Contradiction& each : contradictions(used(), learned)) found[each.key] = each.text;
  }
  for (const auto& [key, text] : found) problems_.update(key + " by images", text);
}

std::vector<CalibrationRow> CalibrationInUse::table() const {
  const UsedCalibration in_use = used();
  const SensorCalibration file = given_.calibration.value_or(SensorCalibration());
  const auto unknown = [this](const std::string& key, const auto& taken, const std::string& missing,
                              const std::string& without) {
    return learned_row(key, learns(), taken, missing, without, remembered_.count(key) > 0);
  };
  std::vector<CalibrationRow> rows;
  rows.push_back(
      in_use.R_cam_imu
          ? given_row("R_cam_imu", in_use.R_cam_imu->value, in_use.R_cam_imu->source, learns(), learned_.R_cam_imu)
          : unknown("R_cam_imu", taken_.R_cam_imu, learned_.R_cam_imu.missing,
                    goes_without_imu(given_) ? "images are deblurred by optical flow alone unless tf has it"
                                             : "images pass through unless tf has it"));
  const Learned<double> offset = time_offset();
  rows.push_back(given_.given.time_offset
                     ? given_row("time_offset", to_seconds(given_.gyro.time_offset_ns),
                                 source(file.time_offset_ns.has_value()), learns(), offset)
                     : unknown("time_offset", offset, learned_.time_offset_s.missing, "0 s is used"));
  rows.push_back(in_use.readout_ns
                     ? given_row("readout_time", to_seconds(in_use.readout_ns->value), in_use.readout_ns->source,
                                 learns(), learned_.readout_s)
                     : unknown("readout_time", taken_.readout_s, learned_.readout_s.missing, "0 s is used"));
  rows.push_back(
      in_use.bias_rad_s
          ? given_row("gyro_bias", in_use.bias_rad_s->value, in_use.bias_rad_s->source, learns(), learned_.bias_rad_s)
          : unknown("gyro_bias", taken_.bias_rad_s, learned_.bias_rad_s.missing, "0 rad/s is used"));
  if (lens_known_ == false) {
    rows.push_back(unknown(kFocalLength, taken_.focal_length, learned_.focal_length.missing,
                           "images are deblurred by optical flow alone"));
  }
  return rows;
}

}  // namespace gyro_deblur
