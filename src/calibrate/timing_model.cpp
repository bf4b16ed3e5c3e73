// Predicts the points of a window from the gyroscope, with derivatives by timing.
#include "calibrate/timing_model.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gyro_deblur {
namespace {

/// Values of the Lagrange polynomials of some nodes at t.
Eigen::VectorXd lagrange(const Eigen::VectorXd& nodes, double t) {
  Eigen::VectorXd values = Eigen::VectorXd::Ones(nodes.size());
  for (Eigen::Index j = 0; j < nodes.size(); ++j) {
    for (Eigen::Index k = 0; k < nodes.size(); ++k) {
      if (k != j) values[j] *= (t - nodes[k]) / (nodes[j] - nodes[k]);
    }
  }
  return values;
}

/// How the position at t follows from those at the middles of all frames.
/// @param frames_s  times of the frames
/// @param nearest   index of the frame that t belongs to
Eigen::VectorXd position_shares(const Eigen::VectorXd& frames_s, Eigen::Index nearest, double t_s) {
  // With a parabola, the readout comes out wrong by 1 % in a drone's flight: where rows are apart in time, a velocity
  // that changes looks much like a rotation that does.
  constexpr Eigen::Index kNodes = 4;
  const Eigen::Index count = std::min(kNodes, frames_s.size());
  const Eigen::Index first = std::clamp<Eigen::Index>(nearest - 1, 0, frames_s.size() - count);
  Eigen::VectorXd shares = Eigen::VectorXd::Zero(frames_s.size());
  shares.segment(first, count) = lagrange(frames_s.segment(first, count), t_s);
  return shares;
}

/// Axes at `from_ns` to the mean of those during an exposure: a smeared corner is where it was on the mean (Gauss'
/// quadrature with two nodes).
Eigen::Matrix3d mean_rotation(const RotationTrack& gyro, TimeNs from_ns, TimeNs middle_ns, TimeNs exposure_ns) {
  const auto node_ns = static_cast<TimeNs>(static_cast<double>(exposure_ns) / std::sqrt(12.0));
  if (node_ns == 0) return gyro.rotation(from_ns, middle_ns);
  return 0.5 * (gyro.rotation(from_ns, middle_ns - node_ns) + gyro.rotation(from_ns, middle_ns + node_ns));
}

}  // namespace

RotationTrack TimingModel::track(const TimingState& state) const {
  GyroOptions gyro = options_.gyro;
  gyro.bias_rad_s = state.bias_rad_s;
  gyro.time_offset_ns = to_ns(state.time_offset_s);
  return {samples_, gyro, state.R_cam_imu};
}

RowExposure TimingModel::rows_of(const FrameTime& frame, double readout_s) const {
  ShutterTiming timing = options_.shutter;
  timing.exposure_ns = std::max<TimeNs>(frame.exposure_ns, 1);
  timing.readout_ns = to_ns(readout_s);
  return {frame.stamp_ns, camera_.calibration().height_px, timing};
}

TimeNs TimingModel::time_of(const FrameTime& frame, double row_px, double readout_s) const {
  return rows_of(frame, readout_s).middle(row_px);
}

TimeNs TimingModel::middle_of(const FrameTime& frame, double readout_s) const {
  return time_of(frame, 0.5 * (camera_.calibration().height_px - 1), readout_s);
}

