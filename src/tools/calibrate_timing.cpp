// Clock offset, readout time, gyroscope bias and extrinsic rotation from a bag with motion.

#include <algorithm>
#include <exception>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "calibrate/timing_calibration.hpp"
#include "calibrate/timing_checks.hpp"
#include "gyro_deblur/config.hpp"
#include "ros/conversions.hpp"
#include "tools/bag_file.hpp"
#include "tools/config_file.hpp"
#include "tools/output_file.hpp"
#include "tools/timing_footage.hpp"
#include "tools/timing_report.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

struct Arguments {
  std::string bag, output, config;
  CommonArguments common;
  NamedFootage topics;
  FootageOptions footage;
  double search_s = 0.5;
  bool fixed_readout = false, fixed_bias = false, estimate_rotation = false, force = false;
};

TimingOptions options_of(const Arguments& arguments, const Config& config, const Footage& footage) {
  TimingOptions options;
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
  if (!arguments.estimate_rotation) options.R_cam_imu = config.R_cam_imu ? config.R_cam_imu : footage.R_cam_imu;
  return options;
}

void say(const std::string& text) { std::cerr << "calibrate_timing: warning: " << text << "\n"; }

/// The estimate, and in `objections` why it should not be used.
TimingResult estimate(const Arguments& arguments, const Config& config, const Footage& footage,
                      std::vector<std::string>* objections) {
  TimingOptions options = options_of(arguments, config, footage);
  const std::optional<OffsetStart> distant =
      start_of_distant_clocks(footage, options.time_offset_ns, options.search_ns);
  if (distant) {
    options.time_offset_ns = distant->time_offset_ns;
    options.search_ns = distant->search_ns;
    say(distant->problem + ": searching around " + std::to_string(to_seconds(options.time_offset_ns)) + " s");
  }
  TimingResult result;
  result.bag = arguments.bag;
  result.rotation_from = !options.R_cam_imu ? "estimated" : config.R_cam_imu ? "as configured" : "tf";
  result.estimate = estimate_timing(Camera(footage.camera), footage.windows, footage.samples, options);
  result.sensor_readout_s = {result.estimate.readout_s.value / footage.readout_part,
                             result.estimate.readout_s.stddev / footage.readout_part};
  *objections = timing_objections(result.estimate, options, footage.period);
  return result;
}

/// What the user should know before using the estimate.
void warn(const TimingEstimate& estimate, const Footage& footage) {
  constexpr double kLooseOffsetS = 1e-3, kLooseReadoutS = 2e-3, kLooseBiasRadS = 0.01;
  if (estimate.time_offset_s.stddev > kLooseOffsetS || estimate.readout_s.stddev > kLooseReadoutS ||
      std::max({estimate.bias_rad_s[0].stddev, estimate.bias_rad_s[1].stddev, estimate.bias_rad_s[2].stddev}) >
          kLooseBiasRadS) {
    say("the recording leaves a wide margin: record longer, with faster turns about all axes");
  }
  if (footage.without_exposure > 0) {
    say(std::to_string(footage.without_exposure) + " of " + std::to_string(footage.frames) +
        " images have no exposure time: time_offset contains half of it, use stamp_phase: middle with it");
  }
  if (footage.message_readout_ns) {
    say("the exposure messages bring a readout time of " + std::to_string(to_seconds(*footage.message_readout_ns)) +
        " s of their own, which holds before readout_time");
  }
}

void run(const Arguments& arguments) {
  const InputBag input(arguments.bag);
  Config config;
  if (!arguments.config.empty()) config = read_config("calibrate_timing", arguments.config);
  if (config.calibration) {
    for (const std::string& note : config.calibration->notes) say(note);
  }
  FootageTopics topics;
  Footage footage;
  TimingResult result;
  std::vector<std::string> objections;
  try {
    topics = choose_topics(input, arguments.topics, config);
    footage = read_footage(input, topics, arguments.footage, config);
    result = estimate(arguments, config, footage, &objections);
  } catch (const FrameError& error) {
    throw std::runtime_error(arguments.bag + ": " + topics.image.name + ": " + error.what());
  } catch (const std::exception& error) {
    throw std::runtime_error(arguments.bag + ": " + error.what());
  }
  print_summary(result);
  warn(result.estimate, footage);
  if (!objections.empty() && !arguments.force) {
    std::string text;
    for (const std::string& objection : objections) text += (text.empty() ? "" : "; ") + objection;
    throw std::runtime_error(arguments.bag + ": nothing is written (--force writes all the same): " + text);
  }
  for (const std::string& objection : objections) say(objection);
  write_json(arguments.common.json, report_of(result, topics), 1);
  if (!arguments.output.empty()) write_text(arguments.output, configuration_of(result, config, arguments.config));
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{
      "Estimates the time offset between camera and IMU, the readout time, the gyroscope's bias and, where neither the "
      "configuration nor tf has it, the rotation between the two, from a bag in which the camera turns about all axes. "
      "Topics that are not named are taken when the bag has exactly one of the type.",
      "calibrate_timing"};
  app.add_option("BAG", arguments.bag, "bag with images, camera_info and imu").required();
  app.add_option("--output", arguments.output, "configuration to write, for launch files and deblur_bag");
  app.add_option(
      "--config", arguments.config,
      "YAML file with the keys of config/default.yaml: what stamps mean, calibration_file, exposure_time and "
      "where the search begins");
  app.add_option("--search", arguments.search_s, "the time offset is at most this far from the configured one [0.5 s]")
      .range(0.0, 5.0);
  app.add_flag("--fixed-readout", arguments.fixed_readout, "readout_time is known: do not estimate it");
  app.add_flag("--fixed-bias", arguments.fixed_bias, "gyro_bias is known: do not estimate it");
  app.add_flag("--estimate-rotation", arguments.estimate_rotation,
               "estimate R_cam_imu from nothing although it is known");
  app.add_flag("--force", arguments.force, "write the values although the recording does not determine them");
  app.add_option("--points", arguments.footage.points, "of each image that are tracked in those after it [100]")
      .range(10, 10000);
  app.add_option("--start", arguments.footage.start_s, "[s] since the bag's first message [0]").not_negative();
  app.add_option("--end", arguments.footage.end_s, "[s] since the bag's first message [its end]").positive();
  add_image_options(app, &arguments.topics.images);
  app.add_option("--camera-info-topic", arguments.topics.camera_info,
                 "sensor_msgs/CameraInfo [camera_info beside the images]");
  app.add_option("--imu-topic", arguments.topics.imu, "sensor_msgs/Imu");
  app.add_option("--exposure-topic", arguments.topics.exposure,
                 "gyro_deblur/Exposure [exposure in --camera-ns, or beside the images]");
  app.footer("The JSON holds values and residuals, for plot_timing.py.");
  add_common_options(app, &arguments.common);
  return run_tool(app, argc, argv, [&arguments] {
    arguments.footage.quiet = arguments.common.quiet;
    run(arguments);
  });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
