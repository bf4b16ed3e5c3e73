// The parameters and constants of options.hpp: a row for each member, with key, allowed values and text.
#pragma once

#include "base/parameter_table.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

inline Names<RectifyTo> names_of(RectifyTo) {
  return {{"middle_row", RectifyTo::MIDDLE_ROW},
          {"first_row", RectifyTo::FIRST_ROW},
          {"last_row", RectifyTo::LAST_ROW},
          {"stamp", RectifyTo::STAMP}};
}

inline Names<Regularization> names_of(Regularization) {
  return {{"adaptive", Regularization::ADAPTIVE}, {"fixed", Regularization::FIXED}, {"paper", Regularization::PAPER}};
}

inline Names<ValidationRule> names_of(ValidationRule) {
  return {{"likelihood", ValidationRule::LIKELIHOOD},
          {"gradient", ValidationRule::GRADIENT},
          {"none", ValidationRule::NONE}};
}

/// Those that messages name, too.
inline const OneOf kDetectors{"SIFT", "ORB", "AKAZE", "BRISK", "GFTT", "FAST"};
inline constexpr Limits kBlockSizes = within(8, 1024, "px"), kMaxExtents = within(1, 500, "px"),
                        kTrackWindows = within(5, 101, "px");

template <typename V>
void visit(Table<BlurFieldOptions>, V&& visitor) {
  using O = BlurFieldOptions;
  visitor.group("blur field");
  visitor(
      {"block_size", kBlockSizes, "Side of a block, an even number. All pixels of a block are deblurred with one blur.",
       Change::WHILE_RUNNING},
      &O::block_size_px);
  visitor({"min_extent", within(1, 20, "px"),
           "A block is passed through unchanged if its blur is shorter, or could be once the uncertainty of its "
           "velocity is taken into account.",
           Change::WHILE_RUNNING},
          &O::min_extent_px);
  visitor({"max_extent", kMaxExtents, "Blocks with a longer blur are passed through unchanged. At least min_extent.",
           Change::WHILE_RUNNING},
          &O::max_extent_px);
  visitor(
      {"curved_path_threshold", within(0, 100, "px"),
       "A path counts as curved if it deviates from a straight line by more than this plus 2 % of its length, or from "
       "uniform speed by more than this plus 0.25 px (above 20 px of blur: more). Curved blur gets 2-D filters, which "
       "take two to four times as long as 1-D filters.",
       Change::WHILE_RUNNING},
      &O::curved_path_threshold_px);
}

template <typename V>
void visit(Table<FilterOptions>, V&& visitor) {
  using O = FilterOptions;
  visitor.group("Wiener filter");
  visitor({"noise_to_signal_ratio", within(1e-5, 1),
           "Noise-to-signal ratio of the filter at 1/6 cycles/px. A larger value amplifies less noise and restores "
           "less detail.",
           Change::WHILE_RUNNING},
          &O::noise_to_signal_ratio);
  visitor({"regularization",
           "How noise_to_signal_ratio is used. adaptive: it rises with the noise of a block over its texture, and "
           "blocks that noise would spoil are passed through unchanged. fixed: as set. paper: as set and the same at "
           "every frequency, as in the paper."},
          &O::regularization);
  visitor({"filter_length_factor", within(2, 8),
           "8 restores at most 0.5 dB more at twice the cost (doc/reports/experiments.md).", Change::NEVER},
          &O::length_factor);
}

template <typename V>
void visit(Table<ValidationOptions>, V&& visitor) {
  using O = ValidationOptions;
  visitor.group("validation");
  visitor({"validation",
           "How a block is compared with its predicted blur. A block that contradicts it is passed through "
           "unchanged. likelihood: by its power spectrum, which resists noise. gradient: by its strongest gradient "
           "along the motion, as in the paper. none: not at all.",
           Change::WHILE_RUNNING},
          &O::rule);
  visitor({"validation_false_accept_rate", within(0.001, 0.5),
           "Less rejects recorded blur whose path is roughly known (doc/reports/validation.md).", Change::NEVER},
          &O::false_accept_rate);
  visitor({"tau", within(0, 255, "grey levels / px"),
           "With tau_contrast it accepts 98.6 % of truly blurred blocks at every extent (doc/reports/validation.md).",
           Change::NEVER},
          &O::tau);
  visitor({"tau_contrast", within(0, 1000, "grey levels"),
           "With tau it accepts 98.6 % of truly blurred blocks at every extent (doc/reports/validation.md).",
           Change::NEVER},
          &O::tau_contrast);
}

