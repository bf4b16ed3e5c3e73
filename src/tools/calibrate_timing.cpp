// calibrate_timing: clock offset, readout time, gyroscope bias and extrinsic rotation from a bag with motion.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>
#include <yaml-cpp/yaml.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "calibrate/frame_tracker.hpp"
#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/overlay.hpp"
#include "ros/conversions.hpp"
#include "ros/messages.hpp"
#include "tools/bag_reading.hpp"
#include "tools/bag_topics.hpp"
#include "tools/progress.hpp"

namespace gyro_deblur {
namespace {

constexpr int kBadInput = 1, kBadUsage = 2;
constexpr double kDegPerRad = 180 / M_PI;

struct Arguments {
  std::string bag, output, config, json;
  std::string image_topic, camera_info_topic, imu_topic, exposure_topic;
  double search_s = 0.5;
  double start_s = 0;
  std::optional<double> end_s;
  int points = 100;
  bool fixed_readout = false, fixed_bias = false, estimate_rotation = false;
  bool quiet = false;
};

struct Topics {
  std::string image, imu;
  std::string camera_info, exposure;  // empty: none
};

/// What a bag holds that the estimation needs.
struct Footage {
  CameraCalibration camera;
  double readout_part = 1;  ///< of the sensor's readout that the image's region of interest takes
  std::vector<FramePair> pairs;
  std::vector<GyroSample> samples;
  std::optional<Eigen::Matrix3d> R_cam_imu;  ///< of tf
  std::size_t frames = 0;
  std::size_t without_exposure = 0;
  std::optional<TimeNs> message_readout_ns;  ///< of exposure messages
  FramePeriod period;
};

Topics choose_topics(const Arguments& arguments, const std::map<std::string, std::string>& topics, bool info_required) {
  Topics chosen;
  chosen.image = choose_topic(topics, "images", "sensor_msgs/Image", arguments.image_topic, "", true);
  const std::string ns = parent_namespace(chosen.image);
  chosen.camera_info = choose_topic(topics, "camera_info", "sensor_msgs/CameraInfo", arguments.camera_info_topic,
                                    ns + "/camera_info", info_required);
  chosen.imu = choose_topic(topics, "imu", "sensor_msgs/Imu", arguments.imu_topic, "", true);
  chosen.exposure =
      choose_topic(topics, "exposure", "gyro_deblur/Exposure", arguments.exposure_topic, ns + "/exposure", false);
  return chosen;
}

/// Exposure times of the whole bag, by stamp.
std::map<TimeNs, Exposure> read_exposures(rosbag::Bag& bag, const std::string& topic) {
  std::map<TimeNs, Exposure> exposures;
  if (topic.empty()) return exposures;
  rosbag::View view(bag, rosbag::TopicQuery(topic));
  for (const rosbag::MessageInstance& instance : view) {
    if (const auto message = read_message<Exposure>(instance)) {
      exposures[to_time_ns(message->header.stamp)] = *message;
    }
  }
  return exposures;
}

std::vector<GyroSample> read_gyro(rosbag::Bag& bag, const std::string& topic, std::string* frame) {
  std::vector<GyroSample> samples;
  rosbag::View view(bag, rosbag::TopicQuery(topic));
  for (const rosbag::MessageInstance& instance : view) {
    const auto imu = read_message<sensor_msgs::Imu>(instance);
    if (!imu) continue;
    const std::optional<GyroSample> sample = to_gyro_sample(*imu);
    if (!sample || !sample->rate_rad_s.allFinite()) continue;
    *frame = imu->header.frame_id;
    samples.push_back(*sample);
  }
  // Messages of a bag are in the order of their arrival.
  const auto earlier = [](const GyroSample& a, const GyroSample& b) { return a.t_ns < b.t_ns; };
  std::stable_sort(samples.begin(), samples.end(), earlier);
  samples.erase(std::unique(samples.begin(), samples.end(),
                            [](const GyroSample& a, const GyroSample& b) { return a.t_ns == b.t_ns; }),
                samples.end());
  return samples;
}

CameraCalibration camera_of(const sensor_msgs::Image& image, rosbag::Bag& bag, const Topics& topics,
                            const Config& config, double* readout_part) {
  const int width = static_cast<int>(image.width), height = static_cast<int>(image.height);
  const bool from_file = config.calibration && config.calibration->camera && !config.rectified_input;
  sensor_msgs::CameraInfo info;
  if (from_file) info = camera_info_message(*config.calibration->camera);
  if (!topics.camera_info.empty()) {
    rosbag::View view(bag, rosbag::TopicQuery(topics.camera_info));
    const auto first = view.size() == 0 ? nullptr : read_message<sensor_msgs::CameraInfo>(*view.begin());
    if (first && !from_file) info = *first;
    if (first && from_file) {
      info.roi = first->roi;
      info.binning_x = first->binning_x;
      info.binning_y = first->binning_y;
    }
  }
  const CameraCalibration camera = to_calibration(info, width, height, config.rectified_input);
  constexpr TimeNs kWhole = 1'000'000'000;
  *readout_part = to_seconds(region_readout_ns(kWhole, info)) / to_seconds(kWhole);
  return camera;
}

Footage read_footage(rosbag::Bag& bag, const Topics& topics, const Arguments& arguments, const Config& config) {
  Footage footage;
  std::string imu_frame, camera_frame;
  footage.samples = read_gyro(bag, topics.imu, &imu_frame);
  const std::map<TimeNs, Exposure> exposures = read_exposures(bag, topics.exposure);

  rosbag::View whole(bag);
  const ros::Time begin = whole.getBeginTime() + ros::Duration(arguments.start_s);
  const ros::Time end = arguments.end_s ? whole.getBeginTime() + ros::Duration(*arguments.end_s) : ros::TIME_MAX;
  rosbag::View view(bag, rosbag::TopicQuery(topics.image), begin, end);
  Progress progress(std::max<std::size_t>(view.size(), 1), "images", arguments.quiet);
  FrameTrackerOptions tracker_options;
  tracker_options.max_points = arguments.points;
  FrameTracker tracker(tracker_options);
  std::optional<FrameTime> last;
  for (const rosbag::MessageInstance& instance : view) {
    const auto image = read_message<sensor_msgs::Image>(instance);
    if (!image) continue;
    const ImageView pixels = view_image(*image);
    if (footage.frames == 0) {
      footage.camera = camera_of(*image, bag, topics, config, &footage.readout_part);
      camera_frame = image->header.frame_id;
    }
    FrameTime now{to_time_ns(image->header.stamp), config.shutter.exposure_ns};
    const auto exposure = exposures.find(now.stamp_ns);
    if (exposure != exposures.end()) {
      now.exposure_ns = exposure->second.exposure_time.toNSec();
      if (!exposure->second.readout_time.isZero()) {
        footage.message_readout_ns = exposure->second.readout_time.toNSec();
      }
    }
    if (now.exposure_ns == 0) ++footage.without_exposure;
    std::vector<PointPair> points = tracker.next(luminance8(pixels.image, pixels.layout));
    // Across lost frames the motion is too large to be followed.
    constexpr TimeNs kLongestStep = 250'000'000;
    if (last && now.stamp_ns > last->stamp_ns && now.stamp_ns - last->stamp_ns <= kLongestStep) {
      footage.pairs.push_back({*last, now, std::move(points)});
    }
    last = now;
    footage.period.add(now.stamp_ns);
    progress.done(++footage.frames);
  }

  tf2::BufferCore tf_buffer;
  rosbag::View transforms(bag, rosbag::TopicQuery(std::vector<std::string>{"/tf", "/tf_static"}));
  for (const rosbag::MessageInstance& instance : transforms) {
    if (const auto message = read_message<tf2_msgs::TFMessage>(instance)) add_transforms(*message, &tf_buffer);
  }
  footage.R_cam_imu = lookup_R_cam_imu(tf_buffer, camera_frame, imu_frame);
  return footage;
}

nlohmann::json to_json(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }
nlohmann::json to_json(const Eigen::Vector2d& v) { return {v.x(), v.y()}; }

nlohmann::json report_of(const Arguments& arguments, const Topics& topics, const TimingEstimate& e,
                         const std::string& rotation_from) {
  nlohmann::json report;
  report["bag"] = arguments.bag;
  report["topics"] = {
      {"image", topics.image}, {"camera_info", topics.camera_info}, {"imu", topics.imu}, {"exposure", topics.exposure}};
  const auto value = [](const Estimate& v) { return nlohmann::json{{"value", v.value}, {"stddev", v.stddev}}; };
  report["time_offset_s"] = value(e.time_offset_s);
  report["readout_time_s"] = value(e.readout_s);
  report["gyro_bias_rad_s"] = {value(e.bias_rad_s[0]), value(e.bias_rad_s[1]), value(e.bias_rad_s[2])};
  report["R_cam_imu"] = nlohmann::json::array();
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 3; ++col) report["R_cam_imu"].push_back(e.R_cam_imu(row, col));
  }
  report["rotation_from"] = rotation_from;
  report["rotation_stddev_deg"] = to_json(Eigen::Vector3d(e.rotation_stddev_rad * kDegPerRad));
  report["correlation"] = e.correlation;
  report["pairs"] = e.pairs;
  report["points"] = e.points;
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

std::string text_of(const char* format, double a, double b) {
  char text[100];
  std::snprintf(text, sizeof(text), format, a, b);
  return text;
}

/// The configuration that the launch files and deblur_bag read: that of --config, with what was estimated.
std::string yaml_of(const Arguments& arguments, const Config& config, const TimingEstimate& e,
                    const Estimate& sensor_readout_s, const std::string& rotation_from) {
  std::string yaml = "# By calibrate_timing from " + arguments.bag +
                     ".\n# Keys that are not here have the defaults of config/default.yaml.\n";
  std::set<std::string> written;
  const auto add = [&](const std::string& key, const std::string& value, const std::string& comment) {
    yaml += key + ": " + value + (comment.empty() ? "" : "  # " + comment) + "\n";
    written.insert(key);
  };
  add("time_offset", text_of("%.6f", e.time_offset_s.value, 0), text_of("[s] +- %.6f", e.time_offset_s.stddev, 0));
  add("readout_time", text_of("%.6f", sensor_readout_s.value, 0),
      sensor_readout_s.stddev > 0 ? text_of("[s] +- %.6f", sensor_readout_s.stddev, 0) : "[s] as given");
  std::string bias, stddev;
  for (const Estimate& axis : e.bias_rad_s) {
    bias += (bias.empty() ? "[" : ", ") + text_of("%.5f", axis.value, 0);
    stddev += (stddev.empty() ? "[" : ", ") + text_of("%.5f", axis.stddev, 0);
  }
  add("gyro_bias", bias + "]", "[rad/s] " + (e.bias_rad_s[0].stddev > 0 ? "+- " + stddev + "]" : "as given"));
  if (rotation_from != "tf") {
    add("R_cam_imu", to_string(e.R_cam_imu),
        rotation_from == "estimated"
            ? text_of("estimated, +- %.3f degrees", e.rotation_stddev_rad.maxCoeff() * kDegPerRad, 0)
            : rotation_from);
  }
  const char* const rows[] = {"first", "middle", "last"};
  const char* const phases[] = {"start", "middle", "end"};
  add("stamp_row", rows[static_cast<int>(config.shutter.stamp_row)], "");
  add("stamp_phase", phases[static_cast<int>(config.shutter.stamp_phase)], "");
  if (config.shutter.exposure_ns > 0) {
    add("exposure_time", text_of("%.6f", to_seconds(config.shutter.exposure_ns), 0), "[s] as given");
  }
  if (arguments.config.empty()) return yaml;
  YAML::Node given = YAML::LoadFile(arguments.config);
  if (YAML::Node files = given["calibration_file"]; files && !files.IsNull()) {
    const std::filesystem::path folder = std::filesystem::absolute(arguments.config).parent_path();
    const auto make_absolute = [&folder](YAML::Node path) {
      if (path.IsScalar() && !path.Scalar().empty()) path = (folder / path.Scalar()).lexically_normal().string();
    };
    if (files.IsSequence()) {
      for (YAML::Node file : files) make_absolute(file);
    } else {
      make_absolute(files);
    }
    add("on_calibration_conflict", "configured", "what was estimated holds against calibration_file");
  }
  yaml += "\n# From " + arguments.config + "\n";
  for (const auto& entry : given) {
    if (written.count(entry.first.Scalar()) != 0) continue;
    YAML::Node single;
    single[entry.first.Scalar()] = entry.second;
    yaml += YAML::Dump(single) + "\n";
  }
  return yaml;
}

void run(const Arguments& arguments) {
  if (!std::filesystem::is_regular_file(arguments.bag)) throw std::runtime_error(arguments.bag + ": no such file");
  Config config;
  if (!arguments.config.empty()) config = load_config(arguments.config);
  rosbag::Bag bag;
  try {
    bag.open(arguments.bag, rosbag::bagmode::Read);
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(arguments.bag + ": not a bag that can be read: " + error.what());
  }
  Topics topics;
  Footage footage;
  std::string rotation_from = "estimated";
  TimingOptions options;
  TimingEstimate estimate;
  try {
    const bool info_required = !config.calibration || !config.calibration->camera;
    topics = choose_topics(arguments, topics_of(bag), info_required);
    require_definition<sensor_msgs::Image>(bag, topics.image);
    require_definition<sensor_msgs::Imu>(bag, topics.imu);
    if (!topics.camera_info.empty()) require_definition<sensor_msgs::CameraInfo>(bag, topics.camera_info);
    if (!topics.exposure.empty()) require_definition<Exposure>(bag, topics.exposure);
    footage = read_footage(bag, topics, arguments, config);
    if (footage.frames == 0) throw std::runtime_error("no image on " + topics.image);

    options.stamp_row = config.shutter.stamp_row;
    options.stamp_phase = config.shutter.stamp_phase;
    options.time_offset_ns = config.gyro.time_offset_ns;
    options.search_ns = to_ns(arguments.search_s);
    options.readout_ns = to_ns(to_seconds(config.shutter.readout_ns) * footage.readout_part);
    options.estimate_readout = !arguments.fixed_readout;
    options.estimate_bias = !arguments.fixed_bias;
    options.bias_rad_s = config.gyro.bias_rad_s;
    options.max_gap_ns = config.gyro.max_gap_ns;
    options.gyro_range_rad_s = config.gyro.range_rad_s;
    if (!arguments.estimate_rotation) {
      options.R_cam_imu = config.R_cam_imu ? config.R_cam_imu : footage.R_cam_imu;
      if (options.R_cam_imu) rotation_from = config.R_cam_imu ? "as configured" : "tf";
    }
    estimate = estimate_timing(Camera(footage.camera), footage.pairs, footage.samples, options);
  } catch (const FrameError& error) {
    throw std::runtime_error(arguments.bag + ": " + topics.image + ": " + error.what());
  } catch (const std::exception& error) {
    throw std::runtime_error(arguments.bag + ": " + error.what());
  }
  const Estimate sensor_readout_s{estimate.readout_s.value / footage.readout_part,
                                  estimate.readout_s.stddev / footage.readout_part};

  std::printf("time_offset   %+.6f +- %.6f s   (t_imu = t_cam + time_offset)\n", estimate.time_offset_s.value,
              estimate.time_offset_s.stddev);
  std::printf("readout_time  %+.6f +- %.6f s\n", sensor_readout_s.value, sensor_readout_s.stddev);
  std::printf("gyro_bias     [%+.5f, %+.5f, %+.5f] +- [%.5f, %.5f, %.5f] rad/s\n", estimate.bias_rad_s[0].value,
              estimate.bias_rad_s[1].value, estimate.bias_rad_s[2].value, estimate.bias_rad_s[0].stddev,
              estimate.bias_rad_s[1].stddev, estimate.bias_rad_s[2].stddev);
  std::printf("R_cam_imu     %s", to_string(estimate.R_cam_imu).c_str());
  if (rotation_from == "estimated") {
    const Eigen::Vector3d stddev_deg = estimate.rotation_stddev_rad * kDegPerRad;
    std::printf(" +- [%.3f, %.3f, %.3f] degrees about the camera's axes\n", stddev_deg.x(), stddev_deg.y(),
                stddev_deg.z());
  } else {
    std::printf(" (%s)\n", rotation_from.c_str());
  }
  std::printf(
      "%zu pairs of frames, %zu points; correlation of the angular speeds %.3f; median residual %.2f px without "
      "gyroscope, %.2f px with it, %.2f px refined\n",
      estimate.pairs, estimate.points, estimate.correlation, estimate.median_without_px, estimate.median_at_start_px,
      estimate.median_px);
  std::fflush(stdout);

  const auto warn = [](const std::string& text) { std::cerr << "calibrate_timing: warning: " << text << "\n"; };
  constexpr double kLooseOffsetS = 1e-3, kLooseReadoutS = 2e-3, kLooseBiasRadS = 0.01;
  if (estimate.time_offset_s.stddev > kLooseOffsetS || estimate.readout_s.stddev > kLooseReadoutS ||
      std::max({estimate.bias_rad_s[0].stddev, estimate.bias_rad_s[1].stddev, estimate.bias_rad_s[2].stddev}) >
          kLooseBiasRadS) {
    warn("the recording leaves a wide margin: record longer, with faster turns about all axes and less translation");
  }
  if (footage.without_exposure > 0) {
    warn(std::to_string(footage.without_exposure) + " of " + std::to_string(footage.frames) +
         " images have no exposure time: time_offset contains half of it, use stamp_phase: middle with it");
  }
  if (footage.message_readout_ns) {
    warn("the exposure messages bring a readout time of " + std::to_string(to_seconds(*footage.message_readout_ns)) +
         " s of their own, which holds before readout_time");
  }
  if (const std::optional<TimeNs> period_ns = footage.period.get()) {
    try {
      require_plausible_readout("readout_time", to_ns(estimate.readout_s.value), *period_ns);
    } catch (const OptionError& error) {
      warn(error.what());
    }
  }

  if (!arguments.json.empty()) {
    std::ofstream file(arguments.json);
    file << report_of(arguments, topics, estimate, rotation_from).dump(1) << "\n";
    if (!file.flush()) throw std::runtime_error(arguments.json + ": cannot be written");
  }
  if (!arguments.output.empty()) {
    std::ofstream file(arguments.output);
    file << yaml_of(arguments, config, estimate, sensor_readout_s, rotation_from);
    if (!file.flush()) throw std::runtime_error(arguments.output + ": cannot be written");
  }
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CLI::App app{
      "Estimates the time offset between camera and IMU, the readout time, the gyroscope's bias and, where neither the "
      "configuration nor tf has it, the rotation between the two, from a bag in which the camera turns about all axes. "
      "Topics that are not named are taken when the bag has exactly one of the type.",
      "calibrate_timing"};
  app.add_option("BAG", arguments.bag, "bag with images, camera_info and imu")->required();
  app.add_option("--output", arguments.output, "configuration to write, for launch files and deblur_bag");
  app.add_option(
      "--config", arguments.config,
      "YAML file with the keys of config/default.yaml: what stamps mean, calibration_file, exposure_time and "
      "where the search begins");
  app.add_option("--search", arguments.search_s, "the time offset is at most this far from the configured one [0.5 s]")
      ->check(CLI::Range(0.0, 5.0));
  app.add_flag("--fixed-readout", arguments.fixed_readout, "readout_time is known: do not estimate it");
  app.add_flag("--fixed-bias", arguments.fixed_bias, "gyro_bias is known: do not estimate it");
  app.add_flag("--estimate-rotation", arguments.estimate_rotation,
               "estimate R_cam_imu from nothing although it is known");
  app.add_option("--points", arguments.points, "tracked in each pair of images [100]")->check(CLI::Range(10, 10000));
  app.add_option("--start", arguments.start_s, "[s] since the bag's first message [0]")->check(CLI::NonNegativeNumber);
  app.add_option("--end", arguments.end_s, "[s] since the bag's first message [its end]")->check(CLI::PositiveNumber);
  app.add_option("--image-topic", arguments.image_topic, "sensor_msgs/Image");
  app.add_option("--camera-info-topic", arguments.camera_info_topic,
                 "sensor_msgs/CameraInfo [camera_info beside the images]");
  app.add_option("--imu-topic", arguments.imu_topic, "sensor_msgs/Imu");
  app.add_option("--exposure-topic", arguments.exposure_topic, "gyro_deblur/Exposure [exposure beside the images]");
  app.add_option("--json", arguments.json, "write values and residuals as JSON, for plot_timing.py");
  app.add_flag("--quiet", arguments.quiet, "no progress on stderr");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kBadUsage;
  }
  try {
    run(arguments);
  } catch (const std::exception& error) {
    std::cerr << "calibrate_timing: " << error.what() << "\n";
    return kBadInput;
  }
  return 0;
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
