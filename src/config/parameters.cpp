// The table of parameters.
#include "config/parameters.hpp"

#include <algorithm>
#include <utility>

namespace gyro_deblur {
namespace {

/// Where a configuration has the struct: each occurs once.
template <typename Owner, typename AnyConfig>
auto& part(AnyConfig& config) {
  if constexpr (std::is_same_v<Owner, BlurFieldOptions>) return config.pipeline.blur_field;
  if constexpr (std::is_same_v<Owner, ValidationOptions>) return config.pipeline.validation;
  if constexpr (std::is_same_v<Owner, FilterOptions>) return config.pipeline.filter;
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

// The table: one row for each parameter, with key, member, limits and unit, text, and whether it may change while
// running. The order is that of the documents.

using Blur = BlurFieldOptions;
using Validation = ValidationOptions;
using Filter = FilterOptions;
using Keypoints = KeypointOptions;
using Tracker = TrackerOptions;
using Gyro = GyroOptions;
using Shutter = ShutterTiming;

ParameterGroup calibration_files() {
  return {"calibration files",
          "Formats: Kalibr's camchain-imucam.yaml (also used by OpenVINS), EuRoC's sensor.yaml, the configuration of "
          "VINS-Mono and VINS-Fusion, Basalt's JSON, camera_calibration's YAML. Values of a file need no key below. "
          "If both give a value, they have to agree.",
          {
              {"calibration_file", &Config::calibration_files,
               "Path of a calibration file, or a list of paths, relative to the configuration file. The nodelet needs "
               "absolute paths. '': none."},
              {"calibration_camera", &Config::calibration_camera,
               "Name of the camera within the calibration file: cam0, cam1, ..."},
              {"on_calibration_conflict", &Config::on_calibration_conflict,
               "What happens when calibrations contradict each other. error: parameters that contradict the "
               "calibration file are refused, and frames are passed through unchanged if camera_info or tf "
               "contradict either. configured: parameters win over the file, and both over camera_info and tf."},
          }};
}

ParameterGroup camera_timing() {
  return {
      "camera timing",
      "",
      {
          Parameter("exposure_time", &Shutter::exposure_ns, above(0, 1, "s"),
                    "Exposure time of each row, used for images without an exposure message. '': it is estimated from "
                    "the blur of the images.")
              .may_be_empty(&GivenNumbers::exposure_time),
          {"exposure_source", &Config::exposure_source,
           "Content of the exposure topic. auto: gyro_deblur/Exposure or RealSense metadata, recognised by the message "
           "type. message: gyro_deblur/Exposure. field_UNIT: the field exposure_field of any message. "
           "realsense_metadata_UNIT: RealSense metadata (us for infrared, 100us for colour cameras); exposure_field is "
           "actual_exposure unless set. dynamic_reconfigure_UNIT: the parameter exposure_field of a driver's "
           "parameter_updates."},
          {"on_exposure_conflict", &Config::on_exposure_conflict,
           "What happens when the blur contradicts an exposure time by more than 8 % for 2 s, or exposure_time "
           "is longer than the frame period. images: the estimate from the images replaces exposure_time, but "
           "not exposure messages. configured: the given time stays in use; while exposure_time is longer than "
           "the frame period, frames are passed through unchanged. Both report it."},
          {"exposure_field", &ExposureSource::field,
           "Field or parameter that holds the exposure time, for example exposure_time or exposures[0].shutterms."},
          {"exposure_max_age", &Config::exposure_max_age_ns, within(0, 60, "s"),
           "How long the last exposure message is used for images that have none of their own. 0: never."},
          Parameter(
              "readout_time", &Shutter::readout_ns, within(-1, 1, "s"),
              "Number of rows times the time of one row. 0: global shutter. Negative: the bottom row comes first. "
              "'': not known, see self_calibration.")
              .may_be_empty(&GivenNumbers::readout_time),
          {"stamp_row", &Shutter::stamp_row, "Image row that the stamp refers to."},
          {"stamp_phase", &Shutter::stamp_phase, "Instant of that row's exposure that the stamp refers to."},
          {"rectified_input", &Config::rectified_input,
           "true: the images are rectified, and P and R of camera_info describe them. false: D and K describe them."},
      }};
}

ParameterGroup image() {
  return {"image",
          "",
          {
              {"significant_bits", &PipelineOptions::significant_bits, within(0, 16),
               "Bits of a 16-bit image that hold data, 8 to 16. 0: the fewest of 10, 12, 14 and 16 that have held "
               "every pixel so far.",
               RUNNING},
              {"mask", &Config::mask_file,
               "PNG or PGM file (mono8, as large as the images). Pixels of 0, such as a lens rim or a part of the "
               "vehicle, are not deblurred, tracked or described. Relative paths as in calibration_file. The topic "
               "mask replaces the file. '': none."},
          }};
}

ParameterGroup gyroscope() {
  return {
      "gyroscope",
      "",
      {
          // One clock may count from 1970 and the other from when it was switched on. ros::Time ends after 4.3e9 s,
          // a sum of both fits into 64 bits of nanoseconds.
          Parameter("time_offset", &Gyro::time_offset_ns, within(-4e9, 4e9, "s"),
                    "Offset of the clocks: t_imu = t_cam + time_offset. For Kalibr's value see "
                    "doc/guides/calibration.md. '': not known, see self_calibration.")
              .may_be_empty(&GivenNumbers::time_offset),
          {"R_cam_imu", &Config::R_cam_imu,
           "Rotation from IMU to camera coordinates (of Kalibr's T_cam_imu), row by row. []: taken from tf, otherwise "
           "see self_calibration."},
          Parameter("gyro_bias", &Gyro::bias_rad_s, within(-1, 1, "rad/s"),
                    "Bias [x, y, z] in the IMU's axes, subtracted from the angular rates. '': not known, see "
                    "self_calibration.")
              .may_be_empty(&GivenNumbers::gyro_bias),
          {"self_calibration", &Config::self_calibration,
           "auto: the images give readout_time, time_offset, R_cam_imu and gyro_bias where these are empty; an "
           "estimate is used once it is certain. Values that are set stay in use (only a calibration file "
           "replaces a 0), and a contradiction is reported. never: nothing is estimated or compared."},
          {"max_gyro_gap", &Gyro::max_gap_ns, within(0.001, 1, "s"),
           "Longest gap between gyroscope samples that is integrated across. The gyroscope does not cover rows "
           "whose exposure meets a longer one."},
          // Up to the fastest sensors, 20000 degrees/s.
          {"gyro_range", &Gyro::range_rad_s, within(0, 400, "rad/s"),
           "Range of the gyroscope on each axis (2000 degrees/s: 34.9). A sample that reaches it is saturated, "
           "and the gyroscope does not cover rows whose exposure needs it. 0: not known, nothing is checked."},
          {"input_timeout", &Config::input_timeout_ns, within(0, 10, "s"),
           "Longest time that a frame waits for gyroscope samples, camera_info, exposure and tf."},
          {"frame_queue_size", &Config::frame_queue_size, within(1, 1000),
           "Most frames that wait for other messages. When more arrive, the oldest is passed through unchanged."},
          {"bias_max_stddev", &Config::bias_max_stddev_rad_s, above(0, 1, "rad/s"),
           "Largest standard deviation of the rates at which ~estimate_gyro_bias takes the sensor to be at rest."},
      }};
}

ParameterGroup stereo() {
  return {"stereo",
          "",
          {
              {"stereo_sync_timeout", &Config::stereo_sync_timeout_ns, within(0, 10, "s"),
               "Longest time that an image waits for the other image of its stereo pair. Cameras in one process that "
               "share an IMU deblur both images of a pair or neither. 0: each camera on its own."},
          }};
}

ParameterGroup image_quality() {
  return {"image quality",
          "",
          {
              {"drop_poor", &Config::drop_poor,
               "true: an image of grade POOR is not published, nor its keypoints and tracks. false: one image "
               "is published for every image received.",
               RUNNING},
          }};
}

ParameterGroup blur_field() {
  return {"blur field",
          "",
          {
              {"block_size", &Blur::block_size_px, within(8, 1024, "px"),
               "Side of a block, an even number. All pixels of a block are deblurred with one blur.", RUNNING},
              {"min_extent", &Blur::min_extent_px, within(1, 20, "px"),
               "A block is passed through unchanged if its blur is shorter, or could be once the uncertainty of its "
               "velocity is taken into account.",
               RUNNING},
              {"max_extent", &Blur::max_extent_px, within(1, 500, "px"),
               "Blocks with a longer blur are passed through unchanged. At least min_extent.", RUNNING},
              {"curved_path_threshold", &Blur::curved_path_threshold_px, within(0, 100, "px"),
               "A path counts as curved if it deviates from a straight line by more than this plus 2 % of its length. "
               "Curved blur gets 2-D filters, which take about three times as long as 1-D filters.",
               RUNNING},
              {"optical_flow", &PipelineOptions::optical_flow,
               "true: optical flow between images adds the motion that the gyroscope does not measure, for example "
               "translation. false: the blur follows from the rotation alone.",
               RUNNING},
              {"flow_without_gyro", &PipelineOptions::flow_without_gyro, one_of({"absent", "always", "never"}),
               "Which frames with rows that the gyroscope does not cover are deblurred by optical flow alone; in "
               "others these rows are passed through unchanged. absent: those of a camera whose IMU is absent or "
               "silent. always: also those at gaps and saturated samples. never: none.",
               RUNNING},
          }};
}

ParameterGroup wiener_filter() {
  return {"Wiener filter",
          "",
          {
              {"noise_to_signal_ratio", &Filter::noise_to_signal_ratio, within(1e-5, 1),
               "Noise-to-signal ratio of the filter at 1/6 cycles/px. A larger value amplifies less noise and restores "
               "less detail.",
               RUNNING},
              {"regularization", &Filter::regularization,
               "How noise_to_signal_ratio is used. adaptive: it rises with the noise of a block over its texture, and "
               "blocks that noise "
               "would spoil are passed through unchanged. fixed: as set. paper: as set and the same at every "
               "frequency, as in the paper."},
              {"engine", &PipelineOptions::engine,
               "Implementation of the filters. auto: cpu. cpu: 1-D filters for straight blur, 2-D filters for curved "
               "blur. fourier: 2-D filters for all blocks. float: like cpu, in floating point. opencl: the first GPU, "
               "otherwise the first device. opencl:INDEX, opencl:NAME (part of the name): that device. Where a device "
               "is absent or fails, cpu replaces it with one warning."},
              {"threads", &PipelineOptions::threads, within(0, 256),
               "Most threads of validation, filter design and engine. 0: one for each available core."},
          }};
}

ParameterGroup validation() {
  return {"validation",
          "",
          {
              {"validation", &Validation::rule,
               "How a block is compared with its predicted blur. A block that contradicts it is passed through "
               "unchanged. likelihood: by its power spectrum, which resists noise. gradient: by its strongest gradient "
               "along the motion, as in the paper. none: not at all.",
               RUNNING},
          }};
}

ParameterGroup keypoints() {
  return {"keypoints",
          "",
          {
              {"keypoint_detector", &Keypoints::detector, one_of({"SIFT", "ORB", "AKAZE", "BRISK", "GFTT", "FAST"}),
               "Detector of the keypoints.", RUNNING},
              {"keypoint_descriptor", &Keypoints::descriptor, one_of({"SIFT", "ORB", "AKAZE", "BRISK", "NONE"}),
               "Descriptor of the keypoints. AKAZE needs detector AKAZE, ORB any detector but SIFT. NONE: no "
               "descriptors.",
               RUNNING},
              {"max_keypoints", &Keypoints::max_keypoints, within(1, 100000),
               "Most keypoints of an image. The strongest are kept.", RUNNING},
              {"keypoint_grid", &Keypoints::grid, within(1, 64),
               "Columns, and rows, of the grid whose cells share max_keypoints evenly. 1: the strongest of the whole "
               "image.",
               RUNNING},
              {"rectify_to", &PipelineOptions::rectify_to,
               "Instant at which rectified keypoints and the global-shutter image hold."},
          }};
}

ParameterGroup feature_tracks() {
  return {"feature tracks",
          "",
          {
              {"max_tracks", &Tracker::max_tracks, within(8, 10000), "Most corners that are tracked."},
              {"track_min_distance", &Tracker::min_distance_px, within(2, 500, "px"),
               "Smallest distance between two tracks. A smaller value allows more tracks where there is texture."},
          }};
}

/// What one value serves everywhere. Tests and experiments set these members; the texts are the reasons.
std::vector<Parameter> make_constants() {
  return {
      {"tau", &Validation::tau, within(0, 255, "grey levels / px"),
       "With tau_contrast it accepts 98.6 % of truly blurred blocks at every extent (doc/reports/validation.md)."},
      {"tau_contrast", &Validation::tau_contrast, within(0, 1000, "grey levels"),
       "With tau it accepts 98.6 % of truly blurred blocks at every extent (doc/reports/validation.md)."},
      {"validation_false_accept_rate", &Validation::false_accept_rate, within(0.001, 0.5),
       "Less rejects recorded blur that is longer than predicted (doc/reports/validation.md)."},
      {"filter_length_factor", &Filter::length_factor, within(2, 8),
       "8 restores at most 0.5 dB more at twice the cost (doc/reports/experiments.md)."},
      {"filter_smoothing", &Filter::smoothing_px, within(0, 5, "px"),
       "Smoothing moves deblurred images away from sharp ones (doc/reports/experiments_real_world.md)."},
      {"read_noise", &NoiseModel::read_noise, within(0, 50, "grey levels"),
       "0: the noise is estimated from each image, also where the gain changes (doc/reports/experiments.md)."},
      {"photon_gain", &NoiseModel::photon_gain, within(0, 10, "grey levels"),
       "0: the noise is estimated from each image."},
      {"global_shutter_border", &PipelineOptions::global_shutter_border,
       "Black shows where the image ends, and the trust mask marks it."},
      {"gyro_buffer_duration", &Gyro::buffer_ns, above(0.1, 60, "s"), "Longer than any camera's latency."},
      {"bias_window", &Config::bias_window_ns, within(0.1, 10, "s"), "200 samples of a slow IMU, and no long wait."},
      {"time_jump_threshold", &Config::time_jump_ns, within(0.01, 10, "s"),
       "More than stamps of one clock are out of order, less than a bag that is played again goes back."},
      {"track_border", &Tracker::border_px, within(0, 500, "px"),
       "Nearer to the edge a shake takes most corners out again within a few images (doc/reports/slam.md)."},
      {"track_max_round_trip", &Tracker::max_round_trip_px, within(0.05, 10, "px"), "As in VINS-Mono's tracker."},
      {"track_max_epipolar", &Tracker::max_epipolar_px, within(0.1, 20, "px"), "As in VINS-Mono's tracker."},
      {"track_window", &Tracker::window_px, within(5, 101, "px"), "As in VINS-Mono's tracker."},
      {"track_levels", &Tracker::levels, within(0, 6), "As in VINS-Mono's tracker."},
  };
}

/// The row with that key, or null.
const Parameter* find(const std::vector<Parameter>& rows, const std::string& key) {
  const auto found = std::find_if(rows.begin(), rows.end(), [&](const Parameter& row) { return row.key == key; });
  return found == rows.end() ? nullptr : &*found;
}

}  // namespace

const std::vector<ParameterGroup>& parameter_groups() {
  static const std::vector<ParameterGroup> kGroups{
      calibration_files(), camera_timing(), image(),      gyroscope(), stereo(),        image_quality(),
      blur_field(),        wiener_filter(), validation(), keypoints(), feature_tracks()};
  return kGroups;
}

const std::vector<Parameter>& constants() {
  static const std::vector<Parameter> kConstants = make_constants();
  return kConstants;
}

const Parameter* find_parameter(const std::string& key) {
  for (const ParameterGroup& group : parameter_groups()) {
    if (const Parameter* row = find(group.parameters, key)) return row;
  }
  return nullptr;
}

const Parameter* find_constant(const std::string& key) { return find(constants(), key); }

}  // namespace gyro_deblur
