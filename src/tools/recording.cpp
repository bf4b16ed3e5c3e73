// Reads folders of recorded images and IMU samples.
#include "tools/recording.hpp"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <regex>
#include <set>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <Eigen/LU>

#include "base/join.hpp"
#include "base/require_range.hpp"
#include "config/yaml_section.hpp"
#include "gyro_deblur/calibration.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;

/// Calls `on_line` with every line that is neither empty nor a comment ('#'), and adds the place to what it throws.
/// Reads plain and gzipped files.
void for_each_line(const std::string& path, const std::function<void(const std::string&)>& on_line) {
  const std::unique_ptr<gzFile_s, int (*)(gzFile)> file(gzopen(path.c_str(), "rb"), gzclose);
  if (file == nullptr) throw std::runtime_error(path + ": cannot be opened: no such file, or no right to read it");
  constexpr int kMaxLine = 4096;
  std::array<char, kMaxLine> buffer{};
  for (int number = 1; gzgets(file.get(), buffer.data(), kMaxLine) != nullptr; ++number) {
    std::string line(buffer.data());
    line.erase(line.find_last_not_of("\r\n") + 1);
    if (line.empty() || line.front() == '#') continue;
    try {
      on_line(line);
    } catch (const std::exception& error) {
      throw std::runtime_error(path + ":" + std::to_string(number) + ": " + error.what());
    }
  }
  int status = Z_OK;
  const char* message = gzerror(file.get(), &status);
  if (status != Z_OK && status != Z_STREAM_END) throw std::runtime_error(path + ": " + message);
}

/// Fields of a line, separated by commas or blanks.
std::vector<std::string> split(const std::string& line) {
  std::string blanks = line;
  std::replace(blanks.begin(), blanks.end(), ',', ' ');
  std::istringstream stream(blanks);
  std::vector<std::string> fields;
  for (std::string field; stream >> field;) fields.push_back(field);
  return fields;
}

const std::string& field_at(const std::vector<std::string>& fields, std::size_t index) {
  if (index >= fields.size()) {
    throw std::runtime_error("has " + std::to_string(fields.size()) + " columns, column " + std::to_string(index + 1) +
                             " is needed");
  }
  return fields[index];
}

double parse_number(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0') throw std::runtime_error("'" + text + "' is no number");
  return value;
}

constexpr double kNanosecond = 1e-9;

/// The integer that is all of the text; nothing where it is none, or out of range.
std::optional<long long> find_integer(const std::string& text) {
  char* end = nullptr;
  errno = 0;
  const long long value = std::strtoll(text.c_str(), &end, 10);
  if (end == text.c_str() || *end != '\0' || errno == ERANGE) return std::nullopt;
  return value;
}

/// @param place  of the text, for errors; empty: for_each_line() adds it
int parse_image_number(const std::string& text, const std::string& place = "") {
  constexpr int kMost = std::numeric_limits<int>::max();
  const std::optional<long long> value = find_integer(text);
  if (!value || *value < 0 || *value > kMost) {
    throw std::runtime_error(place + "'" + text + "' is no image number: an integer from 0 to " +
                             std::to_string(kMost) + " is needed");
  }
  return static_cast<int>(*value);
}

/// Nanoseconds are read as integers: 19 digits do not fit a double.
TimeNs parse_time(const std::string& text, double unit_s) {
  if (unit_s == kNanosecond) {
    const std::optional<long long> value = find_integer(text);
    if (!value) throw std::runtime_error("'" + text + "' is no time in integer nanoseconds");
    return *value;
  }
  constexpr double kMostS = 9e9;  // what nanoseconds in 64 bits hold
  const double time_s = parse_number(text) * unit_s;
  if (!(std::abs(time_s) <= kMostS)) throw std::runtime_error("'" + text + "' is no time: at most 9e9 s are allowed");
  return to_ns(time_s);
}

Eigen::Vector3d parse_vector(const std::vector<std::string>& fields, const std::array<std::size_t, 3>& columns) {
  return {parse_number(field_at(fields, columns[0])), parse_number(field_at(fields, columns[1])),
          parse_number(field_at(fields, columns[2]))};
}

/// Columns count from 1 in descriptions, from 0 here.
std::size_t read_column(const Section& section, const std::string& key) {
  const int number = section.integer(key);
  require_range(section.name(key).c_str(), number, 1, 100);
  return static_cast<std::size_t>(number) - 1;
}

/// The regular expression `pattern` of a section.
/// @param groups  what each of its groups holds
std::regex read_pattern(const Section& section, const std::vector<std::string>& groups) {
  const std::string text = section.text("pattern"), start = section.name("pattern") + " = " + text;
  std::regex expression;
  try {
    expression.assign(text);
  } catch (const std::regex_error& error) {
    throw std::runtime_error(start + " is no regular expression: " + error.what());
  }
  if (expression.mark_count() != groups.size()) {
    throw std::runtime_error(start + " has " + std::to_string(expression.mark_count()) +
                             " groups in parentheses instead of " + std::to_string(groups.size()) + ": " +
                             join(groups) + ". Write other parentheses as (?:...)");
  }
  return expression;
}

