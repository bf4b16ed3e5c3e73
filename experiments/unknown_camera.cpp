// What it costs to give less than everything about a camera: correct matches of deblurred frames with the sharp ones,
// of a flight through a room, deblurred as by the nodelet. Writes a table of doc/reports/timing.md.
#include <cstddef>
#include <cstdlib>
#include <iostream>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <boost/make_shared.hpp>
#include <opencv2/core.hpp>

#include "evaluation.hpp"
#include "footage.hpp"
#include "result_table.hpp"
#include "ros/conversions.hpp"
#include "ros/processor.hpp"
#include "tools/bag_messages.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  double seconds = 12, speed = 1.7, exposure_s = 0.03, readout_s = 0;
  std::size_t flight = 0;
  int step = 4;
  bool low_light = false, quiet = false;
};

constexpr double kFromS = 5;  // of which on matches are counted
constexpr int kFeatures = 1000;
constexpr double kMaxErrorPx = 3;
constexpr TimeNs kPeriodNs = 50'000'000;  // of Footage

struct Case {
  std::string name;
  bool rotation = true, timing_and_bias = true, intrinsics = true, exposure = true, imu = true;
};

struct Outcome {
  int matches = 0, frames = 0;             ///< of the frames that are counted
  int passed_through = 0;                  ///< of all
  std::optional<double> with_gyro_from_s;  ///< not by optical flow alone, nor passed through
  std::optional<double> focal_length;      ///< found, over the true one
};

/// Plays the flight into what the nodelet is made of. Everything arrives before it is waited for in vain.
Outcome outcome_of(const Arguments& arguments, Footage& footage, const Light& light, const Case& given,
                   const std::vector<Features>& sharp) {
  const sim::ImuModel& imu_model = footage.truth().scene().imu;
  Config config;
  config.given.time_offset = config.given.readout_time = config.given.gyro_bias = given.timing_and_bias;
  if (given.timing_and_bias) {
    config.shutter.readout_ns = to_ns(arguments.readout_s);
    config.gyro.time_offset_ns = imu_model.time_offset_ns;
    config.gyro.bias_rad_s = imu_model.gyro_bias_rad_s;
  }
  if (given.rotation) config.R_cam_imu = imu_model.R_cam_imu;
  if (given.exposure) config.shutter.exposure_ns = to_ns(arguments.exposure_s);
  TimeNs now_ns = 0;
  Processor::Environment environment;
  environment.clock = [&now_ns] { return now_ns; };
  environment.log = [](LogLevel, const std::string&) {};
  environment.request = [] {
    FrameRequest request;
    request.keypoints = false;
    return request;
  };
  Processor processor(std::move(environment));
  processor.set_config(config);

  Outcome outcome;
  const std::vector<sim::ImuSample> imu = footage.imu(footage.truth().scene().seed);
  sensor_msgs::CameraInfo info = camera_info_message(footage.camera().calibration());
  if (!given.intrinsics) info.K.fill(0);
  constexpr TimeNs kImuAheadNs = 100'000'000;
  std::size_t next = 0;
  for (int i = 0; i < footage.frames(); ++i) {
    const TimeNs stamp_ns = footage.truth().stamp(i);
    const cv::Mat image = footage.image(i, light);
    now_ns = stamp_ns;
    for (; given.imu && next < imu.size() && imu[next].t_ns <= footage.exposure(i).frame().end_ns + kImuAheadNs;
         ++next) {
      processor.add_imu(imu_message(make_header(to_ros_time(imu[next].t_ns), "imu"), imu[next].rate_rad_s,
                                    imu[next].specific_force_m_s2));
    }
    info.header = make_header(to_ros_time(stamp_ns), "camera");
    processor.add_image(boost::make_shared<sensor_msgs::Image>(image_message(info.header, image, "mono8")));
    processor.add_camera_info(boost::make_shared<sensor_msgs::CameraInfo>(info));
    now_ns += config.input_timeout_ns;
    processor.advance([&](FrameOutput&& output) {
      const double at_s = i * to_seconds(kPeriodNs);
      const bool deblurred = output.reason == PassThroughReason::NONE;
      if (!deblurred) ++outcome.passed_through;
      const bool by_gyro = deblurred && output.field && !output.field->images_alone;
      if (by_gyro && !outcome.with_gyro_from_s) outcome.with_gyro_from_s = at_s;
      if (at_s < kFromS || i % arguments.step != 0) return true;
      const sensor_msgs::Image& message = output.image ? *output.image : *output.input;
      const cv::Mat pixels(static_cast<int>(message.height), static_cast<int>(message.width), CV_8UC1,
                           const_cast<std::uint8_t*>(message.data.data()), message.step);
      MatchingOptions options;
      options.max_error_px = kMaxErrorPx;
      outcome.matches += evaluate_matching(sharp[static_cast<std::size_t>(i)], image.size(),
                                           extract_orb(pixels, kFeatures), Homography::eye(), options)
                             .correct;
      ++outcome.frames;
      return true;
    });
  }
  const auto found = processor.calibration_by_images();
  const CameraCalibration& truth = footage.camera().calibration();
  if (found && found->calibration.focal_length.known) {
    outcome.focal_length = found->calibration.focal_length.value * truth.width_px / truth.fx_px;
  }
  return outcome;
}

