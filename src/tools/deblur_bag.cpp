// Everything the nodelet does, straight from bag to bag.

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <nav_msgs/Odometry.h>
#include <ros/message_traits.h>
#include <ros/time.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/Range.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "ros/conversions.hpp"
#include "ros/exposure_adapter.hpp"
#include "ros/messages.hpp"
#include "ros/processor.hpp"
#include "tools/bag_reading.hpp"
#include "tools/bag_topics.hpp"

namespace gyro_deblur {
namespace {

// Exit codes: bad input and bad usage can be told apart in scripts.
constexpr int kBadInput = 1;
constexpr int kBadUsage = 2;

struct Arguments {
  std::string input, output, config, json;
  std::string camera_namespace, image_topic, camera_info_topic, imu_topic, exposure_topic, output_namespace;
  std::string odometry_topic, scene_depth_topic;
  bool keep_all_topics = false;
  bool overlay = false;
  bool markers = false;
  bool tracks = false;
  std::optional<double> bias_seconds;
  double start_s = 0;           // of the slice, since the bag's first message
  std::optional<double> end_s;  // absent: to the bag's end
};

struct Topics {
  std::string image, imu;
  bool compressed = false;            // the images are
  std::string camera_info, exposure;  // empty: none
  std::string odometry, scene_depth;  // empty: none
  std::string output_namespace;
};

constexpr char kCompressedType[] = "sensor_msgs/CompressedImage";
constexpr char kCompressedSuffix[] = "/compressed";  // image_transport's name for the topic beside that of the image

bool has_type(const std::map<std::string, std::string>& topics, const std::string& type) {
  return std::any_of(topics.begin(), topics.end(), [&type](const auto& topic) { return topic.second == type; });
}

/// Topic of the images: raw ones where the bag has them, else compressed ones.
std::string choose_image_topic(const Arguments& arguments, const std::map<std::string, std::string>& topics) {
  std::string named = arguments.image_topic;
  if (named.empty() && !arguments.camera_namespace.empty()) {
    named = arguments.camera_namespace + "/image_raw";
    if (topics.count(named) == 0 && topics.count(named + kCompressedSuffix) > 0) named += kCompressedSuffix;
  }
  const auto found = topics.find(named);
  const bool compressed = named.empty() ? !has_type(topics, "sensor_msgs/Image") && has_type(topics, kCompressedType)
                                        : found != topics.end() && found->second == kCompressedType;
  return choose_topic(topics, "images", compressed ? kCompressedType : "sensor_msgs/Image", named, "", true);
}

/// @param info_required    the calibration file has no intrinsics
/// @param driver_messages  exposure times are read from messages of another type than the package's
Topics choose_topics(const Arguments& arguments, const std::map<std::string, std::string>& topics, bool info_required,
                     bool driver_messages) {
  Topics chosen;
  chosen.image = choose_image_topic(arguments, topics);
  chosen.compressed = topics.at(chosen.image) == kCompressedType;
  // What belongs to the image stands beside it, not beside its compressed version.
  std::string image = chosen.image;
  const std::size_t suffix = std::string(kCompressedSuffix).size();
  if (chosen.compressed && image.size() > suffix && image.substr(image.size() - suffix) == kCompressedSuffix) {
    image.resize(image.size() - suffix);
  }
  chosen.camera_info = choose_topic(topics, "camera_info", "sensor_msgs/CameraInfo", arguments.camera_info_topic,
                                    parent_namespace(image) + "/camera_info", info_required);
  chosen.imu = choose_topic(topics, "imu", "sensor_msgs/Imu", arguments.imu_topic, "", true);
  if (driver_messages) {
    chosen.exposure = arguments.exposure_topic;
    if (topics.count(chosen.exposure) == 0) {
      throw std::runtime_error("exposure_source of the configuration needs --exposure-topic with a topic of the bag");
    }
  } else {
    chosen.exposure = choose_topic(topics, "exposure", "gyro_deblur/Exposure", arguments.exposure_topic,
                                   parent_namespace(image) + "/exposure", false);
  }
  // Never by their type alone: a bag's odometry may be that of something else.
  const auto choose_named = [&](const std::string& kind, const std::string& type, const std::string& named) {
    return named.empty() ? named : choose_topic(topics, kind, type, named, "", false);
  };
  chosen.odometry = choose_named("odometry", "nav_msgs/Odometry", arguments.odometry_topic);
  chosen.scene_depth = choose_named("scene depth", "sensor_msgs/Range", arguments.scene_depth_topic);
  chosen.output_namespace = arguments.output_namespace.empty() ? parent_namespace(image) : arguments.output_namespace;
  return chosen;
}

/// A line that follows the work; silent when nobody watches.
class ProgressBar {
 public:
  explicit ProgressBar(std::size_t total) : total_(total), visible_(isatty(STDERR_FILENO) != 0) {}
  ~ProgressBar() { clear(); }
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  void update(std::size_t done, std::size_t frames) {
    const auto now = std::chrono::steady_clock::now();
    constexpr std::chrono::milliseconds kPeriod{100};
    if (!visible_ || total_ == 0 || (done < total_ && now - last_ < kPeriod)) return;
    last_ = now;
    constexpr std::size_t kWidth = 40;
    const std::size_t filled = kWidth * done / total_;
    std::fprintf(stderr, "\r[%s%s] %3zu %%  %zu frames", std::string(filled, '#').c_str(),
                 std::string(kWidth - filled, ' ').c_str(), 100 * done / total_, frames);
    std::fflush(stderr);
    drawn_ = true;
  }

