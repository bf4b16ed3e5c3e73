#include "tools/timing_report.hpp"

#include <cmath>
#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <set>

#include <yaml-cpp/yaml.h>
#include <Eigen/Core>

#include "config/parameters.hpp"
#include "gyro_deblur/calibration.hpp"

namespace gyro_deblur {
namespace {

constexpr double kDegPerRad = 180 / M_PI;

nlohmann::json to_json(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }
nlohmann::json to_json(const Eigen::Vector2d& v) { return {v.x(), v.y()}; }
nlohmann::json to_json(const Estimate& v) { return {{"value", v.value}, {"stddev", v.stddev}}; }

std::string text_of(const char* format, double value) {
  char text[100];
  std::snprintf(text, sizeof(text), format, value);
  return text;
}

/// Lines of YAML, and which keys they have.
class YamlLines {
 public:
  explicit YamlLines(const std::string& comment) : text_(comment) {}

  void add(const std::string& key, const std::string& value, const std::string& comment) {
    text_ += key + ": " + value + (comment.empty() ? "" : "  # " + comment) + "\n";
    written_.insert(key);
  }
  /// The keys of a map that are not there yet.
  void add_others(const YAML::Node& map, const std::string& comment) {
    text_ += "\n# " + comment + "\n";
    for (const auto& entry : map) {
      if (written_.count(entry.first.Scalar()) != 0) continue;
      YAML::Node single;
      single[entry.first.Scalar()] = entry.second;
      text_ += YAML::Dump(single) + "\n";
    }
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
  std::set<std::string> written_;
};

void add_estimate(const TimingResult& result, YamlLines* yaml) {
  const TimingEstimate& e = result.estimate;
  yaml->add("time_offset", text_of("%.6f", e.time_offset_s.value), text_of("[s] +- %.6f", e.time_offset_s.stddev));
  yaml->add(
      "readout_time", text_of("%.6f", result.sensor_readout_s.value),
      result.sensor_readout_s.stddev > 0 ? text_of("[s] +- %.6f", result.sensor_readout_s.stddev) : "[s] as given");
  std::string bias, stddev;
  for (const Estimate& axis : e.bias_rad_s) {
    bias += (bias.empty() ? "[" : ", ") + text_of("%.5f", axis.value);
    stddev += (stddev.empty() ? "[" : ", ") + text_of("%.5f", axis.stddev);
  }
  yaml->add("gyro_bias", bias + "]", "[rad/s] " + (e.bias_rad_s[0].stddev > 0 ? "+- " + stddev + "]" : "as given"));
  if (result.rotation_from == "tf") return;
  yaml->add("R_cam_imu", to_string(e.R_cam_imu),
            result.rotation_from == "estimated"
                ? text_of("estimated, +- %.3f degrees", e.rotation_stddev_rad.maxCoeff() * kDegPerRad)
                : result.rotation_from);
}

/// What the estimate holds for.
void add_shutter(const ShutterTiming& shutter, YamlLines* yaml) {
  for (const char* key : {"stamp_row", "stamp_phase"}) {
    yaml->add(key, std::get<Choice>(find_parameter(key)->get(shutter)).name, "");
  }
  if (shutter.exposure_ns > 0) {
    yaml->add("exposure_time", text_of("%.6f", to_seconds(shutter.exposure_ns)), "[s] as given");
  }
}

/// The keys of the configuration that was given; files are found from wherever the new one is.
void add_configuration(const std::string& path, YamlLines* yaml) {
  YAML::Node given = YAML::LoadFile(path);
  if (YAML::Node files = given["calibration_file"]; files && !files.IsNull()) {
    const std::filesystem::path folder = std::filesystem::absolute(path).parent_path();
    const auto make_absolute = [&folder](YAML::Node file) {
      if (file.IsScalar() && !file.Scalar().empty()) file = (folder / file.Scalar()).lexically_normal().string();
    };
    if (files.IsSequence()) {
      for (YAML::Node file : files) make_absolute(file);
    } else {
      make_absolute(files);
    }
    yaml->add("on_calibration_conflict", "configured", "what was estimated holds against calibration_file");
  }
  yaml->add_others(given, "From " + path);
}

}  // namespace

void print_summary(const TimingResult& result) {
  const TimingEstimate& estimate = result.estimate;
  std::printf("time_offset   %+.6f +- %.6f s   (t_imu = t_cam + time_offset)\n", estimate.time_offset_s.value,
              estimate.time_offset_s.stddev);
  std::printf("readout_time  %+.6f +- %.6f s\n", result.sensor_readout_s.value, result.sensor_readout_s.stddev);
  std::printf("gyro_bias     [%+.5f, %+.5f, %+.5f] +- [%.5f, %.5f, %.5f] rad/s\n", estimate.bias_rad_s[0].value,
              estimate.bias_rad_s[1].value, estimate.bias_rad_s[2].value, estimate.bias_rad_s[0].stddev,
              estimate.bias_rad_s[1].stddev, estimate.bias_rad_s[2].stddev);
  std::printf("R_cam_imu     %s", to_string(estimate.R_cam_imu).c_str());
  if (result.rotation_from == "estimated") {
    const Eigen::Vector3d stddev_deg = estimate.rotation_stddev_rad * kDegPerRad;
    std::printf(" +- [%.3f, %.3f, %.3f] degrees about the camera's axes\n", stddev_deg.x(), stddev_deg.y(),
                stddev_deg.z());
  } else {
    std::printf(" (%s)\n", result.rotation_from.c_str());
  }
  std::printf(
      "%zu pairs of frames, %zu points; correlation of the angular speeds %.3f; translation %.2f depths/s on each "
      "axis; "
      "median residual %.2f px without gyroscope, %.2f px with it, %.2f px refined and with translation\n",
      estimate.pairs, estimate.points, estimate.correlation, estimate.speed_per_s, estimate.median_without_px,
      estimate.median_at_start_px, estimate.median_px);
  std::fflush(stdout);
}

nlohmann::json report_of(const TimingResult& result, const FootageTopics& topics) {
  const TimingEstimate& e = result.estimate;
  nlohmann::json report;
  report["bag"] = result.bag;
  report["topics"] = {{"image", topics.image.name},
                      {"camera_info", topics.camera_info},
                      {"imu", topics.imu},
                      {"exposure", topics.exposure}};
  report["time_offset_s"] = to_json(e.time_offset_s);
  report["readout_time_s"] = to_json(e.readout_s);
  report["gyro_bias_rad_s"] = {to_json(e.bias_rad_s[0]), to_json(e.bias_rad_s[1]), to_json(e.bias_rad_s[2])};
  report["R_cam_imu"] = nlohmann::json::array();
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 3; ++col) report["R_cam_imu"].push_back(e.R_cam_imu(row, col));
  }
  report["rotation_from"] = result.rotation_from;
  report["rotation_stddev_deg"] = to_json(Eigen::Vector3d(e.rotation_stddev_rad * kDegPerRad));
  report["correlation"] = e.correlation;
  report["pairs"] = e.pairs;
  report["points"] = e.points;
  report["speed_depths_s"] = e.speed_per_s;
  report["median_residual_px"] = {{"without_gyroscope", e.median_without_px},
                                  {"before_refinement", e.median_at_start_px},
                                  {"estimated", e.median_px}};
  for (const RatePair& rate : e.rates) {
    report["rates"].push_back(
        {{"t_ns", rate.t_ns}, {"image_rad_s", to_json(rate.image_rad_s)}, {"gyro_rad_s", to_json(rate.gyro_rad_s)}});
  }
  // Enough for a plot.
  constexpr std::size_t kMostResiduals = 5000;
  const std::size_t stride = e.residuals.size() / kMostResiduals + 1;
  for (std::size_t i = 0; i < e.residuals.size(); i += stride) {
    const TimingResidual& residual = e.residuals[i];
    report["residuals"].push_back({{"row_px", residual.row_px},
                                   {"without_px", to_json(residual.without_px)},
                                   {"at_start_px", to_json(residual.at_start_px)},
                                   {"estimated_px", to_json(residual.estimated_px)}});
  }
  return report;
}

std::string configuration_of(const TimingResult& result, const Config& config, const std::string& config_path) {
  YamlLines yaml("# By calibrate_timing from " + result.bag +
                 ".\n# Keys that are not here have the defaults of config/default.yaml.\n");
  add_estimate(result, &yaml);
  add_shutter(config.shutter, &yaml);
  if (!config_path.empty()) add_configuration(config_path, &yaml);
  return yaml.text();
}

}  // namespace gyro_deblur
