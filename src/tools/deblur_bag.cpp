// Everything the nodelet does, straight from bag to bag.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <deque>
#include <filesystem>
#include <iostream>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>

#include <rosbag/view.h>
#include <nlohmann/json.hpp>

#include "blur/frame_quality.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "mask_file/mask_file.hpp"
#include "ros/conversions.hpp"
#include "ros/processing.hpp"
#include "ros/processor.hpp"
#include "tools/bag_file.hpp"
#include "tools/bag_reading.hpp"
#include "tools/deblur_feed.hpp"
#include "tools/deblur_topics.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

struct Arguments {
  std::string input, output, config, mask;
  CommonArguments common;
  NamedTopics topics;
  bool keep_all_topics = false;
  FrameRequest request;
  std::optional<int> threads;   // absent: the configuration's
  double start_s = 0;           // of the slice, since the bag's first message
  std::optional<double> end_s;  // absent: to the bag's end
};

/// What a run came to.
struct Outcome {
  ProcessorStatistics statistics;
  double processing_ms = 0, bag_s = 0, wall_s = 0;
};

/// The part of a bag whose images are deblurred, [begin_ns, end_ns) of recording time. Everything else is read from
/// lead_ns earlier, and until the last image is processed, so that slices together give what the whole bag gives.
struct Slice {
  TimeNs begin_ns, end_ns, lead_ns;
  ros::Time read_from() const { return std::max(to_ros_time(begin_ns - lead_ns), ros::TIME_MIN); }
};

Slice slice_of(const rosbag::Bag& bag, const Arguments& arguments, const Config& config) {
  rosbag::View all(bag);
  if (arguments.end_s && *arguments.end_s <= arguments.start_s) {
    throw std::runtime_error("--end " + std::to_string(*arguments.end_s) + " s is not after --start " +
                             std::to_string(arguments.start_s) + " s");
  }
  const TimeNs bag_begin_ns = all.size() == 0 ? 0 : to_time_ns(all.getBeginTime());
  return {bag_begin_ns + to_ns(arguments.start_s),
          arguments.end_s ? bag_begin_ns + to_ns(*arguments.end_s) : std::numeric_limits<TimeNs>::max(),
          lead_ns(config)};
}

/// With --keep-all-topics the input's topics and those that are written share a bag.
void require_free_topics(const InputBag& input, const std::string& output_namespace) {
  for (const auto& entry : input.topics()) {
    for_each_output([&](const char* name, auto, auto) {
      if (entry.first != output_namespace + "/" + name) return;
      throw std::runtime_error(input.path() + ": has a topic " + entry.first +
                               " already; choose another --output-namespace, or leave out --keep-all-topics");
    });
  }
}

const char* prefix_of(LogLevel level) {
  return level == LogLevel::INFO ? "" : level == LogLevel::WARNING ? "warning: " : "error: ";
}

/// Lines for people; a bar makes room for them.
Log log_clearing(Progress& progress) {
  return [&progress](LogLevel level, const std::string& text) {
    progress.clear();
    std::cerr << "deblur_bag: " << prefix_of(level) << text << "\n";
  };
}

/// Duration of the part that is read [s].
double length_s(const rosbag::Bag& bag, const Slice& slice) {
  rosbag::View read(bag, slice.read_from());
  if (read.size() == 0) return 0;
  return to_seconds(std::min(to_time_ns(read.getEndTime()), slice.end_ns) - to_time_ns(read.getBeginTime()));
}

/// Axial angle as degrees in (-90, 90], where small angles stay small.
double readable_degrees(double angle_rad) {
  const double degrees = angle_rad * 180 / M_PI;
  return degrees > 90 ? degrees - 180 : degrees;
}

void report_field(const FrameBlur& field, nlohmann::json* frame) {
  const BlockBlur& center = field.blocks[static_cast<std::size_t>(
      field.grid.index_at((field.grid.width_px() - 1) / 2.0, (field.grid.height_px() - 1) / 2.0))];
  (*frame)["median_extent_px"] = median_extent_px(field, has_known_blur);
  (*frame)["center_extent_px"] = center.extent_px;
  (*frame)["center_angle_deg"] = readable_degrees(center.angle_rad);
  (*frame)["exposure_s"] = to_seconds(field.exposure_ns);
  (*frame)["readout_s"] = to_seconds(field.readout_ns);
  for (const BlockStatus status : kBlockStatuses) (*frame)["blocks"][to_string(status)] = field.count(status);
}

nlohmann::json report_of(const FrameOutput& output) {
  nlohmann::json frame;
  frame["stamp_ns"] = to_time_ns(output.input->header.stamp);
  frame["reason"] = to_string(output.reason);
  if (!output.reason_text.empty()) frame["reason_text"] = output.reason_text;
  frame["dropped"] = output.dropped;
  frame["identical"] = output.image == output.input;
  frame["keypoints"] = output.keypoints ? output.keypoints->keypoints.size() : 0;
  if (output.field) report_field(*output.field, &frame);
  frame["milliseconds"] = {{"optical_flow", output.times.flow_ms},
                           {"blur_field", output.times.blur_field_ms},
                           {"validation", output.times.validation_ms},
                           {"noise", output.times.noise_ms},
                           {"deconvolution", output.times.deconvolution_ms},
                           {"keypoints", output.times.keypoints_ms},
                           {"global_shutter", output.times.global_shutter_ms},
                           {"tracks", output.tracks_ms},
                           {"messages", output.messages_ms},
                           {"total", output.total_ms}};
  return frame;
}

