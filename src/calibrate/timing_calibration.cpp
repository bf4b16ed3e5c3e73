// The steps of the timing calibration: track, start, solve, check.
#include "calibrate/timing_calibration.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "base/median.hpp"
#include "base/require_range.hpp"
#include "calibrate/timing_model.hpp"
#include "calibrate/timing_solver.hpp"
#include "calibrate/timing_start.hpp"

namespace gyro_deblur {
namespace {

/// Offset and readout move by no more than this after the search.
constexpr TimeNs kMarginNs = 30'000'000;

/// The points with rays; windows that have too few are left out.
std::vector<WindowPoints> select_points(const Camera& camera, const std::vector<TrackWindow>& windows) {
  constexpr std::size_t kMinPointsOfPair = 8;
  std::vector<WindowPoints> selected;
  for (const TrackWindow& window : windows) {
    WindowPoints points;
    points.window = &window;
    for (const PointTrack& track : window.tracks) {
      const Eigen::Vector3d ray = camera.ray(track.from_px);
      if (!ray.allFinite()) continue;
      std::size_t found = 0;
      for (; found < track.to_px.size() && camera.ray(track.to_px[found]).allFinite(); ++found) {
        points.sightings.push_back({points.anchors.size(), found + 1, track.to_px[found]});
      }
      if (found > 0) points.anchors.push_back({track.from_px, ray});
    }
    if (points.anchors.size() >= kMinPointsOfPair) selected.push_back(std::move(points));
  }
  if (selected.size() < kMinPairs) {
    throw TimingError(std::to_string(selected.size()) + " of " + std::to_string(windows.size()) +
                      " pairs of frames have " + std::to_string(kMinPointsOfPair) + " tracked points or more; " +
                      std::to_string(kMinPairs) + " are needed: record for longer, of a scene with corners");
  }
  return selected;
}

/// Leaves out the windows that the gyroscope may not cover once offset and readout have moved.
void keep_covered(const TimingModel& model, const TimingOptions& options, const TimingState& state,
                  std::vector<WindowPoints>* windows) {
  const RotationTrack gyro = model.track(state);
  const double last_row = model.camera().calibration().height_px - 1;
  const auto is_open = [&](const WindowPoints& points) {
    TimeRange range{std::numeric_limits<TimeNs>::max(), std::numeric_limits<TimeNs>::min()};
    for (const FrameTime& frame : points.window->frames) {
      for (const double row : {0.0, last_row}) {
        const TimeNs t_ns = model.time_of(frame, row, state.readout_s);
        const TimeNs reach_ns = kMarginNs + frame.exposure_ns / 2;
        range.begin_ns = std::min(range.begin_ns, t_ns - reach_ns);
        range.end_ns = std::max(range.end_ns, t_ns + reach_ns);
      }
    }
    // A readout that is not known yet can make the last row later or earlier by up to the time between frames.
    if (options.estimate_readout && state.readout_s == 0) {
      const TimeNs period_ns = points.window->frames[1].stamp_ns - points.window->frames[0].stamp_ns;
      range.begin_ns -= period_ns;
      range.end_ns += period_ns;
    }
    return !gyro.covers(range);
  };
  windows->erase(std::remove_if(windows->begin(), windows->end(), is_open), windows->end());
  if (windows->size() < kMinPairs) {
    throw TimingError("gyroscope samples cover " + std::to_string(windows->size()) + " pairs of frames; " +
                      std::to_string(kMinPairs) + " are needed: record images and IMU together, for longer");
  }
}

double median_length(const std::vector<TimingResidual>& residuals, Eigen::Vector2d TimingResidual::*member) {
  std::vector<double> lengths;
  for (const TimingResidual& residual : residuals) {
    const double length = (residual.*member).norm();
    lengths.push_back(std::isfinite(length) ? length : std::numeric_limits<double>::infinity());
  }
  return median(lengths);
}

void report_values(const TimingModel& model, const TimingOptions& options, const TimingState& state,
                   const Eigen::VectorXd& variances, TimingEstimate* estimate) {
  const auto stddev = [&variances](Eigen::Index k) { return std::sqrt(std::max(variances[k], 0.0)); };
  Eigen::Index next = 0;
  estimate->time_offset_s = {state.time_offset_s, stddev(next++)};
  estimate->readout_s = {state.readout_s, 0};
  if (options.estimate_readout) estimate->readout_s.stddev = stddev(next++);
  for (int axis = 0; axis < 3; ++axis) {
    estimate->bias_rad_s[axis] = {state.bias_rad_s[axis], options.estimate_bias ? stddev(next++) : 0};
  }
  estimate->R_cam_imu = state.R_cam_imu;
  if (model.estimates_rotation()) {
    for (int axis = 0; axis < 3; ++axis) estimate->rotation_stddev_rad[axis] = stddev(next++);
  }
}

void report_rates(const TimingStart& start, const TimingModel& model, const TimingState& state,
                  const std::vector<WindowPoints>& windows, TimingEstimate* estimate) {
  const std::vector<Eigen::Vector3d> by_gyro = start.gyro_rotations(state);
  for (std::size_t i = 0; i < windows.size(); ++i) {
    const TimeNs from_ns = model.middle_of(windows[i].window->frames.front(), state.readout_s);
    const double dt_s = model.frame_times_s(windows[i], state)[0];
    estimate->rates.push_back({from_ns + to_ns(0.5 * dt_s), start.image_rotations()[i] / dt_s, by_gyro[i] / dt_s});
  }
}

}  // namespace

TimingEstimate estimate_timing(const Camera& camera, const std::vector<TrackWindow>& windows,
                               const std::vector<GyroSample>& samples, const TimingOptions& options) {
  constexpr double kLongestSearchS = 5;
  require_range("search", to_seconds(options.search_ns), 0, kLongestSearchS, "s");
  options.gyro.validate();
  if (samples.size() < 2) throw TimingError("there are " + std::to_string(samples.size()) + " gyroscope samples");
  const TimingModel model(camera, samples, options);
  std::vector<WindowPoints> points = select_points(camera, windows);
  TimingState state{
      to_seconds(options.gyro.time_offset_ns), to_seconds(options.shutter.readout_ns), options.gyro.bias_rad_s,
      options.R_cam_imu ? require_rotation("R_cam_imu", *options.R_cam_imu) : Eigen::Matrix3d::Identity()};
  TimingEstimate estimate;
  {
    const TimingStart start(model, points);
    estimate.correlation = start.search_offset(options.search_ns, &state);
    if (!options.R_cam_imu) start.find_rotation(&state);
  }
  keep_covered(model, options, state, &points);
  TimingSolver solver(model, points, state);
  std::vector<std::vector<Eigen::Vector2d>> at_start;
  for (std::size_t i = 0; i < points.size(); ++i) at_start.push_back(solver.residuals(i));
  state = solver.solve();
  report_values(model, options, state, solver.variances(), &estimate);

  estimate.speed_per_s = solver.priors().speed_per_s;
  estimate.pairs = points.size();
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::vector<Eigen::Vector2d> at_end = solver.residuals(i);
    for (std::size_t k = 0; k < at_end.size(); ++k) {
      const Sighting& sighting = points[i].sightings[k];
      estimate.residuals.push_back(
          {sighting.px.y(), sighting.px - points[i].anchors[sighting.anchor].px, at_start[i][k], at_end[k]});
    }
  }
  estimate.points = estimate.residuals.size();
  estimate.median_without_px = median_length(estimate.residuals, &TimingResidual::without_px);
  estimate.median_at_start_px = median_length(estimate.residuals, &TimingResidual::at_start_px);
  estimate.median_px = median_length(estimate.residuals, &TimingResidual::estimated_px);
  report_rates(TimingStart(model, points), model, state, points, &estimate);
  return estimate;
}

}  // namespace gyro_deblur
