// Counters since the start.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "engine/engine.hpp"
#include "features/residual_rotation.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/time.hpp"
#include "ros/input_buffers.hpp"
#include "ros/processing.hpp"
#include "sync/calibration_in_use.hpp"
#include "sync/gyro_source.hpp"
#include "sync/input_problems.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {

/// What was published.
struct OutputStatistics {
  std::size_t frames_out = 0;
  std::size_t dropped_poor = 0;  ///< frames that drop_poor kept from being published
  std::map<PassThroughReason, std::size_t> passed_through;
  std::map<BlockStatus, std::size_t> blocks;  ///< of the frames that were not passed through
  std::size_t blocks_from_images = 0;         ///< of those, whose motion is also from the images
  FallbackCounts fallback_counts;             ///< that did not take the engine's fast path, by reason
  std::size_t frames_by_images_alone = 0;     ///< deblurred without a gyroscope
  std::string keypoints_text;                 ///< why the newest frame could have no keypoints; else empty

  void count(const FrameOutput& output);
};

/// Counts of a processor; those of the IMU are since the start of its source.
struct ProcessorStatistics : ImuStatistics, InputStatistics, OutputStatistics {
  std::size_t waiting = 0;                               ///< frames that are not published yet
  std::optional<TimeNs> frame_period_ns;                 ///< by the stamps
  TimeRange gyro_available;                              ///< IMU clock
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();  ///< in use
  std::map<std::string, InputProblem> input_problems;    ///< by kind
  std::vector<CalibrationRow> calibration;               ///< empty while the configuration cannot be used
  std::optional<GyroError> gyro_error;                   ///< that the images have shown since it is; axes of the IMU
  std::string engine;                                    ///< empty while the configuration cannot be used
  std::string configuration_error;                       ///< empty when it can
};

}  // namespace gyro_deblur