template <typename V>
void visit(Table<KeypointOptions>, V&& visitor) {
  using O = KeypointOptions;
  visitor.group("keypoints");
  visitor({"keypoint_detector", kDetectors, "Detector of the keypoints.", Change::WHILE_RUNNING}, &O::detector);
  visitor({"keypoint_descriptor", OneOf{"SIFT", "ORB", "AKAZE", "BRISK", "NONE"},
           "Descriptor of the keypoints. AKAZE needs detector AKAZE, ORB any detector but SIFT. NONE: no descriptors.",
           Change::WHILE_RUNNING},
          &O::descriptor);
  visitor({"max_keypoints", within(1, 100000), "Most keypoints of an image. The strongest are kept.",
           Change::WHILE_RUNNING},
          &O::max_keypoints);
  visitor({"keypoint_grid", within(1, 64),
           "Columns, and rows, of the grid whose cells share max_keypoints evenly. 1: the strongest of the whole "
           "image.",
           Change::WHILE_RUNNING},
          &O::grid);
}

template <typename V>
void visit(Table<PipelineOptions>, V&& visitor) {
  using O = PipelineOptions;
  visitor.group("image");
  visitor({"significant_bits", within(0, 16),
           "Bits of a 16-bit image that hold data, 8 to 16. 0: the fewest of 10, 12, 14 and 16 that have held every "
           "pixel so far.",
           Change::WHILE_RUNNING},
          &O::significant_bits);
  visitor.part(&O::blur_field);
  visitor({"optical_flow",
           "true: optical flow between images adds the motion that the gyroscope does not measure, for example "
           "translation. false: the blur follows from the rotation alone.",
           Change::WHILE_RUNNING},
          &O::optical_flow);
  visitor({"flow_without_gyro", OneOf{"absent", "always", "never"},
           "Which frames with rows that the gyroscope does not cover are deblurred by optical flow alone; in others "
           "these rows are passed through unchanged. absent: those of a camera that is not calibrated, or "
           "whose IMU is absent or silent. always: also those at gaps and saturated samples. never: none.",
           Change::WHILE_RUNNING},
          &O::flow_without_gyro);
  visitor.part(&O::filter);
  visitor({"engine",
           "Implementation of the filters. auto: cpu. cpu: 1-D filters for straight blur, 2-D filters for curved blur. "
           "fourier: 2-D filters for all blocks. float: like cpu, in floating point. opencl: the first GPU, otherwise "
           "the first device. opencl:INDEX, opencl:NAME (part of the name): that device. Where a device is absent or "
           "fails, cpu replaces it with one warning."},
          &O::engine);
  visitor({"threads", within(0, 256),
           "Most threads of this package's loops over one image. 0: one for each available core."},
          &O::threads);
  visitor.part(&O::validation);
  visitor.part(&O::keypoints);
  visitor({"rectify_to", "Instant at which rectified keypoints and the global-shutter image hold."}, &O::rectify_to);
}

template <typename V>
void visit(Table<TrackerOptions>, V&& visitor) {
  using O = TrackerOptions;
  visitor.group("feature tracks");
  visitor({"max_tracks", within(8, 10000), "Most corners that are tracked."}, &O::max_tracks);
  visitor({"track_min_distance", within(2, 500, "px"),
           "Smallest distance between two tracks. A smaller value allows more tracks where there is texture."},
          &O::min_distance_px);
  visitor({"track_border", within(0, 500, "px"),
           "Nearer to the edge a shake takes most corners out again within a few images (doc/reports/slam.md).",
           Change::NEVER},
          &O::border_px);
  visitor({"track_max_epipolar", within(0.1, 20, "px"), "As in VINS-Mono's tracker.", Change::NEVER},
          &O::max_epipolar_px);
  visitor({"track_window", kTrackWindows, "As in VINS-Mono's tracker.", Change::NEVER}, &O::window_px);
}

template <typename V>
void visit(Table<GyroOptions>, V&& visitor) {
  using O = GyroOptions;
  visitor.group("gyroscope");
  // One clock may count from 1970 and the other from when it was switched on. ros::Time ends after 4.3e9 s, a sum of
  // both fits into 64 bits of nanoseconds.
  visitor({"time_offset", within(-4e9, 4e9, "s"),
           "Offset of the clocks: t_imu = t_cam + time_offset. For Kalibr's value see doc/guides/calibration.md. '': "
           "not known, see self_calibration."},
          &O::time_offset_ns);
  visitor({"gyro_bias", within(-1, 1, "rad/s"),
           "Bias [x, y, z] in the IMU's axes, subtracted from the angular rates. '': not known, see self_calibration."},
          &O::bias_rad_s);
  visitor({"max_gyro_gap", within(0.001, 1, "s"),
           "Longest gap between gyroscope samples that is integrated across. The gyroscope does not cover rows whose "
           "exposure meets a longer one."},
          &O::max_gap_ns);
  // Up to the fastest sensors, 20000 degrees/s.
  visitor({"gyro_range", within(0, 400, "rad/s"),
           "Range of the gyroscope on each axis (2000 degrees/s: 34.9). A sample that reaches it is saturated, and "
           "the gyroscope does not cover rows whose exposure needs it. 0: not known, nothing is checked."},
          &O::range_rad_s);
  visitor({"gyro_buffer_duration", above(0.1, 60, "s"), "Longer than any camera's latency.", Change::NEVER},
          &O::buffer_ns);
}

}  // namespace gyro_deblur
