// From counters and times to the statuses that the nodelet publishes on /diagnostics.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <diagnostic_updater/DiagnosticStatusWrapper.h>
#include <Eigen/Core>

#include "blur/exposure_advice.hpp"
#include "gyro_deblur/time.hpp"
#include "ros/processing.hpp"
#include "ros/statistics.hpp"

namespace gyro_deblur {

/// What is published: each status has at most 15 values while nothing is wrong. Losses come first, counters that are
/// zero are left out.
struct DiagnosticStatuses {
  diagnostic_updater::DiagnosticStatusWrapper image;        ///< frames, blocks, quality
  diagnostic_updater::DiagnosticStatusWrapper imu;          ///< samples of the gyroscope
  diagnostic_updater::DiagnosticStatusWrapper calibration;  ///< values in use, exposure
  diagnostic_updater::DiagnosticStatusWrapper timing;       ///< clocks, and times of every stage
};

/// Reports what happened since the report before. Thread-safe.
class DiagnosticReport {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// From here on; the IMU may have been counted for others before.
  void start(const ProcessorStatistics& statistics, Time time);

  /// A frame is published.
  void add(const FrameOutput& output);

  struct Moment {
    ProcessorStatistics statistics;
    std::size_t cameras = 0;  ///< on this gyroscope
    TimeNs node_ns = 0;       ///< node clock
    Time time;                ///< after that of the report before
  };
  /// The statuses of the period that ends now. Begins the next one.
  DiagnosticStatuses fill(const Moment& now);

 private:
  /// Mean and maximum over a period.
  struct Latency {
    double sum_ms = 0, max_ms = 0;
    std::size_t count = 0;
    void add(double ms);
  };
  /// What the frames of a period show.
  struct Period {
    std::map<std::string, Latency> latencies;
    std::vector<double> flow_px;  ///< within the exposure, of the blocks for which optical flow is used
    Eigen::Vector3d rotation_sum_rad_s = Eigen::Vector3d::Zero();  ///< in addition to the gyroscope's
    std::size_t rotations = 0;
    std::map<std::uint8_t, std::size_t> grades;  ///< frames, by ImageQuality's constants
    double score_sum = 0;
    std::size_t scores = 0;
    std::vector<ExposureTerms> exposures;
  };
  // What they report of the last period needs mutex_.
  double rate(const Moment& now, std::size_t newer, std::size_t older) const;
  void add_losses(const Moment& now, diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_frames(const Moment& now, diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_blocks(const Moment& now, diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_quality(diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_exposure(diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_exposure_advice(const Moment& now, diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_optical_flow(const Moment& now, diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_imu(const Moment& now, diagnostic_updater::DiagnosticStatusWrapper* status) const;
  void add_latencies(diagnostic_updater::DiagnosticStatusWrapper* status) const;

  std::mutex mutex_;  // everything below
  Period period_;
  std::optional<FrameExposure> exposure_;  // of the newest frame that the pipeline has seen
  ProcessorStatistics last_;
  Time last_time_ = std::chrono::steady_clock::now();
};

}  // namespace gyro_deblur
