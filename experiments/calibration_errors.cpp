// What a wrong number costs, and none at all: correct matches of deblurred frames with the sharp ones, of a flight
// through a room, deblurred as by the nodelet. Writes the tables of doc/reports/calibration_errors.md.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <iostream>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <boost/make_shared.hpp>
#include <opencv2/core.hpp>

#include "evaluation.hpp"
#include "footage.hpp"
#include "gyro_deblur/config.hpp"
#include "pipeline/exposure_choice.hpp"
#include "result_table.hpp"
#include "ros/conversions.hpp"
#include "ros/processor.hpp"
#include "tools/bag_messages.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output, part = "all";
  double seconds = 12, speed = 1.7, exposure_s = 0.03, readout_s = 0;
  std::size_t flight = 0;
  int step = 4;
  bool low_light = false, quiet = false;
};

constexpr double kFromS = 5;  // of which on matches are counted
constexpr int kFeatures = 1000;
constexpr double kMaxErrorPx = 3;
constexpr TimeNs kPeriodNs = 50'000'000;  // of Footage

/// What a user gives: everything, and right, but for what change() changes.
struct Given {
  Config config;
  sensor_msgs::CameraInfo info;
  bool imu = true;
};
struct Case {
  std::string name;
  std::function<void(Given*)> change;
};

struct Outcome {
  int matches = 0, frames = 0;                  ///< of the frames that are counted
  int passed_through = 0;                       ///< of all
  std::optional<double> with_gyro_from_s;       ///< not by optical flow alone, nor passed through
  std::optional<double> right_exposure_from_s;  ///< the one in use is within 5 % of the true one from then on
  std::optional<double> focal_length;           ///< found, over the true one
};

void forget_timing_and_bias(Given* given) {
  GivenNumbers& numbers = given->config.given;
  numbers.time_offset = numbers.readout_time = numbers.gyro_bias = false;
  given->config.shutter.readout_ns = given->config.gyro.time_offset_ns = 0;
  given->config.gyro.bias_rad_s.setZero();
}
void keep_intrinsics_and_exposure(Given* given) {
  given->config.R_cam_imu.reset();
  forget_timing_and_bias(given);
}
void keep_exposure(Given* given) {
  keep_intrinsics_and_exposure(given);
  given->info.K.fill(0);
}
void scale_exposure(double factor, Given* given) {
  TimeNs& exposure_ns = given->config.shutter.exposure_ns;
  exposure_ns = std::llround(factor * static_cast<double>(exposure_ns));
}

std::vector<Case> missing_numbers() {
  return {{"all but the rotation", [](Given* given) { given->config.R_cam_imu.reset(); }},
          {"intrinsics and exposure time", keep_intrinsics_and_exposure},
          {"exposure time", keep_exposure},
          {"all but the exposure time", [](Given* given) { scale_exposure(0, given); }},
          {"nothing",
           [](Given* given) {
             keep_exposure(given);
             scale_exposure(0, given);
           }},
          {"exposure time, no IMU", [](Given* given) {
             keep_exposure(given);
             given->imu = false;
           }}};
}

std::vector<Case> wrong_exposures() {
  std::vector<Case> cases;
  for (const double factor : {0.5, 0.6, 0.8, 0.9, 1.1, 1.25, 1.6, 2.0}) {
    cases.push_back({"exposure_time x" + text_of(factor, 2), [=](Given* given) { scale_exposure(factor, given); }});
  }
  for (const double factor : {0.6, 0.9, 1.1, 1.6}) {
    cases.push_back({"exposure_time x" + text_of(factor, 2) + ", on_exposure_conflict: configured", [=](Given* given) {
                       scale_exposure(factor, given);
                       given->config.on_exposure_conflict = OnExposureConflict::CONFIGURED;
                     }});
  }
  return cases;
}

std::vector<Case> wrong_numbers() {
  std::vector<Case> cases;
  for (const int offset_ms : {2, 5, 10, 20, 40}) {
    cases.push_back({"time_offset + " + std::to_string(offset_ms) + " ms",
                     [=](Given* given) { given->config.gyro.time_offset_ns += to_ns(1e-3 * offset_ms); }});
  }
  for (const int readout_ms : {5, 10, 20}) {
    cases.push_back({"readout_time + " + std::to_string(readout_ms) + " ms",
                     [=](Given* given) { given->config.shutter.readout_ns += to_ns(1e-3 * readout_ms); }});
  }
  for (const int degrees : {2, 5, 15, 90}) {
    cases.push_back({"R_cam_imu about (1, 1, 1) by " + std::to_string(degrees) + " degrees", [=](Given* given) {
                       const Eigen::AngleAxisd turn(degrees * CV_PI / 180, Eigen::Vector3d::Ones().normalized());
                       given->config.R_cam_imu = turn.toRotationMatrix() * *given->config.R_cam_imu;
                     }});
  }
  for (const double bias_rad_s : {0.02, 0.1, 0.3}) {
    cases.push_back({"gyro_bias + " + text_of(bias_rad_s, 2) + " rad/s on each axis",
                     [=](Given* given) { given->config.gyro.bias_rad_s.array() += bias_rad_s; }});
  }
  for (const double factor : {0.8, 0.9, 1.1, 1.25}) {
    cases.push_back({"focal length x" + text_of(factor, 2), [=](Given* given) {
                       given->info.K[0] *= factor;
                       given->info.K[4] *= factor;
                     }});
  }
  return cases;
}

