#include "gyro_deblur/options.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <sstream>

namespace gyro_deblur {
namespace {

template <std::size_t N>
void require_one_of(const char* name, const std::string& value, const std::array<const char*, N>& allowed) {
  if (std::find(allowed.begin(), allowed.end(), value) != allowed.end()) return;
  std::ostringstream message;
  message << name << " = \"" << value << "\" is not one of";
  for (const char* word : allowed) message << ' ' << word;
  throw OptionError(message.str());
}

}  // namespace

void BlurFieldOptions::validate() const {
  require_range("block_size", block_size_px, 8, 1024, "px");
  if (block_size_px % 2 != 0) {
    throw OptionError("block_size = " + std::to_string(block_size_px) +
                      " is odd; allowed are even sizes in [8, 1024] px");
  }
  require_range("min_extent", min_extent_px, 1, 20, "px");
  require_range("max_extent", max_extent_px, min_extent_px, 500, "px");
  require_range("max_bend", max_bend_px, 0, 100, "px");
}

void ValidationOptions::validate() const {
  require_range("tau", tau, 0, 255, "grey levels / px");
  require_range("tau_contrast", tau_contrast, 0, 1000, "grey levels");
}

void KernelOptions::validate() const {
  require_range("gamma", gamma, 1e-5, 1);
  require_range("kernel_length_factor", length_factor, 2, 8);
  require_range("kernel_smoothing", smoothing_px, 0, 5, "px");
}

void KeypointOptions::validate() const {
  require_one_of("detector", detector, std::array<const char*, 6>{"SIFT", "ORB", "AKAZE", "BRISK", "GFTT", "FAST"});
  require_one_of("descriptor", descriptor, std::array<const char*, 5>{"SIFT", "ORB", "AKAZE", "BRISK", "NONE"});
  // AKAZE describes in its own scale space and refuses keypoints that do not come from it.
  if (descriptor == "AKAZE" && detector != "AKAZE") {
    throw OptionError("descriptor = \"AKAZE\" needs detector \"AKAZE\", not \"" + detector + "\"");
  }
  require_range("max_features", max_features, 1, 100000);
  require_range("grid_cols", grid_cols, 1, 64);
  require_range("grid_rows", grid_rows, 1, 64);
}

void TrackerOptions::validate() const {
  require_range("max_tracks", max_tracks, 8, 10000);
  require_range("track_min_distance", min_distance_px, 2, 500, "px");
  require_range("track_max_round_trip", max_round_trip_px, 0.05, 10, "px");
  require_range("track_max_epipolar", max_epipolar_px, 0.1, 20, "px");
  require_range("track_border", border_px, 0, 500, "px");
  require_range("track_window", window_px, 5, 101, "px");
  if (window_px % 2 == 0) {
    throw OptionError("track_window = " + std::to_string(window_px) + " is even; allowed are odd sizes in [5, 101] px");
  }
  require_range("track_levels", levels, 0, 6);
}

void GyroOptions::validate() const {
  for (int axis = 0; axis < 3; ++axis) require_range("gyro_bias", bias_rad_s[axis], -1, 1, "rad/s");
  require_range("time_offset", to_seconds(time_offset_ns), -10, 10, "s");
  require_range("gyro_buffer_duration", to_seconds(buffer_ns), to_seconds(100'000'001), 60, "s");
  require_range("max_gyro_gap", to_seconds(max_gap_ns), 1e-3, 1, "s");
  require_range("gyro_range", range_rad_s, 0, 400, "rad/s");  // beyond the fastest sensors, 20000 degrees/s
}

void TranslationOptions::validate() const {
  constexpr double kAboveZero = std::numeric_limits<double>::min();
  require_range("scene_depth", scene_depth_m, 0, 1000, "m");
  require_range("scene_depth_max_age", to_seconds(depth_max_age_ns), 0, 60, "s");
  require_range("odometry_max_age", to_seconds(max_age_ns), 1e-3, 2, "s");
  require_range("odometry_max_speed", max_speed_m_s, kAboveZero, 1000, "m/s");
  require_range("odometry_max_acceleration", max_acceleration_m_s2, kAboveZero, 10000, "m/s^2");
  require_range("odometry_max_stddev", max_stddev_m_s, kAboveZero, 100, "m/s");
}

}  // namespace gyro_deblur
