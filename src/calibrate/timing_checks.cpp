#include "calibrate/timing_checks.hpp"

#include <cmath>
#include <cstdio>

#include "gyro_deblur/option_error.hpp"

namespace gyro_deblur {
namespace {

template <typename... Values>
std::string text_of(const char* format, Values... values) {
  char text[400];
  std::snprintf(text, sizeof(text), format, values...);
  return text;
}

/// Rotation by the gyroscope takes most of the motion away, save where translation undoes it in the image; translation
/// is modelled, and then little is left over. Of images from which 50 % of a shake were taken, 10 % are left over, of
/// good footage 1 to 4 %.
std::string stabilised(const TimingEstimate& estimate, const TimingOptions& options) {
  constexpr double kLeastLeftByGyro = 0.9, kMostLeftOver = 0.05;
  const double without_px = estimate.median_without_px;
  if (estimate.median_at_start_px < kLeastLeftByGyro * without_px || estimate.median_px < kMostLeftOver * without_px) {
    return {};
  }
  return text_of(
             "the images do not move as the gyroscope turned: the median residual is %.2f px without the gyroscope, "
             "%.2f px with it, and %.2f px after the estimation; switch electronic stabilisation off",
             without_px, estimate.median_at_start_px, estimate.median_px) +
         (options.R_cam_imu ? ", or let --estimate-rotation find another R_cam_imu" : "");
}

std::string at_search_limit(const TimingEstimate& estimate, const TimingOptions& options) {
  // Of the search by correlation; the estimation moves on by some.
  constexpr double kMarginS = 2e-3;
  const double search_s = to_seconds(options.search_ns), center_s = to_seconds(options.time_offset_ns);
  if (options.search_ns == 0 || std::abs(estimate.time_offset_s.value - center_s) < search_s - kMarginS) return {};
  return text_of(
      "time_offset = %.6f s is at the limit of the search, %g s around %g s: widen it with --search, or give "
      "time_offset in --config",
      estimate.time_offset_s.value, search_s, center_s);
}

std::string loose_rotation(const TimingEstimate& estimate) {
  constexpr double kDegPerRad = 180 / M_PI, kLoosestDeg = 5;
  const double stddev_deg = estimate.rotation_stddev_rad.maxCoeff() * kDegPerRad;
  if (stddev_deg <= kLoosestDeg) return {};
  return text_of(
      "R_cam_imu has a standard deviation of %.1f degrees, %g at most are of use: turn the camera about all axes, or "
      "give R_cam_imu",
      stddev_deg, kLoosestDeg);
}

std::string impossible_readout(const TimingEstimate& estimate, const FramePeriod& period) {
  try {
    period.require_plausible_readout("readout_time", to_ns(estimate.readout_s.value));
  } catch (const OptionError& error) {
    return std::string(error.what()) + " Record faster turns, or give it in --config with --fixed-readout";
  }
  return {};
}

}  // namespace

std::vector<std::string> timing_objections(const TimingEstimate& estimate, const TimingOptions& options,
                                           const FramePeriod& period) {
  std::vector<std::string> objections;
  for (const std::string& text : {stabilised(estimate, options), at_search_limit(estimate, options),
                                  impossible_readout(estimate, period), loose_rotation(estimate)}) {
    if (!text.empty()) objections.push_back(text);
  }
  return objections;
}

}  // namespace gyro_deblur
