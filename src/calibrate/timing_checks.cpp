// Checks of an estimated timing, and what to record if one fails.
#include "calibrate/timing_checks.hpp"

#include <algorithm>
#include <cmath>

#include "base/format.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

/// Rotation by the gyroscope takes most of the motion away, save where translation undoes it in the image; translation
/// is modelled, and then little is left over. Of images from which 50 % of a shake were taken, 10 % are left over, of
/// good footage 1 to 4 %.
std::string stabilised(const TimingEstimate& estimate, const TimingOptions& options) {
  constexpr double kLeastLeftByGyro = 0.9, kMostLeftOver = 0.05;
  const double without_px = estimate.median_without_px;
  if (estimate.median_at_start_px < kLeastLeftByGyro * without_px || estimate.median_px < kMostLeftOver * without_px) {
    return {};
  }
  return format(
             "the images do not move as the gyroscope rotated: the median residual is %.2f px without the gyroscope, "
             "%.2f px with it, and %.2f px after the estimation; switch electronic stabilisation off",
             without_px, estimate.median_at_start_px, estimate.median_px) +
         (options.R_cam_imu ? ", or let --estimate-rotation find another R_cam_imu" : "");
}

/// A camera at rest.
std::string motionless(const TimingEstimate& estimate) {
  constexpr double kLeastPx = 1;
  if (estimate.median_without_px >= kLeastPx) return {};
  return format(
      "the images hardly move: corners move by %.2f px within three frames in the median, %g px are needed; rotate the "
      "camera about all axes",
      estimate.median_without_px, kLeastPx);
}

std::string at_search_limit(const TimingEstimate& estimate, const TimingOptions& options) {
  // Tolerance at the end of the search by correlation: the estimation changes the offset by some.
  constexpr double kMarginS = 2e-3;
  const double search_s = to_seconds(options.search_ns), center_s = to_seconds(options.gyro.time_offset_ns);
  if (options.search_ns == 0 || std::abs(estimate.time_offset_s.value - center_s) < search_s - kMarginS) return {};
  return format(
      "time_offset = %.6f s is at the limit of the search, %g s around %g s: widen it with --search, or give "
      "time_offset in --config",
      estimate.time_offset_s.value, search_s, center_s);
}

/// The objection to a value that is not known well enough to be of use; else empty.
/// @param scale   to the unit of the text
/// @param digits  after the decimal point
std::string loose(const char* key, double stddev, double limit, double scale, int digits, const char* unit,
                  const char* remedy) {
  if (stddev <= limit) return {};
  return format("%s has a standard deviation of %.*f %s, %g at most are of use: %s", key, digits, scale * stddev, unit,
                scale * limit, remedy);
}

std::string contradicted_offset(const TimingEstimate& estimate, const LearnedCalibration& coarse) {
  constexpr double kForgivenS = 0.02, kSignificance = 4;
  const Learned<double>& other = coarse.time_offset_s;
  const double off_s = std::abs(estimate.time_offset_s.value - other.value);
  if (!other.known || off_s < std::max(kForgivenS, kSignificance * other.stddev)) return {};
  return format(
      "time_offset = %.4f s by the angular speeds, %.4f s by the angular rates about all axes: the motion repeats "
      "itself; rotate the camera irregularly",
      estimate.time_offset_s.value, other.value);
}

std::string impossible_readout(const TimingEstimate& estimate, const FramePeriod& period) {
  try {
    period.require_plausible_readout("readout_time", to_ns(estimate.readout_s.value));
  } catch (const OptionError& error) {
    return std::string(error.what()) + " Record faster rotation, or give it in --config with --fixed-readout";
  }
  return {};
}

}  // namespace

LearnedCalibration coarse_calibration(const std::vector<ImageRate>& rates, const std::vector<GyroSample>& samples,
                                      TimeNs time_offset_ns, TimeNs search_ns) {
  constexpr TimeNs kShortestSearchNs = 100'000'000;
  search_ns = std::max(search_ns, kShortestSearchNs);
  SelfCalibration calibration(time_offset_ns, search_ns);
  auto next = samples.begin();
  for (const ImageRate& rate : rates) {
    const TimeNs until_ns = rate.end_ns + time_offset_ns + 2 * search_ns;
    for (; next != samples.end() && next->t_ns <= until_ns; ++next) calibration.add_sample(*next);
    calibration.add_rate(rate);
    if (calibration.is_due()) calibration.update();
  }
  calibration.update();
  return calibration.learned();
}

std::vector<TimingObjection> timing_objections(const TimingEstimate& estimate, const TimingOptions& options,
                                               const FramePeriod& period, const LearnedCalibration& coarse) {
  std::vector<TimingObjection> objections;
  const std::string still = motionless(estimate);
  const Estimate(&bias)[3] = estimate.bias_rad_s;
  const double bias_stddev_rad_s = std::max({bias[0].stddev, bias[1].stddev, bias[2].stddev});
  for (const TimingObjection& objection :
       {TimingObjection{"", still.empty() ? stabilised(estimate, options) : still, true},
        TimingObjection{"time_offset", at_search_limit(estimate, options), true},
        TimingObjection{"time_offset",
                        loose("time_offset", estimate.time_offset_s.stddev, UsefulStddev::kOffsetS, 1e3, 0, "ms",
                              "rotate the camera faster, and for longer"),
                        true},
        TimingObjection{"time_offset", contradicted_offset(estimate, coarse), true},
        TimingObjection{"readout_time", impossible_readout(estimate, period), true},
        TimingObjection{"readout_time",
                        loose("readout_time", estimate.readout_s.stddev, UsefulStddev::kReadoutS, 1e3, 0, "ms",
                              "rotate the camera faster, or give it in --config with --fixed-readout"),
                        false},
        TimingObjection{
            "gyro_bias",
            loose("gyro_bias", bias_stddev_rad_s, UsefulStddev::kBiasRadS, 1, 3, "rad/s",
                  "record for longer, or leave gyro_bias empty: the nodelet learns it while the camera rests"),
            false},
        TimingObjection{"R_cam_imu",
                        loose("R_cam_imu", estimate.rotation_stddev_rad.maxCoeff(), UsefulStddev::kRotationRad,
                              kDegPerRad, 1, "degrees", "rotate the camera about all axes, or give R_cam_imu"),
                        true}}) {
    if (!objection.text.empty()) objections.push_back(objection);
  }
  return objections;
}

}  // namespace gyro_deblur
