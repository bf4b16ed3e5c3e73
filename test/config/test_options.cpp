// The limits of the options, struct by struct.
#include "gyro_deblur/options.hpp"

#include <cmath>
#include <initializer_list>
#include <limits>
#include <string>

#include <gtest/gtest.h>

#include "gyro_deblur/config.hpp"
#include "option_error_text.hpp"

namespace gyro_deblur::options_test {
namespace {

using test::option_error;

/// Checks that `member` of Options takes the values inside and refuses those outside, naming `name`.
template <typename Options, typename T>
void expect_limits(T Options::*member, const char* name, std::initializer_list<T> inside,
                   std::initializer_list<T> outside) {
  EXPECT_NO_THROW(Options{}.validate());
  for (const T& value : inside) {
    Options options;
    options.*member = value;
    EXPECT_EQ(option_error([&] { options.validate(); }), "") << name;
  }
  for (const T& value : outside) {
    Options options;
    options.*member = value;
    EXPECT_EQ(option_error([&] { options.validate(); }).rfind(name, 0), 0u) << name << ' ' << value;
  }
}

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

TEST(Options, BlurFieldLimits) {
  using O = BlurFieldOptions;
  expect_limits(&O::block_size_px, "block_size", {8, 10, 1024}, {7, 9, 65, 1026, 0, -64});
  expect_limits(&O::min_extent_px, "min_extent", {1.0, 20.0}, {0.999, 20.001, kNan});
  expect_limits(&O::max_extent_px, "max_extent", {3.0, 500.0}, {2.999, 500.001, kNan});
  expect_limits(&O::curved_path_threshold_px, "curved_path_threshold", {0.0, 100.0}, {-0.001, 100.001, kNan});
}

TEST(Options, ValidationLimitsAndThreshold) {
  using O = ValidationOptions;
  expect_limits(&O::false_accept_rate, "validation_false_accept_rate", {0.001, 0.5}, {0.0, 0.00099, 0.501, kNan});
  expect_limits(&O::tau, "tau", {0.0, 255.0}, {-0.001, 255.001, kNan});
  expect_limits(&O::tau_contrast, "tau_contrast", {0.0, 1000.0}, {-0.001, 1000.001, kNan});
  O options;
  options.tau = 5;
  options.tau_contrast = 100;
  EXPECT_DOUBLE_EQ(options.threshold(20), 10);
}

TEST(Options, KernelLimits) {
  expect_limits(&FilterOptions::noise_to_signal_ratio, "noise_to_signal_ratio", {1e-5, 1.0},
                {0.99e-5, 1.001, 0.0, -1.0, kNan});
  expect_limits(&FilterOptions::length_factor, "filter_length_factor", {2.0, 8.0}, {1.999, 8.001, kNan});
}

TEST(Options, TrackerLimits) {
  using O = TrackerOptions;
  expect_limits(&O::max_tracks, "max_tracks", {8, 10000}, {7, 10001});
  expect_limits(&O::min_distance_px, "track_min_distance", {2.0, 500.0}, {1.999, 500.001, kNan});
  expect_limits(&O::border_px, "track_border", {0, 500}, {-1, 501});
  expect_limits(&O::max_epipolar_px, "track_max_epipolar", {0.1, 20.0}, {0.0999, 20.001, kNan});
  expect_limits(&O::window_px, "track_window", {5, 21, 101}, {3, 20, 103});
}

TEST(Options, TimeJumpLimits) {
  const TimeNs ms = 1'000'000, s = 1000 * ms;
  expect_limits(&Config::time_jump_ns, "time_jump_threshold", {10 * ms, 10 * s}, {10 * ms - 1, 10 * s + 1});
}

TEST(Options, SignificantBitsLimits) {
  expect_limits(&PipelineOptions::significant_bits, "significant_bits", {0, 8, 16}, {-1, 1, 7, 17});
}

TEST(Options, KeypointLimits) {
  using O = KeypointOptions;
  expect_limits<O, std::string>(&O::detector, "keypoint_detector", {"SIFT", "ORB", "AKAZE", "BRISK", "GFTT", "FAST"},
                                {"", "sift", "SURF"});
  expect_limits<O, std::string>(&O::descriptor, "keypoint_descriptor", {"SIFT", "BRISK", "NONE"},
                                {"", "GFTT", "AKAZE", "ORB"});  // the last two not with the detector SIFT
  expect_limits(&O::max_keypoints, "max_keypoints", {1, 100000}, {0, -1, 100001});
  expect_limits(&O::grid, "keypoint_grid", {1, 64}, {0, 65});
  O akaze;
  akaze.detector = akaze.descriptor = "AKAZE";
  EXPECT_NO_THROW(akaze.validate());
  O orb;
  orb.descriptor = "ORB";
  EXPECT_EQ(option_error([&] { orb.validate(); }),
            "keypoint_descriptor = \"ORB\" cannot describe the keypoints of keypoint_detector = \"SIFT\", only those "
            "of ORB AKAZE BRISK "
            "GFTT FAST");
  orb.detector = "FAST";
  EXPECT_NO_THROW(orb.validate());
  O unknown;
  unknown.detector = "SURF";
  EXPECT_NE(option_error([&] { unknown.validate(); }).find("SIFT ORB AKAZE BRISK GFTT FAST"), std::string::npos);
}

TEST(Options, GyroLimits) {
  using O = GyroOptions;
  const TimeNs ms = 1'000'000, s = 1000 * ms;
  const TimeNs any = 4'000'000'000 * s;  // between any two clocks of ros::Time
  expect_limits(&O::time_offset_ns, "time_offset", {-any, any}, {-any - s, any + s});
  expect_limits(&O::buffer_ns, "gyro_buffer_duration", {100 * ms + 1, 60 * s}, {100 * ms, 60 * s + 1, TimeNs{0}, -s});
  expect_limits(&O::max_gap_ns, "max_gyro_gap", {ms, s}, {ms - 1, s + 1, TimeNs{0}});
  expect_limits(&O::range_rad_s, "gyro_range", {0.0, 34.9, 400.0}, {-0.001, 400.001, 2000.0, kNan});
  for (int axis = 0; axis < 3; ++axis) {
    for (const double bad : {1.001, -1.001, kNan}) {
      O options;
      options.bias_rad_s[axis] = bad;
      EXPECT_NE(option_error([&] { options.validate(); }).find("gyro_bias"), std::string::npos);
    }
    O options;
    options.bias_rad_s[axis] = -1;
    EXPECT_NO_THROW(options.validate());
  }
}

}  // namespace
}  // namespace gyro_deblur::options_test
