// Time offset, readout time, exposure time, gyroscope bias and extrinsic rotation from a bag with motion.

#include <exception>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "gyro_deblur/config.hpp"
#include "ros/conversions.hpp"
#include "tools/bag_file.hpp"
#include "tools/calibration_report.hpp"
#include "tools/calibration_verdicts.hpp"
#include "tools/footage_calibration.hpp"
#include "tools/output_file.hpp"
#include "tools/timing_footage.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

struct Arguments {
  std::string bag, output, config;
  CommonArguments common;
  NamedFootage topics;
  FootageOptions footage;
  double search_s = 0.5;
  FootageCalibrationOptions calibration;
  bool force = false;
};

void say(const std::string& text) { std::cerr << "calibrate: warning: " << text << "\n"; }

void run(const Arguments& arguments) {
  const InputBag input(arguments.bag);
  Config config;
  if (!arguments.config.empty()) {
    config = read_config("calibrate", arguments.config);
  } else {
    config.given = {false, false, false, false};  // the default is that of a configuration made in code
  }
  if (config.calibration) {
    for (const std::string& note : config.calibration->notes) say(note);
  }
  FootageTopics topics;
  Footage footage;
  FootageCalibration found;
  try {
    topics = choose_topics(input, arguments.topics, config);
    footage = read_footage(input, topics, arguments.footage, config);
    found = calibrate_footage(input, topics, arguments.footage, footage, config, arguments.calibration);
  } catch (const FrameError& error) {
    throw std::runtime_error(arguments.bag + ": " + topics.image.name + ": " + error.what());
  } catch (const std::exception& error) {
    throw std::runtime_error(arguments.bag + ": " + error.what());
  }
  const std::vector<Verdict> verdicts = verdicts_of(found, footage.frames);
  print_summary(found, verdicts);
  for (const std::string& warning : found.warnings) say(warning);
  write_json(arguments.common.json, report_of(found, verdicts, arguments.bag, topics), 1);
  const std::string refusal = found.refusal();
  if (!found.timing) throw std::runtime_error(arguments.bag + ": nothing is written: " + refusal);
  if (!refusal.empty() && !arguments.force) {
    throw std::runtime_error(arguments.bag + ": nothing is written (--force writes all the same): " + refusal);
  }
  for (const TimingObjection& objection : found.objections) say(objection.text);
  if (!arguments.output.empty()) {
    write_text(arguments.output, configuration_of(found, verdicts, arguments.bag, arguments.force, arguments.config));
  }
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{
      "Estimates the time offset between camera and IMU, the readout time, the exposure time, the gyroscope's bias "
      "and, where neither the configuration nor tf has it, the rotation between the two, from a bag in which the "
      "camera rotates about all axes. Says of each number how well it is known, or why the bag does not determine it. "
      "Topics that are not named are taken when the bag has exactly one of the type.",
      "calibrate"};
  app.add_option("BAG", arguments.bag, "bag with images, camera_info and imu").required();
  app.add_option("--output", arguments.output, "configuration to write, for launch files and deblur_bag");
  app.add_option(
      "--config", arguments.config,
      "YAML file with the keys of config/default.yaml: what stamps mean, calibration_file, exposure_time and "
      "where the search begins");
  app.add_option("--search", arguments.search_s, "the time offset is at most this far from the configured one [0.5 s]")
      .range(0.0, 5.0);
  app.add_flag("--fixed-readout", arguments.calibration.fixed_readout, "readout_time is known: do not estimate it");
  app.add_flag("--fixed-bias", arguments.calibration.fixed_bias, "gyro_bias is known: do not estimate it");
  app.add_flag("--estimate-rotation", arguments.calibration.estimate_rotation,
               "estimate R_cam_imu from nothing although it is known");
  app.add_flag("--force", arguments.force, "write values that the recording does not determine");
  app.add_option("--points", arguments.footage.points, "of each image that are tracked in those after it [100]")
      .range(10, 10000);
  app.add_option("--start", arguments.footage.start_s, "[s] since the bag's first message [0]").not_negative();
  app.add_option("--end", arguments.footage.end_s, "[s] since the bag's first message [its end]").positive();
  add_image_options(app, &arguments.topics.images);
  app.add_option("--camera-info-topic", arguments.topics.camera_info,
                 "sensor_msgs/CameraInfo [camera_info next to the images]");
  app.add_option("--imu-topic", arguments.topics.imu, "sensor_msgs/Imu");
  app.add_option("--exposure-topic", arguments.topics.exposure,
                 "gyro_deblur/Exposure [exposure in --camera-ns, or next to the images]");
  app.footer(
      "The JSON holds values, verdicts and residuals, for plot_calibration.py. It is also written if the bag is "
      "refused.");
  add_common_options(app, &arguments.common);
  return run_tool(app, argc, argv, [&arguments] {
    arguments.footage.quiet = arguments.common.quiet;
    arguments.calibration.search_ns = to_ns(arguments.search_s);
    run(arguments);
  });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
