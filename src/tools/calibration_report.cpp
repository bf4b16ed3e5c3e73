// Writes the reports of calibrate.
#include "tools/calibration_report.hpp"

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <set>

#include <yaml-cpp/yaml.h>
#include <Eigen/Core>

#include "base/format.hpp"
#include "gyro_deblur/calibration.hpp"
#include "motion/shutter_table.hpp"

namespace gyro_deblur {
namespace {

nlohmann::json to_json(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }
nlohmann::json to_json(const Eigen::Vector2d& v) { return {v.x(), v.y()}; }
nlohmann::json to_json(const Estimate& v) { return {{"value", v.value}, {"stddev", v.stddev}}; }

/// Lines of YAML, and which keys they have.
class YamlLines {
 public:
  explicit YamlLines(const std::string& comment) : text_(comment) {}

  void add(const std::string& key, const std::string& value, const std::string& comment) {
    text_ += key + ": " + value + (comment.empty() ? "" : "  # " + comment) + "\n";
    written_.insert(key);
  }
  /// A key that stays empty, and why.
  void leave_out(const std::string& key, const std::string& reason) {
    text_ += "# " + key + " is not here: " + reason + "\n";
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

std::string vector_text(const Estimate (&axes)[3], double Estimate::*part) {
  std::string text;
  for (const Estimate& axis : axes) text += (text.empty() ? "[" : ", ") + format("%.5f", axis.*part);
  return text + "]";
}

void add_timing(const FootageCalibration& found, const std::string& key, YamlLines* yaml) {
  const TimingEstimate& e = *found.timing;
  const auto with_stddev = [](double stddev_s) {
    return stddev_s > 0 ? format("[s] +- %.6f", stddev_s) : std::string("[s] as given");
  };
  if (key == "time_offset") {
    yaml->add(key, format("%.6f", e.time_offset_s.value), with_stddev(e.time_offset_s.stddev));
  } else if (key == "readout_time") {
    const Estimate& readout_s = found.sensor_readout_s;
    const bool is_global = readout_s.stddev > 0 && is_global_shutter(readout_s);
    yaml->add(key, is_global ? "0" : format("%.6f", readout_s.value),
              with_stddev(readout_s.stddev) + (is_global ? ", global shutter" : ""));
  } else if (key == "gyro_bias") {
    const bool estimated = e.bias_rad_s[0].stddev > 0;
    yaml->add(key, vector_text(e.bias_rad_s, &Estimate::value),
              "[rad/s] " + (estimated ? "+- " + vector_text(e.bias_rad_s, &Estimate::stddev) : "as given"));
  } else if (key == "R_cam_imu" && found.rotation_from != "tf") {
    yaml->add(key, to_string(e.R_cam_imu),
              found.rotation_from == "estimated"
                  ? format("estimated, +- %.3f degrees", e.rotation_stddev_rad.maxCoeff() * kDegPerRad)
                  : found.rotation_from);
  }
}

void add_exposure(const FootageCalibration& found, const Verdict& verdict, YamlLines* yaml) {
  const bool by_images = found.exposure_from == ExposureSourceOfFootage::IMAGES;
  if (found.shutter.exposure_ns > 0) {
    const double exposure_s = to_seconds(found.shutter.exposure_ns);
    yaml->add(verdict.key, format("%.6f", exposure_s),
              by_images ? format("[s] +- %.6f", found.exposure.log_stddev * exposure_s) : "[s] as given");
  } else if (by_images || found.exposure_from == ExposureSourceOfFootage::UNKNOWN) {
    yaml->leave_out(verdict.key, verdict.text);
  }
}

/// What stamps mean, for which the estimates hold.
void add_shutter(const FootageCalibration& found, YamlLines* yaml) {
  yaml->add("stamp_row", name_of(found.shutter.stamp_row), "");
  yaml->add("stamp_phase", name_of(found.shutter.stamp_phase),
            found.offset_has_exposure ? "time_offset contains half of the exposure, which is not known" : "");
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

void report_timing(const FootageCalibration& found, nlohmann::json* report) {
  const TimingEstimate& e = *found.timing;
  (*report)["time_offset_s"] = to_json(e.time_offset_s);
  (*report)["readout_time_s"] = to_json(found.sensor_readout_s);
  (*report)["gyro_bias_rad_s"] = {to_json(e.bias_rad_s[0]), to_json(e.bias_rad_s[1]), to_json(e.bias_rad_s[2])};
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> by_rows = e.R_cam_imu;
  (*report)["R_cam_imu"] = std::vector<double>(by_rows.data(), by_rows.data() + by_rows.size());
  (*report)["rotation_from"] = found.rotation_from;
  (*report)["rotation_stddev_deg"] = to_json(Eigen::Vector3d(e.rotation_stddev_rad * kDegPerRad));
  (*report)["correlation"] = e.correlation;
  (*report)["pairs"] = e.pairs;
  (*report)["points"] = e.points;
  (*report)["speed_depths_s"] = e.speed_per_s;
  (*report)["median_residual_px"] = {{"without_gyroscope", e.median_without_px},
                                     {"before_refinement", e.median_at_start_px},
                                     {"estimated", e.median_px}};
  for (const RatePair& rate : e.rates) {
    (*report)["rates"].push_back(
        {{"t_ns", rate.t_ns}, {"image_rad_s", to_json(rate.image_rad_s)}, {"gyro_rad_s", to_json(rate.gyro_rad_s)}});
  }
  // Enough for a plot.
  constexpr std::size_t kMostResiduals = 5000;
  const std::size_t stride = e.residuals.size() / kMostResiduals + 1;
  for (std::size_t i = 0; i < e.residuals.size(); i += stride) {
    const TimingResidual& residual = e.residuals[i];
    (*report)["residuals"].push_back({{"row_px", residual.row_px},
                                      {"without_px", to_json(residual.without_px)},
                                      {"at_start_px", to_json(residual.at_start_px)},
                                      {"estimated_px", to_json(residual.estimated_px)}});
  }
}

nlohmann::json to_json(const RecordedExposure& exposure) {
  const auto or_null = [](const std::optional<TimeNs>& time_ns) {
    return time_ns ? nlohmann::json(to_seconds(*time_ns)) : nlohmann::json();
  };
  nlohmann::json report{{"estimates", exposure.estimates}, {"known", exposure.is_known}, {"varies", exposure.varies}};
  if (exposure.is_known) {
    report["value_s"] = to_seconds(exposure.exposure_ns);
    report["log_stddev"] = exposure.log_stddev;
    report["low_s"] = to_seconds(exposure.low_ns);
    report["high_s"] = to_seconds(exposure.high_ns);
  }
  for (const ImageExposure& image : exposure.images) {
    report["images"].push_back({{"stamp_ns", image.stamp_ns},
                                {"given_s", or_null(image.given_ns)},
                                {"estimate_s", or_null(image.estimate_ns)},
                                {"log_stddev", image.log_stddev},
                                {"filtered_s", or_null(image.filtered_ns)},
                                {"extent_px", image.extent_px}});
  }
  report["spectrum"] = nlohmann::json::array();
  for (const ExposureSpectrumPoint& point : exposure.spectrum) {
    report["spectrum"].push_back({{"waves", point.waves},
                                  {"log_power", point.log_power},
                                  {"log_of_path", point.log_of_path},
                                  {"count", point.count}});
  }
  return report;
}

}  // namespace

void print_summary(const FootageCalibration& found, const std::vector<Verdict>& verdicts) {
  for (const Verdict& verdict : verdicts) {
    const Verdict& first = *std::find_if(verdicts.begin(), verdicts.end(),
                                         [&verdict](const Verdict& other) { return other.text == verdict.text; });
    const bool repeats = verdict.state == VerdictState::OPEN && &first != &verdict;
    const std::string text = repeats ? "for the same reason as " + first.key : verdict.text;
    std::printf("%-13s %s\n              %s%s\n", verdict.key.c_str(),
                verdict.value.empty() ? "-" : verdict.value.c_str(),
                verdict.state == VerdictState::OPEN ? "NOT DETERMINED: " : "", text.c_str());
  }
  if (const std::optional<TimingEstimate>& estimate = found.timing) {
    std::printf(
        "%zu pairs of frames, %zu points; correlation of the angular speeds %.3f; translation %.2f depths/s on each "
        "axis; median residual %.2f px without gyroscope, %.2f px with it, %.2f px refined and with translation\n",
        estimate->pairs, estimate->points, estimate->correlation, estimate->speed_per_s, estimate->median_without_px,
        estimate->median_at_start_px, estimate->median_px);
  }
  std::fflush(stdout);
}

nlohmann::json report_of(const FootageCalibration& found, const std::vector<Verdict>& verdicts, const std::string& bag,
                         const FootageTopics& topics) {
  nlohmann::json report;
  report["bag"] = bag;
  report["topics"] = {{"image", topics.image.name},
                      {"camera_info", topics.camera_info},
                      {"imu", topics.imu},
                      {"exposure", topics.exposure}};
  for (const Verdict& verdict : verdicts) {
    report["verdicts"].push_back(
        {{"key", verdict.key}, {"value", verdict.value}, {"state", to_string(verdict.state)}, {"text", verdict.text}});
  }
  if (found.timing) report_timing(found, &report);
  report["exposure"] = to_json(found.exposure);
  return report;
}

std::string configuration_of(const FootageCalibration& found, const std::vector<Verdict>& verdicts,
                             const std::string& bag, bool everything, const std::string& config_path) {
  YamlLines yaml("# By calibrate from " + bag +
                 ".\n# Keys that are not here have the defaults of config/default.yaml.\n");
  for (const Verdict& verdict : verdicts) {
    if (verdict.key == "exposure_time") {
      add_exposure(found, verdict, &yaml);
    } else if (everything || verdict.state != VerdictState::OPEN) {
      add_timing(found, verdict.key, &yaml);
    } else {
      yaml.leave_out(verdict.key, verdict.text);
    }
  }
  add_shutter(found, &yaml);
  if (!config_path.empty()) add_configuration(config_path, &yaml);
  return yaml.text();
}

}  // namespace gyro_deblur