/// Plays the input through the processor into the output.
Outcome deblur(const InputBag& input, const DeblurTopics& topics, const Config& config, const Arguments& arguments,
               rosbag::Bag& output, FrameReport& report) {
  const Slice slice = slice_of(input.bag(), arguments, config);
  rosbag::View view;
  const ros::Time begin = std::max(to_ros_time(slice.begin_ns), ros::TIME_MIN);
  if (arguments.keep_all_topics) {
    view.addQuery(input.bag(), begin);
  } else {
    view.addQuery(input.bag(), rosbag::TopicQuery(topics.image.name), begin);
  }
  Progress progress(view.size(), arguments.keep_all_topics ? "messages" : "images",
                    arguments.common.quiet || !Progress::watched());
  FrameRequest request = arguments.request;
  request.global_shutter_tracks = request.tracks && request.global_shutter;
  DeblurFeed feed(input.bag(), topics, config, request, slice.read_from(), log_clearing(progress));
  if (arguments.start_s > 0) feed.catch_up();

  std::deque<ros::Time> record_times;  // of the images of frames that have not come out yet
  double processing_ms = 0;
  const Processor::Sink sink = [&](FrameOutput&& frame) {
    for_each_output([&](const char* name, auto, auto message) {
      if (frame.*message) output.write(topics.output_namespace + "/" + name, record_times.front(), *(frame.*message));
    });
    record_times.pop_front();
    processing_ms += frame.total_ms;
    if (report.wanted()) report.add(report_of(frame));
    return true;
  };
  const auto expect = [&record_times](ros::Time recorded) { record_times.push_back(recorded); };
  const auto start = std::chrono::steady_clock::now();
  std::size_t done = 0;
  for (const rosbag::MessageInstance& instance : view) {
    if (to_time_ns(instance.getTime()) >= slice.end_ns) break;
    if (arguments.keep_all_topics) {
      output.write(instance.getTopic(), instance.getTime(), instance, instance.getConnectionHeader());
    }
    if (instance.getTopic() == topics.image.name) feed.add(instance, expect, sink);
    progress.done(++done);
  }
  feed.finish(expect, sink);
  output.close();
  const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return {feed.processor().statistics(), processing_ms, length_s(input.bag(), slice), wall_s};
}

/// What holds for all frames.
nlohmann::json report_of(const Arguments& arguments, const DeblurTopics& topics, const Outcome& outcome) {
  const ProcessorStatistics& statistics = outcome.statistics;
  const auto frame_count = static_cast<double>(statistics.frames_out + statistics.dropped_poor);
  nlohmann::json report;
  report["input"] = arguments.input;
  report["output"] = arguments.output;
  report["topics"] = {{"image", topics.image.name},
                      {"camera_info", topics.camera_info},
                      {"imu", topics.imu},
                      {"exposure", topics.exposure},
                      {"output_namespace", topics.output_namespace}};
  report["frames_in"] = statistics.frames_in;
  report["frames_out"] = statistics.frames_out;
  report["dropped_poor"] = statistics.dropped_poor;
  report["undecodable_images"] = statistics.undecodable_images;
  report["passed_through"] = nlohmann::json::object();
  for (const auto& [reason, count] : statistics.passed_through) report["passed_through"][to_string(reason)] = count;
  report["imu"] = {{"accepted", statistics.imu_accepted},   {"not_finite", statistics.imu_not_finite},
                   {"duplicate", statistics.imu_duplicate}, {"out_of_order", statistics.imu_out_of_order},
                   {"stray", statistics.imu_stray},         {"without_gyroscope", statistics.imu_without_gyroscope},
                   {"saturated", statistics.imu_saturated}};
  report["blocks_off_fast_path"] = statistics.fallback_counts;
  report["input_problems"] = nlohmann::json::array();
  for (const auto& [kind, problem] : statistics.input_problems) {
    report["input_problems"].push_back({{"kind", kind}, {"text", problem.text}, {"count", problem.count}});
  }
  report["calibration"] = nlohmann::json::object();
  for (const CalibrationRow& row : statistics.calibration) report["calibration"][row.key] = row.text;
  report["time_jumps"] = statistics.time_jumps;
  report["gyro_bias_rad_s"] = {statistics.bias_rad_s.x(), statistics.bias_rad_s.y(), statistics.bias_rad_s.z()};
  report["engine"] = statistics.engine;
  report["bag_s"] = outcome.bag_s;
  report["wall_s"] = outcome.wall_s;
  report["sustained_rate_hz"] = outcome.wall_s > 0 ? frame_count / outcome.wall_s : 0;
  report["mean_processing_ms"] = frame_count > 0 ? outcome.processing_ms / frame_count : 0;
  return report;
}