/// What every description holds: camera, extrinsic and clock.
Recording read_calibration(const Section& description) {
  Recording recording;
  const Section camera = description.child("camera");
  CameraCalibration& calibration = recording.camera;
  calibration.width_px = camera.integer("width");
  calibration.height_px = camera.integer("height");
  calibration.fx_px = camera.number("fx");
  calibration.fy_px = camera.number("fy");
  calibration.cx_px = camera.number("cx");
  calibration.cy_px = camera.number("cy");
  if (camera.has("distortion")) calibration.coefficients = camera.numbers("distortion");
  if (camera.has("distortion_model") || !calibration.coefficients.empty()) {
    const std::string model = require_distortion_model(camera.text("distortion_model"));
    if (!calibration.coefficients.empty()) calibration.model = model;
  }
  calibration.validate();

  const std::vector<double> rotation = description.numbers("R_cam_imu", 9);
  recording.R_cam_imu =
      require_rotation("R_cam_imu", Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation.data()));
  recording.time_offset_ns = description.seconds("time_offset");
  recording.readout_ns = description.seconds("readout_time");
  return recording;
}

/// Orders the frames. Throws when there are none, or no samples.
void complete(const std::string& folder, Recording* recording) {
  std::stable_sort(recording->frames.begin(), recording->frames.end(),
                   [](const RecordedFrame& a, const RecordedFrame& b) { return a.stamp_ns < b.stamp_ns; });
  if (recording->frames.empty()) {
    throw std::runtime_error(folder + ": no image found: check the folder, and the pattern of the description");
  }
  if (recording->imu.empty()) {
    throw std::runtime_error(folder + ": no gyroscope sample found: check the file of the gyroscope's samples");
  }
}

/// Times by the number of the image: in a column, where line i (from 1) belongs to image number i, or by a pattern.
std::map<int, TimeNs> read_times(const fs::path& folder, const Section& times) {
  const bool has_pattern = times.has("pattern");
  if (has_pattern == times.has("column")) {
    throw std::runtime_error(times.name("column") + (has_pattern ? " excludes" : " is missing, and so is") +
                             " pattern: give one of the two");
  }
  const std::regex pattern = has_pattern ? read_pattern(times, {"image number", "time"}) : std::regex();
  const std::size_t column = has_pattern ? 0 : read_column(times, "column");
  const double unit_s = times.number("unit");
  std::map<int, TimeNs> times_ns;
  for_each_line((folder / times.text("file")).string(), [&](const std::string& line) {
    std::smatch match;
    if (!has_pattern) {
      times_ns[static_cast<int>(times_ns.size()) + 1] = parse_time(field_at(split(line), column), unit_s);
    } else if (std::regex_search(line, match, pattern)) {
      times_ns[parse_image_number(match[1])] = parse_time(match[2], unit_s);
    }
  });
  return times_ns;
}

std::vector<RecordedFrame> read_images(const fs::path& folder, const Section& description) {
  const Section images = description.child("images");
  const fs::path image_folder = folder / images.text("folder");
  const std::regex name_pattern = read_pattern(images, {"image number"});
  if (!fs::is_directory(image_folder)) throw std::runtime_error(image_folder.string() + ": no such folder");
  const Section stamps = description.child("frame_stamps");
  const std::map<int, TimeNs> stamps_ns = read_times(folder, stamps);
  std::map<int, TimeNs> exposures_ns;
  if (description.has("exposures")) exposures_ns = read_times(folder, description.child("exposures"));
  const TimeNs common_exposure_ns = description.has("exposure_time") ? description.seconds("exposure_time") : 0;
  std::vector<RecordedFrame> frames;
  for (const fs::directory_entry& entry : fs::directory_iterator(image_folder)) {
    std::smatch match;
    const std::string name = entry.path().filename().string();
    if (!std::regex_match(name, match, name_pattern)) continue;
    const int number = parse_image_number(match[1], entry.path().string() + ": ");
    const auto stamp = stamps_ns.find(number);
    if (stamp == stamps_ns.end()) {
      throw std::runtime_error(entry.path().string() + ": no stamp for image " + std::to_string(number) + " in " +
                               stamps.text("file") + ", which has " + std::to_string(stamps_ns.size()));
    }
    const auto exposure = exposures_ns.find(number);
    frames.push_back(
        {stamp->second, exposure == exposures_ns.end() ? common_exposure_ns : exposure->second, entry.path().string()});
  }
  return frames;
}

using Samples = std::vector<std::pair<TimeNs, Eigen::Vector3d>>;