std::vector<Eigen::Vector3d> TimingModel::rotated_rays(const WindowPoints& points, const RotationTrack& gyro,
                                                       const TimingState& state) const {
  std::vector<RowExposure> rows;
  for (const FrameTime& frame : points.window->frames) rows.push_back(rows_of(frame, state.readout_s));
  std::vector<Eigen::Vector3d> result;
  result.reserve(points.sightings.size());
  std::size_t rotated = points.anchors.size();
  Eigen::Vector3d ray;
  for (const Sighting& sighting : points.sightings) {
    const Anchor& anchor = points.anchors[sighting.anchor];
    const FrameTime &from = points.window->frames.front(), &to = points.window->frames[sighting.frame];
    const TimeNs from_ns = rows.front().middle(anchor.px.y()), to_ns = rows[sighting.frame].middle(sighting.px.y());
    const TimeNs longest_ns = std::max(from.exposure_ns, to.exposure_ns);
    if (!gyro.covers({std::min(from_ns, to_ns) - longest_ns / 2, std::max(from_ns, to_ns) + longest_ns / 2})) {
      result.emplace_back(Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
      continue;
    }
    if (rotated != sighting.anchor) {
      ray = mean_rotation(gyro, from_ns, from_ns, from.exposure_ns).inverse() * anchor.ray;
      rotated = sighting.anchor;
    }
    result.emplace_back(mean_rotation(gyro, from_ns, to_ns, to.exposure_ns) * ray);
  }
  return result;
}

std::vector<Passage> TimingModel::passages(const WindowPoints& points, const RotationTrack& gyro,
                                           const TimingState& state) const {
  const std::vector<FrameTime>& frames = points.window->frames;
  const TimeNs reference_ns = middle_of(frames.front(), state.readout_s);
  Eigen::VectorXd frames_s(static_cast<Eigen::Index>(frames.size()));
  frames_s << 0, frame_times_s(points, state);
  std::vector<Passage> result;
  result.reserve(points.sightings.size());
  std::vector<RowExposure> rows;
  for (const FrameTime& frame : frames) rows.push_back(rows_of(frame, state.readout_s));
  for (const Sighting& sighting : points.sightings) {
    const TimeNs from_ns = rows.front().middle(points.anchors[sighting.anchor].px.y());
    const TimeNs to_ns = rows[sighting.frame].middle(sighting.px.y());
    const auto k = static_cast<Eigen::Index>(sighting.frame);
    const Eigen::VectorXd shares = position_shares(frames_s, k, to_seconds(to_ns - reference_ns)) -
                                   position_shares(frames_s, 0, to_seconds(from_ns - reference_ns));
    const bool covered = gyro.covers({std::min(reference_ns, to_ns), std::max(reference_ns, to_ns)});
    result.push_back({covered ? gyro.rotation(reference_ns, to_ns) : Eigen::Matrix3d::Identity().eval(),
                      shares.tail(shares.size() - 1)});
  }
  return result;
}

Eigen::VectorXd TimingModel::frame_times_s(const WindowPoints& points, const TimingState& state) const {
  const std::vector<FrameTime>& frames = points.window->frames;
  Eigen::VectorXd times_s(static_cast<Eigen::Index>(frames.size()) - 1);
  for (std::size_t k = 1; k < frames.size(); ++k) {
    times_s[static_cast<Eigen::Index>(k) - 1] =
        to_seconds(middle_of(frames[k], state.readout_s) - middle_of(frames.front(), state.readout_s));
  }
  return times_s;
}

std::vector<double> TimingModel::steps_of_differentiation() const {
  constexpr double kTimeStepS = 2e-4, kBiasStepRadS = 1e-4, kRotationStepRad = 1e-4;
  std::vector<double> steps(1, kTimeStepS);
  if (options_.estimate_readout) steps.push_back(kTimeStepS);
  if (options_.estimate_bias) steps.insert(steps.end(), 3, kBiasStepRadS);
  if (estimates_rotation()) steps.insert(steps.end(), 3, kRotationStepRad);
  return steps;
}

TimingState TimingModel::moved(const TimingState& state, const Eigen::VectorXd& step) const {
  TimingState result = state;
  Eigen::Index next = 0;
  result.time_offset_s += step[next++];
  if (options_.estimate_readout) result.readout_s += step[next++];
  if (options_.estimate_bias) {
    result.bias_rad_s += step.segment<3>(next);
    next += 3;
  }
  if (estimates_rotation()) {
    result.R_cam_imu =
        (so3_exp(step.segment<3>(next)) * Eigen::Quaterniond(state.R_cam_imu)).normalized().toRotationMatrix();
  }
  return result;
}

TimingDerivatives::TimingDerivatives(const TimingModel& model, const TimingState& state)
    : model_(model), center_{state, model.track(state)}, steps_(model.steps_of_differentiation()) {
  for (std::size_t k = 0; k < steps_.size(); ++k) {
    const Eigen::VectorXd step = steps_[k] * Eigen::VectorXd::Unit(model.values(), static_cast<Eigen::Index>(k));
    const TimingState ahead = model.moved(state, step), behind = model.moved(state, -step);
    ahead_.push_back({ahead, model.track(ahead)});
    behind_.push_back({behind, model.track(behind)});
  }
}

std::vector<Eigen::Matrix3Xd> TimingDerivatives::of(const WindowPoints& points,
                                                    const std::vector<Eigen::Vector3d>& rotated_rays) const {
  const std::vector<FrameTime>& frames = points.window->frames;
  const double last_row = model_.camera().calibration().height_px - 1;
  const Eigen::Vector3d rows(0, 0.5 * last_row, last_row);
  const TimeNs reference_ns = model_.middle_of(frames.front(), center_.state.readout_s);
  const auto rotation_of = [&](const Side& side, const FrameTime& frame, double row) -> Eigen::Matrix3d {
    const TimeNs t_ns = model_.time_of(frame, row, side.state.readout_s);
    if (!side.gyro.covers({std::min(reference_ns, t_ns), std::max(reference_ns, t_ns)})) {
      return Eigen::Matrix3d::Constant(std::numeric_limits<double>::quiet_NaN());
    }
    return side.gyro.rotation(reference_ns, t_ns);
  };
  // Of each frame and row: the rotation vectors of the axes there, 3 x values.
  std::vector<std::array<Eigen::Matrix3Xd, 3>> rotations(frames.size());
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (Eigen::Index r = 0; r < 3; ++r) {
      Eigen::Matrix3Xd& by_value = rotations[f][static_cast<std::size_t>(r)];
      by_value.resize(3, model_.values());
      for (std::size_t k = 0; k < steps_.size(); ++k) {
        const Eigen::Matrix3d R =
            rotation_of(ahead_[k], frames[f], rows[r]) * rotation_of(behind_[k], frames[f], rows[r]).transpose();
        // The vector of the skew part: the rotation is small.
        by_value.col(static_cast<Eigen::Index>(k)) =
            Eigen::Vector3d(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1)) / (4 * steps_[k]);
      }
    }
  }
  const auto rotation_at = [&](std::size_t frame, double row) -> Eigen::Matrix3Xd {
    const Eigen::VectorXd shares = lagrange(rows, row);
    return shares[0] * rotations[frame][0] + shares[1] * rotations[frame][1] + shares[2] * rotations[frame][2];
  };
  std::vector<Eigen::Matrix3Xd> result;
  result.reserve(points.sightings.size());
  for (std::size_t i = 0; i < points.sightings.size(); ++i) {
    const Sighting& sighting = points.sightings[i];
    const Anchor& anchor = points.anchors[sighting.anchor];
    // The anchor's rotation in the axes of the sighting.
    const TimeNs from_ns = model_.time_of(frames.front(), anchor.px.y(), center_.state.readout_s);
    const TimeNs to_ns = model_.time_of(frames[sighting.frame], sighting.px.y(), center_.state.readout_s);
    Eigen::Matrix3Xd J(3, model_.values());
    if (!rotated_rays[i].allFinite()) {
      J.setConstant(std::numeric_limits<double>::quiet_NaN());
    } else {
      const Eigen::Matrix3Xd difference = rotation_at(sighting.frame, sighting.px.y()) -
                                          center_.gyro.rotation(from_ns, to_ns) * rotation_at(0, anchor.px.y());
      for (Eigen::Index k = 0; k < J.cols(); ++k) J.col(k) = difference.col(k).cross(rotated_rays[i]);
    }
    result.push_back(std::move(J));
  }
  return result;
}

}  // namespace gyro_deblur