void print_summary(const Arguments& arguments, const DeblurTopics& topics, const Outcome& outcome) {
  std::cout << arguments.output << ": " << outcome.statistics.frames_out << " frames of " << topics.image.name;
  for (const auto& [reason, count] : outcome.statistics.passed_through) {
    std::cout << ", " << count << " passed through (" << to_string(reason) << ")";
  }
  if (outcome.statistics.dropped_poor > 0) {
    std::cout << ", " << outcome.statistics.dropped_poor << " more dropped as POOR (drop_poor)";
  }
  if (outcome.statistics.undecodable_images > 0) {
    std::cout << ", " << outcome.statistics.undecodable_images << " more left out: they could not be decoded";
  }
  std::cout << "; " << outcome.bag_s << " s of recording in " << outcome.wall_s << " s\n";
  for (const CalibrationRow& row : outcome.statistics.calibration) {
    if (row.by_images) std::cout << row.key << ": " << row.text << '\n';
  }
  for (const auto& [kind, problem] : outcome.statistics.input_problems) {
    std::cout << prefix_of(problem.level) << problem.text;
    if (problem.count > 1) std::cout << " (" << problem.count << " times)";
    std::cout << '\n';
  }
}

void run(const Arguments& arguments) {
  const InputBag input(arguments.input);
  if (std::filesystem::exists(arguments.output) && std::filesystem::equivalent(arguments.input, arguments.output)) {
    throw std::runtime_error(arguments.output + ": output would overwrite the input: give another path");
  }
  Config config = read_config("deblur_bag", arguments.config);
  if (arguments.threads) config.pipeline.threads = *arguments.threads;
  if (!arguments.mask.empty()) config.mask_file = arguments.mask;
  if (!config.mask_file.empty()) load_mask(config.mask_file);  // refused before the bag is read
  NamedTopics named = arguments.topics;
  named.mask_by_file = !arguments.mask.empty();
  const DeblurTopics topics = choose_topics(input, named, config);
  if (arguments.keep_all_topics) require_free_topics(input, topics.output_namespace);
  FrameReport report(arguments.common.json);
  Outcome outcome;
  try {
    OutputBag output(arguments.output);
    outcome = deblur(input, topics, config, arguments, output.bag(), report);
    output.finish();
  } catch (const MessageError& error) {
    throw std::runtime_error(arguments.input + ": " + error.what());
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(arguments.input + " to " + arguments.output + ": " + error.what());
  }
  report.finish(report_of(arguments, topics, outcome));
  print_summary(arguments, topics, outcome);
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{
      "Deblurs the images of a ROS bag with its gyroscope: everything the nodelet does, from bag to bag. Topics that "
      "are not named are taken when the bag has exactly one of the type.",
      "deblur_bag"};
  app.add_option("input", arguments.input,
                 "bag with images; camera_info and imu too, unless optical flow alone will do")
      .required();
  app.add_option("output", arguments.output, "bag to write").required();
  app.add_option("--config", arguments.config, "YAML file with the keys of config/default.yaml").required();
  app.add_option("--mask", arguments.mask,
                 "PNG or PGM file of the image's size, 0 where a pixel does not show the scene [the topic mask in "
                 "--camera-ns, or next to the images, else the configuration's]");
  add_image_options(app, &arguments.topics.images);
  app.add_option("--camera-info-topic", arguments.topics.camera_info,
                 "sensor_msgs/CameraInfo [camera_info next to the images]");
  app.add_option("--imu-topic", arguments.topics.imu, "sensor_msgs/Imu");
  app.add_option("--exposure-topic", arguments.topics.exposure,
                 "gyro_deblur/Exposure, or what exposure_source says [exposure in --camera-ns, or next to the images]");
  app.add_option("--output-namespace", arguments.topics.output_namespace,
                 "of the topics written [--camera-ns, or that of the images]");
  app.add_flag("--keep-all-topics", arguments.keep_all_topics, "copy every message of the input as well");
  app.add_option("--start", arguments.start_s, "only images recorded from SECONDS after the bag's first message on [0]")
      .not_negative();
  app.add_option("--end", arguments.end_s, "only images recorded before SECONDS after the bag's first message")
      .positive();
  app.add_option("--threads", arguments.threads, "at most [those of the configuration]").range(0, 256);
  app.add_flag(
      "--no-keypoints", [&arguments] { arguments.request.keypoints = false; }, "leave out keypoints");
  app.add_flag("--overlay", arguments.request.overlay, "also write blur_overlay");
  app.add_flag("--trust-mask", arguments.request.trust_mask, "also write trust_mask");
  app.add_flag("--tracks", arguments.request.tracks,
               "also write feature_tracks, with --global-shutter global_shutter/feature_tracks too");
  app.add_flag("--global-shutter", arguments.request.global_shutter,
               "also write global_shutter/image_raw and its camera_info");
  app.add_flag("--markers", arguments.request.markers, "also write blur_markers");
  add_common_options(app, &arguments.common);
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
