#include "config/parameters.hpp"

#include <map>
#include <utility>

namespace gyro_deblur {
namespace {

/// Where a configuration has the struct: each occurs once.
template <typename Owner, typename AnyConfig>
auto& part(AnyConfig& config) {
  if constexpr (std::is_same_v<Owner, BlurFieldOptions>) return config.pipeline.blur_field;
  if constexpr (std::is_same_v<Owner, ValidationOptions>) return config.pipeline.validation;
  if constexpr (std::is_same_v<Owner, FilterOptions>) return config.pipeline.kernel;
  if constexpr (std::is_same_v<Owner, NoiseModel>) return config.pipeline.noise;
  if constexpr (std::is_same_v<Owner, KeypointOptions>) return config.pipeline.keypoints;
  if constexpr (std::is_same_v<Owner, PipelineOptions>) return config.pipeline;
  if constexpr (std::is_same_v<Owner, GyroOptions>) return config.gyro;
  if constexpr (std::is_same_v<Owner, ShutterTiming>) return config.shutter;
  if constexpr (std::is_same_v<Owner, ExposureSource>) return config.exposure_source;
  if constexpr (std::is_same_v<Owner, TrackerOptions>) return config.tracker;
  if constexpr (std::is_same_v<Owner, Config>) return config;
}

}  // namespace

template <typename Owner, typename T>
Parameter::Parameter(const char* name, T Owner::*member, const char* description, Change when)
    : key(name),
      text(description),
      change(when),
      owner_(typeid(Owner)),
      part_([](const Config& config) -> const void* { return &part<Owner>(config); }),
      mutable_part_([](Config& config) -> void* { return &part<Owner>(config); }),
      get_([member](const void* owner) { return to_value(static_cast<const Owner*>(owner)->*member); }),
      set_([member](void* owner, const Value& value) { assign(value, static_cast<Owner*>(owner)->*member); }) {
  if constexpr (kHasNames<T>) {
    for (const auto& named : names_of(T{})) choices.push_back(named.first);
  }
}

template <typename Owner, typename T>
Parameter::Parameter(const char* name, T Owner::*member, const Limits& allowed, const char* description, Change when)
    : Parameter(name, member, description, when) {
  limits = allowed;
}

template <typename Owner>
Parameter::Parameter(const char* name, std::string Owner::*member, const OneOf& allowed, const char* description,
                     Change when)
    : Parameter(name, member, description, when) {
  choices = allowed.names;
}

namespace {

constexpr Change RUNNING = Change::WHILE_RUNNING;

/// [min, max]
Limits within(double min, double max, const char* unit = "") { return {min, max, unit, false}; }

/// (min, max]
Limits above(double min, double max, const char* unit = "") { return {min, max, unit, true}; }

OneOf one_of(std::vector<std::string> names) { return {std::move(names)}; }

// The table: one row a parameter, of its key, member, limits with unit, text, and whether it may change while running.
// The order is that of the documents.

using Blur = BlurFieldOptions;
using Validation = ValidationOptions;
using Kernel = FilterOptions;
using Keypoints = KeypointOptions;
using Tracker = TrackerOptions;
using Gyro = GyroOptions;
using Shutter = ShutterTiming;

ParameterGroup calibration_files() {
  return {"calibration files",
          "Kalibr's camchain-imucam.yaml (also OpenVINS'), EuRoC's sensor.yaml, VINS' configuration, Basalt's JSON or "
          "camera_calibration's YAML, as they are; one path or a list. What a file says need not be set below; where "
          "both say something they have to agree.",
          {
              {"calibration_file", &Config::calibration_files,
               "relative to the configuration file, for the nodelet absolute; '': none"},
              {"calibration_camera", &Config::calibration_camera, "cam0, cam1, ...: which of a file's cameras"},
              {"on_calibration_conflict", &Config::on_calibration_conflict,
               "frames whose camera_info or tf contradict file or parameters pass through, or go by the latter"},
          }};
}

ParameterGroup camera_timing() {
  return {
      "camera timing",
      "",
      {
          Parameter("exposure_time", &Shutter::exposure_ns, above(0, 1, "s"),
                    "of each row, of images without an exposure message; '': not known, it is estimated from the "
                    "images' blur")
              .may_be_empty(&GivenNumbers::exposure_time),
          {"exposure_source", &Config::exposure_source,
           "what the exposure topic has: gyro_deblur/Exposure or a RealSense's metadata, as recognised by their type; "
           "gyro_deblur/Exposure; any message with exposure_field, in that unit; a RealSense's metadata "
           "(exposure_field: actual_exposure unless given; infrared in us, colour in 100us); or a driver's "
           "parameter_updates with the parameter exposure_field"},
          {"on_exposure_conflict", &Config::on_exposure_conflict,
           "when the blur contradicts an exposure time for 2 s: the images' estimate replaces exposure_time, messages "
           "are kept; or both are kept. The contradiction is reported in either case"},
          {"exposure_field", &ExposureSource::field, "e.g. exposure_time, exposures[0].shutterms"},
          {"exposure_max_age", &Config::exposure_max_age_ns, within(0, 60, "s"),
           "how long the last exposure serves images without their own; 0: not at all"},
          Parameter("readout_time", &Shutter::readout_ns, within(-1, 1, "s"),
                    "first to last row; 0: global shutter, negative: bottom row first; '': not known, see "
                    "self_calibration")
              .may_be_empty(&GivenNumbers::readout_time),
          {"stamp_row", &Shutter::stamp_row, "the image row that the stamp refers to"},
          {"stamp_phase", &Shutter::stamp_phase, "the instant of that row's exposure"},
          {"rectified_input", &Config::rectified_input, "true: the image is undistorted, camera_info's P and R hold"},
      }};
}

ParameterGroup image() {
  return {"image",
          "",
          {
              {"significant_bits", &PipelineOptions::significant_bits, within(0, 16),
               "of 16-bit images, 8 to 16; 0: the fewest of 10, 12, 14, 16 that hold all pixels so far", RUNNING},
              {"read_noise", &NoiseModel::read_noise, within(0, 50, "grey levels"),
               "of the sensor, standard deviation at 8 bits; 0 and noise_gain 0: estimated from each image", RUNNING},
              {"noise_gain", &NoiseModel::noise_gain, within(0, 10, "grey levels"),
               "of the sensor: what a grey level more adds to the noise's variance", RUNNING},
              {"mask", &Config::mask_file,
               "PNG or PGM file, mono8, of the image's size: pixels of 0 (a lens's rim, a part of the vehicle) are not "
               "deblurred, followed or described; relative as calibration_file, '': none; the topic mask replaces it"},
              {"global_shutter_border", &PipelineOptions::global_shutter_border,
               "what the global-shutter image has where the image ends: nothing, or the nearest pixel"},
          }};
}

ParameterGroup gyroscope() {
  return {"gyroscope",
          "",
          {
              // One clock may count from 1970 and the other from when it was switched on. ros::Time ends after 4.3e9 s,
              // a sum of both fits into 64 bits of nanoseconds.
              Parameter("time_offset", &Gyro::time_offset_ns, within(-4e9, 4e9, "s"),
                        "t_imu = t_cam + time_offset; Kalibr's: see doc/guides/calibration.md; '': not known, see "
                        "self_calibration")
                  .may_be_empty(&GivenNumbers::time_offset),
              {"R_cam_imu", &Config::R_cam_imu,
               "rotation from IMU to camera coordinates (Kalibr's T_cam_imu), by rows; []: from tf, else see "
               "self_calibration"},
              Parameter("gyro_bias", &Gyro::bias_rad_s, within(-1, 1, "rad/s"),
                        "subtracted from the rates; '': not known, see self_calibration")
                  .may_be_empty(&GivenNumbers::gyro_bias),
              {"self_calibration", &Config::self_calibration,
               "readout_time, time_offset, R_cam_imu and gyro_bias that are empty are estimated from the images, and "
               "used once they are sure; those that are given, 0 included, are kept, and reported where the images "
               "contradict them; or neither"},
              {"gyro_buffer_duration", &Gyro::buffer_ns, above(0.1, 60, "s"), "samples kept"},
              {"max_gyro_gap", &Gyro::max_gap_ns, within(0.001, 1, "s"),
               "longer holes between samples are not integrated across"},
              // Up to the fastest sensors, 20000 degrees/s.
              {"gyro_range", &Gyro::range_rad_s, within(0, 400, "rad/s"),
               "the sensor's range on each axis (2000 degrees/s: 34.9); samples at it are saturated and not integrated "
               "across; 0: not known, nothing is checked"},
              {"input_timeout", &Config::input_timeout_ns, within(0, 10, "s"),
               "how long a frame waits for gyroscope, exposure and tf"},
              {"frame_queue_size", &Config::frame_queue_size, within(1, 1000), "frames that may wait"},
              {"bias_window", &Config::bias_window_ns, within(0.1, 10, "s"), "averaged by ~estimate_gyro_bias"},
              {"bias_max_stddev", &Config::bias_max_stddev_rad_s, above(0, 1, "rad/s"), "more scatter is not rest"},
              {"time_jump_threshold", &Config::time_jump_ns, within(0.01, 10, "s"),
               "a stamp that goes back by more is a clock reset"},
          }};
}

ParameterGroup stereo() {
  return {"stereo",
          "",
          {
              {"stereo_sync_timeout", &Config::stereo_sync_timeout_ns, within(0, 10, "s"),
               "of the cameras in one process with the same IMU both images of a stamp are deblurred, or neither: how "
               "long one waits for the other to be decided on; 0: each on its own"},
          }};
}

ParameterGroup image_quality() {
  return {"image quality",
          "",
          {
              {"drop_poor", &Config::drop_poor,
               "true: an image of grade POOR, and what was found in it, is not published, the one exception to "
               "one image out for every image in",
               RUNNING},
          }};
}

ParameterGroup blur_field() {
  return {"blur field",
          "",
          {
              {"block_size", &Blur::block_size_px, within(8, 1024, "px"), "even; the side of a block", RUNNING},
              {"min_extent", &Blur::min_extent_px, within(1, 20, "px"), "smaller blur is left alone", RUNNING},
              {"max_extent", &Blur::max_extent_px, within(1, 500, "px"),
               "at least min_extent; larger blur is left alone", RUNNING},
              {"curved_path_threshold", &Blur::curved_path_threshold_px, within(0, 100, "px"),
               "blur off a line by more than this and 2 % of its length is undone in the plane, which takes longer",
               RUNNING},
              {"optical_flow", &PipelineOptions::optical_flow,
               "what the gyroscope does not know of the motion is taken from corners followed between images", RUNNING},
              {"flow_without_gyro", &PipelineOptions::flow_without_gyro, one_of({"absent", "always", "never"}),
               "which frames that the gyroscope does not cover go by those corners alone: those of a camera whose IMU "
               "is absent or silent; also those at gaps and of saturated samples; or none",
               RUNNING},
          }};
}

ParameterGroup wiener_filter() {
  return {
      "Wiener filter",
      "",
      {
          {"noise_to_signal_ratio", &Kernel::gamma, within(1e-5, 1), "noise-to-signal ratio at 1/6 cycles/px", RUNNING},
          {"regularization", &Kernel::regularization,
           "noise: gamma rises with noise over texture, and blocks that noise would spoil are left alone; fixed: "
           "gamma as it is; paper: the paper's taps, with gamma at every frequency"},
          {"kernel_length_factor", &Kernel::length_factor, within(2, 8), "length of the inverse kernel in extents"},
          {"kernel_smoothing", &Kernel::smoothing_px, within(0, 5, "px"),
           "Gaussian along the motion that the inverse is smoothed with"},
          {"engine", &PipelineOptions::engine,
           "cpu; fourier (the inverse of the whole path for all blocks); float; opencl (first GPU, else first "
           "device), opencl:INDEX or opencl:NAME (part of the name), "
           "which cpu replaces where the device is absent or fails, with one warning; auto: cpu"},
          {"threads", &PipelineOptions::threads, within(0, 256),
           "of validation, kernels and engine, at most; 0: one for each core to run on"},
      }};
}

ParameterGroup validation() {
  return {
      "validation",
      "By likelihood a block is rejected when its image fits less blur better than the predicted one, by the paper's "
      "rule, which blocks with blur below 5 px have to meet too, when its gradient along the motion exceeds tau + "
      "tau_contrast / extent.",
      {
          {"validate", &Validation::enabled, "true: blocks whose image contradicts the predicted blur are rejected",
           RUNNING},
          {"validation", &Validation::rule,
           "what they are rejected by: how likely their power spectrum is, or the paper's gradient"},
          {"false_accept_rate", &Validation::false_accept_rate, within(0.001, 0.5),
           "likelihood: share of blocks blurred by a third of what is predicted that may be accepted", RUNNING},
          {"tau", &Validation::tau, within(0, 255, "grey levels / px"),
           "paper, and blur below 5 px: gradient that is always allowed", RUNNING},
          {"tau_contrast", &Validation::tau_contrast, within(0, 1000, "grey levels"),
           "paper, and blur below 5 px: plus this over the extent", RUNNING},
      }};
}

ParameterGroup keypoints() {
  return {"keypoints",
          "",
          {
              {"keypoint_detector", &Keypoints::detector, one_of({"SIFT", "ORB", "AKAZE", "BRISK", "GFTT", "FAST"}),
               "finds keypoints", RUNNING},
              {"keypoint_descriptor", &Keypoints::descriptor, one_of({"SIFT", "ORB", "AKAZE", "BRISK", "NONE"}),
               "describes them; AKAZE only with keypoint_detector AKAZE, ORB not with SIFT", RUNNING},
              {"max_keypoints", &Keypoints::max_keypoints, within(1, 100000),
               "keypoints that are kept, strongest first", RUNNING},
              {"grid_cols", &Keypoints::grid_cols, within(1, 64),
               "columns of the grid over which the limit is shared evenly", RUNNING},
              {"grid_rows", &Keypoints::grid_rows, within(1, 64), "rows of that grid", RUNNING},
              {"rectify_to", &PipelineOptions::rectify_to,
               "the instant at which rectified points and the global-shutter image hold"},
          }};
}

ParameterGroup feature_tracks() {
  return {
      "feature tracks",
      "",
      {
          {"max_tracks", &Tracker::max_tracks, within(8, 10000), "corners that are followed"},
          {"track_min_distance", &Tracker::min_distance_px, within(2, 500, "px"), "between two tracks"},
          {"track_border", &Tracker::border_px, within(0, 500, "px"),
           "from the image's edge; corners that start nearer are soon shaken out again"},
          {"track_max_round_trip", &Tracker::max_round_trip_px, within(0.05, 10, "px"),
           "how far from its start a corner may end up when tracked back"},
          {"track_max_epipolar", &Tracker::max_epipolar_px, within(0.1, 20, "px"), "distance from the epipolar line"},
          {"track_window", &Tracker::window_px, within(5, 101, "px"), "odd; the side of the patch that is compared"},
          {"track_levels", &Tracker::levels, within(0, 6), "halvings of the image"},
      }};
}

}  // namespace

const std::vector<ParameterGroup>& parameter_groups() {
  static const std::vector<ParameterGroup> kGroups{
      calibration_files(), camera_timing(), image(),      gyroscope(), stereo(),        image_quality(),
      blur_field(),        wiener_filter(), validation(), keypoints(), feature_tracks()};
  return kGroups;
}

const Parameter* find_parameter(const std::string& key) {
  static const std::map<std::string, const Parameter*> kByKey = [] {
    std::map<std::string, const Parameter*> by_key;
    for (const ParameterGroup& group : parameter_groups()) {
      for (const Parameter& parameter : group.parameters) by_key.emplace(parameter.key, &parameter);
    }
    return by_key;
  }();
  const auto found = kByKey.find(key);
  return found == kByKey.end() ? nullptr : found->second;
}

}  // namespace gyro_deblur