Given everything_right(const Arguments& arguments, const Footage& footage) {
  const sim::ImuModel& imu = footage.truth().scene().imu;
  Given given;
  given.config.shutter.readout_ns = to_ns(arguments.readout_s);
  given.config.shutter.exposure_ns = to_ns(arguments.exposure_s);
  given.config.gyro.time_offset_ns = imu.time_offset_ns;
  given.config.gyro.bias_rad_s = imu.gyro_bias_rad_s;
  given.config.R_cam_imu = imu.R_cam_imu;
  given.info = camera_info_message(footage.camera().calibration());
  return given;
}

/// Plays the flight into what the nodelet is made of. Everything arrives before it is waited for in vain.
Outcome outcome_of(const Arguments& arguments, Footage& footage, const Light& light, const Case& each,
                   const std::vector<Features>& sharp) {
  Given given = everything_right(arguments, footage);
  if (each.change) each.change(&given);
  const Config& config = given.config;
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
    given.info.header = make_header(to_ros_time(stamp_ns), "camera");
    processor.add_image(to_image(image, given.info.header, "mono8"));
    processor.add_camera_info(boost::make_shared<sensor_msgs::CameraInfo>(given.info));
    now_ns += config.input_timeout_ns;
    processor.advance([&](FrameOutput&& output) {
      const double at_s = i * to_seconds(kPeriodNs);
      const bool deblurred = output.reason == PassThroughReason::NONE;
      if (!deblurred) ++outcome.passed_through;
      const bool by_gyro = deblurred && output.field && !output.field->images_alone;
      if (by_gyro && !outcome.with_gyro_from_s) outcome.with_gyro_from_s = at_s;
      const bool is_right = output.exposure && output.exposure->origin != ExposureOrigin::ASSUMED &&
                            std::abs(to_seconds(output.exposure->exposure_ns) / arguments.exposure_s - 1) <= 0.05;
      if (!is_right) outcome.right_exposure_from_s.reset();
      if (is_right && !outcome.right_exposure_from_s) outcome.right_exposure_from_s = at_s;
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
  if (!arguments.output.empty()) std::filesystem::create_directories(arguments.output);
  const auto deblur_nothing = [](Given* given) {
    BlurFieldOptions& options = given->config.pipeline.blur_field;
    options.min_extent_px = options.max_extent_px = 1;
    given->config.pipeline.optical_flow = false;
  };
  std::vector<Case> cases{{"everything", nullptr}, {"everything, nothing is deblurred", deblur_nothing}};
  for (const auto& [part, make] : {std::pair("missing", missing_numbers), std::pair("exposure", wrong_exposures),
                                   std::pair("wrong", wrong_numbers)}) {
    if (arguments.part != "all" && arguments.part != part) continue;
    for (Case& each : make()) cases.push_back(std::move(each));
  }
  ResultTable table({"given", "matches from 5 s on", "of those with everything [%]", "gyroscope used from [s]",
                     "exposure within 5 % from [s]", "focal length, of the true one [%]", "images passed through"});
  Progress progress(cases.size(), "cases", arguments.quiet);
  std::size_t done = 0;
  double all = 0;
  for (const Case& each : cases) {
    const Outcome outcome = outcome_of(arguments, footage, light, each, sharp);
    const double mean = outcome.frames > 0 ? outcome.matches / static_cast<double>(outcome.frames) : 0;
    if (done == 0) all = mean;
    const auto time_of = [](const std::optional<double>& at_s) { return at_s ? text_of(*at_s, 2) : "-"; };
    table.add({each.name, text_of(mean, 0), text_of(100 * mean / all, 1), time_of(outcome.with_gyro_from_s),
               time_of(outcome.right_exposure_from_s),
               outcome.focal_length ? text_of(100 * *outcome.focal_length, 0) : "-",
               std::to_string(outcome.passed_through)});
    progress.done(++done);
  }
  std::cout << flight.conditions() << ", " << (arguments.low_light ? "low light" : "day") << ", " << footage.frames()
            << " images\n"
            << table.markdown();
  if (!arguments.output.empty()) table.write(arguments.output, "calibration_errors");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"What a wrong number costs, and none at all.", "calibration_errors"};
  app.add_option("--part", arguments.part, "what is not given, or wrong: all, missing, exposure or wrong [all]")
      .one_of({"all", "missing", "exposure", "wrong"});
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
