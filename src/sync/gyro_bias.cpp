// Averages the samples of an IMU at rest.
#include "sync/gyro_bias.hpp"

#include <vector>

#include "base/format.hpp"

namespace gyro_deblur {

std::optional<Eigen::Vector3d> estimate_bias(const GyroReader& gyro, const Config& config, std::string* text) {
  // The samples have to span this part of the window.
  constexpr double kMinCoverage = 0.8;
  const TimeRange available = gyro.available();
  std::vector<GyroSample> samples;
  if (!available.empty()) samples = gyro.window({available.end_ns - config.bias_window_ns, available.end_ns});
  const double span_s = samples.empty() ? 0 : to_seconds(samples.back().t_ns - samples.front().t_ns);
  if (span_s < kMinCoverage * to_seconds(config.bias_window_ns)) {
    *text = "gyroscope samples span " + std::to_string(span_s) + " s, " +
            std::to_string(kMinCoverage * to_seconds(config.bias_window_ns)) + " s are needed: call again later";
    return std::nullopt;
  }
  const std::optional<BiasEstimate> estimate =
      estimate_stationary_bias(samples, config.bias_max_stddev_rad_s, kMinBiasSamples, text);
  if (!estimate) return std::nullopt;
  GyroOptions corrected = config.gyro;
  corrected.bias_rad_s = estimate->bias_rad_s;
  try {
    corrected.validate();  // a constant rotation looks like rest, but no bias is that large
  } catch (const OptionError& error) {
    *text = error.what();
    return std::nullopt;
  }
  *text = "gyro_bias = " + vector_text(estimate->bias_rad_s) + " rad/s in use, from " +
          std::to_string(estimate->samples) + " samples with a standard deviation of " +
          vector_text(estimate->stddev_rad_s) + " rad/s";
  return estimate->bias_rad_s;
}

}  // namespace gyro_deblur