void run(const Arguments& arguments) {
  const Light light = arguments.low_light ? kLowLight : kDaylight;
  FootageCase flight;
  flight.flight = test::recorded_flights().at(arguments.flight);
  flight.exposure_ns = to_ns(arguments.exposure_s);
  flight.readout_ns = to_ns(arguments.readout_s);
  flight.speed = arguments.speed;
  Footage footage(flight, arguments.data, arguments.seconds);
  std::vector<Features> sharp(static_cast<std::size_t>(footage.frames()));
  for (int i = 0; i < footage.frames(); ++i) {
    if (i % arguments.step == 0) sharp[static_cast<std::size_t>(i)] = extract_orb(footage.sharp(i, light), kFeatures);
  }
  const std::vector<Case> cases{{"everything"},
                                {"all but the rotation", false},
                                {"intrinsics and exposure time", false, false},
                                {"exposure time", false, false, false},
                                {"nothing", false, false, false, false},
                                {"exposure time, no IMU", false, false, false, true, false}};
  ResultTable table({"given", "matches from 5 s on", "of those with everything [%]", "gyroscope used from [s]",
                     "focal length, of the true one [%]", "images passed through"});
  Progress progress(cases.size(), "cases", arguments.quiet);
  std::size_t done = 0;
  double all = 0;
  for (const Case& given : cases) {
    const Outcome outcome = outcome_of(arguments, footage, light, given, sharp);
    const double mean = outcome.frames > 0 ? outcome.matches / static_cast<double>(outcome.frames) : 0;
    if (done == 0) all = mean;
    table.add({given.name, text_of(mean, 0), text_of(100 * mean / all, 1),
               outcome.with_gyro_from_s ? text_of(*outcome.with_gyro_from_s, 2) : "-",
               outcome.focal_length ? text_of(100 * *outcome.focal_length, 0) : "-",
               std::to_string(outcome.passed_through)});
    progress.done(++done);
  }
  std::cout << flight.conditions() << ", " << (arguments.low_light ? "low light" : "day") << ", " << footage.frames()
            << " images\n"
            << table.markdown();
  if (!arguments.output.empty()) table.write(arguments.output, "unknown_camera");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"What it costs to give less than everything about a camera.", "unknown_camera"};
  app.add_option("--out", arguments.output, "folder for the table");
  app.add_option("--data", arguments.data, "recorded data, with trajectories/");
  app.add_option("--flight", arguments.flight, "number of the recorded flight, 0 to 2 [0]");
  app.add_option("--seconds", arguments.seconds, "of the flight, more than 5 [12]");
  app.add_option("--speed", arguments.speed, "factor on the flight's [1.7]");
  app.add_option("--exposure", arguments.exposure_s, "[s] [0.03]");
  app.add_option("--readout", arguments.readout_s, "[s] [0]");
  app.add_option("--step", arguments.step, "compare matches of every n-th frame [4]");
  app.add_flag("--low-light", arguments.low_light, "contrast .35, noise 4");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