/// Samples of a sensor with three axes; with a kind, only the rows of that kind.
Samples read_samples(const fs::path& folder, const Section& sensor, const std::string& unit_key) {
  const std::array<std::size_t, 3> columns_xyz = {read_column(sensor, "x_column"), read_column(sensor, "y_column"),
                                                  read_column(sensor, "z_column")};
  const std::size_t column_t = read_column(sensor, "time_column");
  const double unit_s = sensor.number("time_unit");
  const double unit = sensor.number(unit_key);
  const bool has_kind = sensor.has("kind") || sensor.has("kind_column");
  const std::string kind = has_kind ? sensor.text("kind") : "";
  const std::size_t column_kind = has_kind ? read_column(sensor, "kind_column") : 0;
  const std::string path = (folder / sensor.text("file")).string();
  constexpr std::size_t kMostKinds = 10;  // that an error lists
  std::set<std::string> kinds;
  Samples samples;
  for_each_line(path, [&](const std::string& line) {
    const std::vector<std::string> fields = split(line);
    if (has_kind && field_at(fields, column_kind) != kind) {
      if (kinds.size() < kMostKinds) kinds.insert(fields[column_kind]);
      return;
    }
    samples.emplace_back(parse_time(field_at(fields, column_t), unit_s), parse_vector(fields, columns_xyz) * unit);
  });
  if (samples.empty() && !kinds.empty()) {
    throw std::runtime_error(path + ": no row is of the kind '" + kind + "'; column " +
                             std::to_string(column_kind + 1) + " has " + join(kinds));
  }
  return samples;
}

/// An acceleration belongs to the rate with the same time.
std::vector<RecordedImu> read_imu(const fs::path& folder, const Section& description) {
  std::map<TimeNs, Eigen::Vector3d> accelerations_m_s2;
  if (description.has("accelerometer")) {
    const Samples samples = read_samples(folder, description.child("accelerometer"), "acceleration_unit");
    accelerations_m_s2.insert(samples.begin(), samples.end());
  }
  std::vector<RecordedImu> imu;
  for (const auto& [t_ns, rate_rad_s] : read_samples(folder, description.child("gyro"), "rate_unit")) {
    RecordedImu& sample = imu.emplace_back(RecordedImu{t_ns, rate_rad_s, std::nullopt});
    const auto acceleration = accelerations_m_s2.find(t_ns);
    if (acceleration != accelerations_m_s2.end()) sample.acceleration_m_s2 = acceleration->second;
  }
  const auto has_none = [](const RecordedImu& sample) { return !sample.acceleration_m_s2; };
  if (description.has("accelerometer") && !imu.empty() && std::all_of(imu.begin(), imu.end(), has_none)) {
    throw std::runtime_error(description.name("accelerometer") +
                             ": no sample has the time of a gyroscope sample: leave the section out, or give samples "
                             "of the same times");
  }
  return imu;
}

}  // namespace

Recording read_euroc(const std::string& folder, const std::string& camera, TimeNs exposure_ns) {
  const fs::path root = fs::is_directory(fs::path(folder) / "mav0") ? fs::path(folder) / "mav0" : fs::path(folder);
  const fs::path camera_folder = root / camera;

  const SensorCalibration calibration = load_calibration((camera_folder / "sensor.yaml").string());
  Recording recording;
  recording.camera = *calibration.camera;
  recording.R_cam_imu = *calibration.R_cam_imu;
  recording.p_imu_cam_m = *calibration.p_imu_cam_m;

  for_each_line((camera_folder / "data.csv").string(), [&](const std::string& line) {
    const std::vector<std::string> fields = split(line);
    recording.frames.push_back({parse_time(field_at(fields, 0), kNanosecond), exposure_ns,
                                (camera_folder / "data" / field_at(fields, 1)).string()});
  });
  for_each_line((root / "imu0" / "data.csv").string(), [&](const std::string& line) {
    const std::vector<std::string> fields = split(line);
    recording.imu.push_back({parse_time(field_at(fields, 0), kNanosecond), parse_vector(fields, {1, 2, 3}),
                             parse_vector(fields, {4, 5, 6})});
  });
  complete(folder, &recording);
  return recording;
}

Recording read_frames(const std::string& folder, const std::string& description_path) {
  const Section description = Section::load(description_path);
  Recording recording = read_calibration(description);
  recording.frames = read_images(folder, description);
  recording.imu = read_imu(folder, description);
  description.require_known_keys("config/recordings/ has an example of each file");
  complete(folder, &recording);
  return recording;
}

RotationTrack rotation_of(const Recording& recording) {
  std::vector<GyroSample> samples;
  for (const RecordedImu& sample : recording.imu) samples.push_back({sample.t_ns, sample.rate_rad_s});
  GyroOptions gyro;
  gyro.time_offset_ns = recording.time_offset_ns;
  return RotationTrack(samples, gyro, recording.R_cam_imu);
}

}  // namespace gyro_deblur
