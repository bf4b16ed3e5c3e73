// Exposures of recorded images, estimated one by one.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "blur/exposure_estimate.hpp"
#include "features/residual_flow.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "tools/recording.hpp"

namespace gyro_deblur::test {

/// Estimates for all frames of a recording whose stamps are those of the start of the exposure, were it the one that is
/// assumed, and at most the frame period. The velocities are those of gyroscope and optical flow.
/// Preconditions: two frames and a gyroscope's sample.
/// Throws std::runtime_error when an image cannot be read.
inline std::vector<std::optional<ExposureEstimate>> recorded_exposures(const Recording& recording, TimeNs assumed_ns) {
  std::vector<GyroSample> samples;
  for (const RecordedImu& sample : recording.imu) samples.push_back({sample.t_ns, sample.rate_rad_s});
  // They may end within the last exposure: then the last rate lasts.
  constexpr TimeNs kPeriodNs = 5'000'000;
  const GyroSample last = samples.back();
  for (TimeNs since_ns = kPeriodNs; since_ns <= assumed_ns; since_ns += kPeriodNs) {
    samples.push_back({last.t_ns + since_ns, last.rate_rad_s});
  }
  GyroOptions gyro;
  gyro.time_offset_ns = recording.time_offset_ns;
  const RotationTrack rotation(samples, gyro, recording.R_cam_imu);
  const Camera camera(recording.camera);
  BlurFieldOptions options;
  options.max_extent_px = 400;
  const BlurFieldEstimator estimator(camera, options);
  const auto intervals = static_cast<TimeNs>(recording.frames.size()) - 1;
  const TimeNs period_ns = (recording.frames.back().stamp_ns - recording.frames.front().stamp_ns) / intervals;
  ResidualFlow flow;
  std::vector<std::optional<ExposureEstimate>> estimates;
  for (const RecordedFrame& frame : recording.frames) {
    const cv::Mat image = cv::imread(frame.path, cv::IMREAD_GRAYSCALE);
    if (image.empty()) throw std::runtime_error(frame.path + " cannot be read");
    ShutterTiming timing;
    timing.exposure_ns = assumed_ns;
    timing.readout_ns = recording.readout_ns;
    const RowExposure exposure(frame.stamp_ns, image.rows, timing);
    const ResidualField residuals = flow.follow(image, camera, rotation, exposure, estimator.grid());
    estimates.push_back(estimate_exposure(estimator.estimate(rotation, exposure, residuals), image, {}, 0, period_ns));
  }
  return estimates;
}

}  // namespace gyro_deblur::test