  void clear() {
    if (drawn_) std::fprintf(stderr, "\r\033[K");
    drawn_ = false;
  }

 private:
  std::size_t total_;
  bool visible_;
  bool drawn_ = false;
  std::chrono::steady_clock::time_point last_;
};

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Axial angle as degrees in (-90, 90], where small angles stay small.
double readable_degrees(double angle_rad) {
  const double degrees = angle_rad * 180 / M_PI;
  return degrees > 90 ? degrees - 180 : degrees;
}

nlohmann::json frame_report(const FrameOutput& output) {
  nlohmann::json frame;
  frame["stamp_ns"] = to_time_ns(output.input->header.stamp);
  frame["reason"] = to_string(output.reason);
  if (!output.reason_text.empty()) frame["reason_text"] = output.reason_text;
  frame["identical"] = output.image == output.input;
  frame["keypoints"] = output.keypoints ? output.keypoints->keypoints.size() : 0;
  if (output.field) {
    const FrameBlur& field = *output.field;
    std::vector<double> extents;
    for (const BlockBlur& block : field.blocks) {
      if (block.status != BlockStatus::NO_GYRO) extents.push_back(block.extent_px);
    }
    const BlockBlur& center = field.blocks[static_cast<std::size_t>(
        field.grid.index_at((field.grid.width_px() - 1) / 2.0, (field.grid.height_px() - 1) / 2.0))];
    frame["median_extent_px"] = median(extents);
    frame["center_extent_px"] = center.extent_px;
    frame["center_angle_deg"] = readable_degrees(center.angle_rad);
    frame["exposure_s"] = to_seconds(field.exposure_ns);
    frame["readout_s"] = to_seconds(field.readout_ns);
    for (const BlockStatus status : {BlockStatus::SHARP, BlockStatus::DEBLURRED, BlockStatus::REJECTED,
                                     BlockStatus::TOO_LARGE, BlockStatus::NO_GYRO, BlockStatus::BENT}) {
      frame["blocks"][to_string(status)] = field.count(status);
    }
  }
  frame["milliseconds"] = {{"blur_field", output.stages.blur_field_ms},
                           {"validation", output.stages.validation_ms},
                           {"deconvolution", output.stages.deconvolution_ms},
                           {"keypoints", output.stages.keypoints_ms},
                           {"messages", output.messages_ms},
                           {"total", output.total_ms}};
  return frame;
}

/// Bias [rad/s] from the first `seconds` of the IMU topic. Throws std::runtime_error when the sensor moved.
Eigen::Vector3d bias_of_first(rosbag::Bag& bag, const std::string& imu_topic, double seconds, double max_stddev_rad_s) {
  std::vector<GyroSample> samples;
  rosbag::View view(bag, rosbag::TopicQuery(imu_topic));
  for (const rosbag::MessageInstance& instance : view) {
    const auto imu = read_message<sensor_msgs::Imu>(instance);
    if (!imu) continue;
    const std::optional<GyroSample> sample = to_gyro_sample(*imu);
    if (!sample || !sample->rate_rad_s.allFinite()) continue;
    if (!samples.empty() && sample->t_ns - samples.front().t_ns > to_ns(seconds)) break;
    samples.push_back(*sample);
  }
  std::string error;
  const std::optional<BiasEstimate> estimate =
      estimate_stationary_bias(samples, max_stddev_rad_s, kMinBiasSamples, &error);
  if (!estimate) throw std::runtime_error("gyroscope bias of the first " + std::to_string(seconds) + " s: " + error);
  return estimate->bias_rad_s;
}

/// The part of a bag whose images are deblurred, [begin_ns, end_ns) of recording time. Everything else is read from
/// lead_ns earlier, and until the last image has left, so that slices together give what the whole bag gives.
struct Slice {
  TimeNs begin_ns, end_ns, lead_ns;
  bool holds(TimeNs t_ns) const { return t_ns >= begin_ns && t_ns < end_ns; }
};

Slice slice_of(rosbag::Bag& bag, const Arguments& arguments, const Config& config) {
  rosbag::View all(bag);
  if (arguments.end_s && *arguments.end_s <= arguments.start_s) {
    throw std::runtime_error("--end " + std::to_string(*arguments.end_s) + " s is not after --start " +
                             std::to_string(arguments.start_s) + " s");
  }
  const TimeNs bag_begin_ns = all.size() == 0 ? 0 : to_time_ns(all.getBeginTime());
  // What a frame may need from before its image came: its gyroscope samples, and messages that overtook it.
  const TimeNs lead_ns = config.gyro.buffer_ns + std::abs(config.gyro.time_offset_ns) + config.gyro_timeout_ns +
                         std::max({config.exposure_max_age_ns, config.translation.depth_max_age_ns,
                                   velocity_reach_ns(config.translation)});
  return {bag_begin_ns + to_ns(arguments.start_s),
          arguments.end_s ? bag_begin_ns + to_ns(*arguments.end_s) : std::numeric_limits<TimeNs>::max(), lead_ns};
}

/// Deletes a half-written file when something goes wrong.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::string path) : path_(std::move(path)) {}
  ~TemporaryFile() {
    std::error_code ignored;
    if (!path_.empty()) std::filesystem::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  const std::string& path() const { return path_; }
  void move_to(const std::string& target) {
    std::filesystem::rename(path_, target);
    path_.clear();
  }

 private:
  std::string path_;
};

void run(const Arguments& arguments) {
  if (!std::filesystem::is_regular_file(arguments.input)) throw std::runtime_error(arguments.input + ": no such file");
  if (std::filesystem::exists(arguments.output) && std::filesystem::equivalent(arguments.input, arguments.output)) {
    throw std::runtime_error(arguments.output + ": output would overwrite the input");
  }
  std::vector<std::string> unknown;
  Config config = load_config(arguments.config, &unknown);
  for (const std::string& key : unknown) {
    if (key == "image_transport") continue;  // of the nodelet; a bag's messages say by their type how to read them
    std::cerr << "deblur_bag: " << arguments.config << ": key " << unknown_key_message(key) << '\n';
  }

  const bool driver_messages = config.exposure_source.kind != ExposureSource::Kind::MESSAGE;
  rosbag::Bag input;
  try {
    input.open(arguments.input, rosbag::bagmode::Read);
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(arguments.input + ": not a bag that can be read: " + error.what());
  }
  const std::map<std::string, std::string> bag_topics = topics_of(input);
  Topics topics;
  try {
    topics = choose_topics(arguments, bag_topics, !config.calibration || !config.calibration->camera, driver_messages);
    topics.compressed ? require_definition<sensor_msgs::CompressedImage>(input, topics.image)
                      : require_definition<sensor_msgs::Image>(input, topics.image);
    if (!topics.camera_info.empty()) require_definition<sensor_msgs::CameraInfo>(input, topics.camera_info);
    require_definition<sensor_msgs::Imu>(input, topics.imu);
    if (!topics.exposure.empty() && !driver_messages) require_definition<Exposure>(input, topics.exposure);
    if (!topics.odometry.empty()) require_definition<nav_msgs::Odometry>(input, topics.odometry);
    if (!topics.scene_depth.empty()) require_definition<sensor_msgs::Range>(input, topics.scene_depth);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(arguments.input + ": " + error.what());
  }
  if (arguments.bias_seconds) {
    config.gyro.bias_rad_s = bias_of_first(input, topics.imu, *arguments.bias_seconds, config.bias_max_stddev_rad_s);
  }

  TemporaryFile part(arguments.output + ".active");
  rosbag::Bag output;
  try {
    output.open(part.path(), rosbag::bagmode::Write);
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(arguments.output + ": cannot be written: " + error.what());
  }
  const auto output_topic = [&topics](const std::string& name) { return topics.output_namespace + "/" + name; };
  const std::string deblurred_topic = output_topic("deblurred/image_raw");
  const std::string info_topic = output_topic("deblurred/camera_info");
  const std::string keypoint_topic = output_topic("keypoints");
  const std::string field_topic = output_topic("blur_field");
  const std::string overlay_topic = output_topic("blur_overlay");
  const std::string marker_topic = output_topic("blur_markers");
  const std::string track_topic = output_topic("feature_tracks");
  const std::set<std::string> own_topics{deblurred_topic, info_topic,   keypoint_topic, field_topic,
                                         overlay_topic,   marker_topic, track_topic};
  for (const auto& [topic, type] : bag_topics) {
    if (arguments.keep_all_topics && own_topics.count(topic) > 0) {
      throw std::runtime_error(arguments.input + ": has a topic " + topic +
                               " already; choose another --output-namespace, or leave out --keep-all-topics");
    }
  }

  tf2::BufferCore tf_buffer;
  {
    // Latched: a node would have them from the start.
    rosbag::View statics(input, rosbag::TopicQuery("/tf_static"));
    for (const rosbag::MessageInstance& instance : statics) {
      if (const auto message = read_message<tf2_msgs::TFMessage>(instance)) add_transforms(*message, &tf_buffer);
    }
  }

  const Slice slice = slice_of(input, arguments, config);
  const ros::Time read_from = std::max(to_ros_time(slice.begin_ns - slice.lead_ns), ros::TIME_MIN);
  if (arguments.start_s > 0) {
    rosbag::View before(input, rosbag::TopicQuery("/tf"), ros::TIME_MIN, read_from);
    for (const rosbag::MessageInstance& instance : before) {
      if (const auto message = read_message<tf2_msgs::TFMessage>(instance)) add_transforms(*message, &tf_buffer);
    }
  }
  TimeNs bag_time_ns = 0;
  rosbag::View view(input, read_from);
  ProgressBar progress(view.size());
  Processor::Environment environment;
  environment.clock = [&bag_time_ns] { return bag_time_ns; };
  const auto log = [&progress](LogLevel level, const std::string& text) {
    progress.clear();
    std::cerr << "deblur_bag: "
              << (level == LogLevel::INFO      ? ""
                  : level == LogLevel::WARNING ? "warning: "
                                               : "error: ")
              << text << "\n";
  };
  environment.log = log;
  environment.extrinsic = [&tf_buffer](const std::string& camera_frame, const std::string& imu_frame) {
    return lookup_R_cam_imu(tf_buffer, camera_frame, imu_frame);
  };
  environment.transform = [&tf_buffer](const std::string& camera_frame, const std::string& body_frame) {
    return lookup_T_cam_body(tf_buffer, camera_frame, body_frame);
  };
  environment.exposure_expected = [&topics] { return !topics.exposure.empty(); };
  environment.request = [&arguments] {
    FrameRequest request;
    request.overlay = arguments.overlay;
    request.markers = arguments.markers;
    request.tracks = arguments.tracks;
    return request;
  };
  Processor processor(std::move(environment));
  processor.set_config(config);
  ExposureAdapter adapter(config.exposure_source);

  std::deque<ros::Time> record_times;  // of the frames that have not come out yet
  nlohmann::json frames = nlohmann::json::array();
  double processing_ms = 0;
  const Processor::Sink sink = [&](FrameOutput&& frame) {
    const ros::Time time = record_times.front();
    record_times.pop_front();
    output.write(deblurred_topic, time, *frame.image);
    output.write(info_topic, time, *frame.camera_info);
    output.write(keypoint_topic, time, *frame.keypoints);
    output.write(field_topic, time, *frame.blur_field);
    if (frame.overlay) output.write(overlay_topic, time, *frame.overlay);
    if (frame.markers) output.write(marker_topic, time, *frame.markers);
    if (frame.tracks) output.write(track_topic, time, *frame.tracks);
    processing_ms += frame.total_ms;
    frames.push_back(frame_report(frame));
    return true;
  };

  std::size_t refused_exposures = 0;
  // As in the nodelet: a driver's message without an exposure time costs its frame, not the run.
  const auto pass_on_exposure = [&](const rosbag::MessageInstance& instance) {
    const std::vector<std::uint8_t> bytes = read_bytes(instance);
    try {
      adapter.pass_on(instance.getDataType(), instance.getMessageDefinition(), bytes, &processor);
    } catch (const std::exception& error) {
      if (refused_exposures++ > 0) return;
      log(LogLevel::WARNING, MessageError(instance, error.what()).what());
    }
  };
  if (driver_messages && arguments.start_s > 0 && !topics.exposure.empty()) {
    // A setting is published when it changes, which may be long before the slice.
    rosbag::View before(input, rosbag::TopicQuery(topics.exposure), ros::TIME_MIN, read_from);
    for (const rosbag::MessageInstance& instance : before) {
      const std::vector<std::uint8_t> bytes = read_bytes(instance);
      try {
        const std::optional<ExposureReading> reading =
            adapter.read(instance.getDataType(), instance.getMessageDefinition(), bytes.data(), bytes.size());
        if (reading && reading->stamp_ns) break;  // of single frames, not a setting
        if (reading) processor.add_exposure_setting(reading->exposure_ns);
      } catch (const std::exception&) {
        continue;  // said by the slice that it belongs to
      }
    }
  }

  const auto start = std::chrono::steady_clock::now();
  std::size_t done = 0;
  try {
    for (const rosbag::MessageInstance& instance : view) {
      bag_time_ns = to_time_ns(instance.getTime());
      if (bag_time_ns >= slice.end_ns && processor.waiting() == 0) break;
      const std::string& topic = instance.getTopic();
      const bool inside = slice.holds(bag_time_ns);
      if (arguments.keep_all_topics && inside)
        output.write(topic, instance.getTime(), instance, instance.getConnectionHeader());
      if (topic == topics.imu) {
        if (const auto message = read_message<sensor_msgs::Imu>(instance)) processor.add_imu(*message);
      } else if (topic == topics.camera_info) {
        if (const auto message = read_message<sensor_msgs::CameraInfo>(instance)) processor.add_camera_info(message);
      } else if (topic == topics.image && inside) {
        sensor_msgs::ImageConstPtr message;
        if (topics.compressed) {
          const auto compressed = read_message<sensor_msgs::CompressedImage>(instance);
          if (compressed) message = decode_image(*compressed);
        } else {
          message = read_message<sensor_msgs::Image>(instance);
        }
        if (message) {
          record_times.push_back(instance.getTime());
          processor.add_image(message);
        }
      } else if (topic == topics.exposure) {
        if (driver_messages) {
          pass_on_exposure(instance);
        } else if (const auto message = read_message<Exposure>(instance)) {
          processor.add_exposure(*message);
        }
      } else if (topic == topics.odometry) {
        if (const auto message = read_message<nav_msgs::Odometry>(instance)) processor.add_odometry(*message);
      } else if (topic == topics.scene_depth) {
        if (const auto message = read_message<sensor_msgs::Range>(instance)) processor.add_scene_depth(*message);
      } else if (topic == "/tf") {
        if (const auto message = read_message<tf2_msgs::TFMessage>(instance)) add_transforms(*message, &tf_buffer);
      }
      if (processor.waiting() > 0) processor.advance(sink);
      progress.update(++done, frames.size());
    }
    processor.finish(sink);
    output.close();
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(arguments.input + " to " + arguments.output + ": " + error.what());
  }
  progress.clear();
  part.move_to(arguments.output);
  const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();

  const ProcessorStatistics statistics = processor.statistics();
  const double bag_s = view.size() == 0 ? 0 : (view.getEndTime() - view.getBeginTime()).toSec();
  const auto frame_count = static_cast<double>(statistics.frames_out);
  nlohmann::json report;
  report["input"] = arguments.input;
  report["output"] = arguments.output;
  report["topics"] = {{"image", topics.image},
                      {"camera_info", topics.camera_info},
                      {"imu", topics.imu},
                      {"exposure", topics.exposure},
                      {"output_namespace", topics.output_namespace}};
  report["frames_in"] = statistics.frames_in;
  report["frames_out"] = statistics.frames_out;
  report["passed_through"] = nlohmann::json::object();
  for (const auto& [reason, count] : statistics.passed_through) report["passed_through"][to_string(reason)] = count;
  report["imu"] = {{"accepted", statistics.imu_accepted},   {"not_finite", statistics.imu_not_finite},
                   {"duplicate", statistics.imu_duplicate}, {"out_of_order", statistics.imu_out_of_order},
                   {"stray", statistics.imu_stray},         {"without_gyroscope", statistics.imu_without_gyroscope},
                   {"saturated", statistics.imu_saturated}};
  if (!topics.odometry.empty()) {
    report["translation"] = {{"frames_with", statistics.frames_translated},
                             {"frames_without", statistics.frames_not_translated},
                             {"odometry_refused", statistics.odometry_refused}};
  }
  report["time_jumps"] = statistics.time_jumps;
  const Eigen::Vector3d bias = processor.bias_rad_s();
  report["gyro_bias_rad_s"] = {bias.x(), bias.y(), bias.z()};
  report["engine"] = statistics.engine;
  report["bag_s"] = bag_s;
  report["wall_s"] = wall_s;
  report["sustained_rate_hz"] = wall_s > 0 ? frame_count / wall_s : 0;
  report["mean_processing_ms"] = frame_count > 0 ? processing_ms / frame_count : 0;
  report["frames"] = std::move(frames);
  if (!arguments.json.empty()) {
    std::ofstream file(arguments.json);
    file << report.dump(2) << "\n";
    if (!file.flush()) throw std::runtime_error(arguments.json + ": cannot be written");
  }

  std::cout << arguments.output << ": " << statistics.frames_out << " frames of " << topics.image;
  for (const auto& [reason, count] : statistics.passed_through) {
    std::cout << ", " << count << " passed through (" << to_string(reason) << ")";
  }
  std::cout << "; " << bag_s << " s of recording in " << wall_s << " s\n";
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CLI::App app{
      "Deblurs the images of a ROS bag with its gyroscope: everything the nodelet does, from bag to bag. Topics that "
      "are not named are taken when the bag has exactly one of the type.",
      "deblur_bag"};
  app.add_option("input", arguments.input, "bag with images, camera_info and imu")->required();
  app.add_option("output", arguments.output, "bag to write")->required();
  app.add_option("--config", arguments.config, "YAML file with the keys of config/default.yaml")->required();
  app.add_option("--camera-ns", arguments.camera_namespace, "the images are on NAMESPACE/image_raw");
  app.add_option("--image-topic", arguments.image_topic, "sensor_msgs/Image, or sensor_msgs/CompressedImage");
  app.add_option("--camera-info-topic", arguments.camera_info_topic,
                 "sensor_msgs/CameraInfo [camera_info beside the images]");
  app.add_option("--imu-topic", arguments.imu_topic, "sensor_msgs/Imu");
  app.add_option("--exposure-topic", arguments.exposure_topic,
                 "gyro_deblur/Exposure, or what exposure_source says [exposure beside the images]");
  app.add_option("--odometry-topic", arguments.odometry_topic, "nav_msgs/Odometry, for the translation [none]");
  app.add_option("--scene-depth-topic", arguments.scene_depth_topic,
                 "sensor_msgs/Range, the scene's median depth [none: parameter scene_depth]");
  app.add_option("--output-namespace", arguments.output_namespace, "of the topics written [that of the images]");
  app.add_flag("--keep-all-topics", arguments.keep_all_topics, "copy every message of the input as well");
  app.add_option("--estimate-bias-first", arguments.bias_seconds,
                 "the sensor is at rest in the first SECONDS: use its mean rate as bias")
      ->check(CLI::PositiveNumber);
  app.add_option("--start", arguments.start_s, "only images recorded from SECONDS after the bag's first message on [0]")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--end", arguments.end_s, "only images recorded before SECONDS after the bag's first message")
      ->check(CLI::PositiveNumber);
  app.add_flag("--overlay", arguments.overlay, "also write blur_overlay");
  app.add_flag("--tracks", arguments.tracks, "also write feature_tracks");
  app.add_flag("--markers", arguments.markers, "also write blur_markers");
  app.add_option("--json", arguments.json, "also write what was done as JSON");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kBadUsage;
  }
  try {
    run(arguments);
  } catch (const MessageError& error) {
    std::cerr << "deblur_bag: " << arguments.input << ": " << error.what() << "\n";
    return kBadInput;
  } catch (const std::exception& error) {
    std::cerr << "deblur_bag: " << error.what() << "\n";
    return kBadInput;
  }
  return 0;
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
