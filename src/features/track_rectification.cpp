// Moves tracks to the reference time.
#include "features/track_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

#include "features/point_covariance.hpp"
#include "features/point_motion.hpp"

namespace gyro_deblur {
namespace {

/// Nothing where the motion between the track's time and the reference time is not known.
std::optional<Track> at_reference(const Track& track, const FrameBlur& field, const Camera& camera,
                                  const CameraMotion& motion, const PointMotion& point_motion, TimeNs seen_ns,
                                  TimeNs reference_ns) {
  const BlockBlur& block =
      field.blocks[static_cast<std::size_t>(field.grid.index_at(track.pixel_px.x(), track.pixel_px.y()))];
  const bool is_known = field.images_alone
                            ? block.residual.has_value()
                            : motion.covers({std::min(seen_ns, reference_ns), std::max(seen_ns, reference_ns)});
  if (!is_known) return std::nullopt;
  const PointMotion::Movement movement = point_motion.movement(seen_ns, reference_ns);
  const auto at = [&](const Eigen::Vector2d& place_px) { return point_motion.moved_from(place_px, movement); };
  const PointMotion::Place place = at(track.pixel_px);
  const Eigen::Vector3d direction = place.direction ? *place.direction : camera.ray(place.pixel_px);
  constexpr double kHalfStepPx = 1;
  Eigen::Matrix2d jacobian;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d step_px = kHalfStepPx * Eigen::Vector2d::Unit(axis);
    jacobian.col(axis) =
        (at(track.pixel_px + step_px).pixel_px - at(track.pixel_px - step_px).pixel_px) / (2 * kHalfStepPx);
  }
  if (!place.pixel_px.allFinite() || !direction.allFinite() || !jacobian.allFinite()) return std::nullopt;
  Track moved = track;
  moved.pixel_px = place.pixel_px;
  moved.normalized = camera.normalized(direction);
  moved.covariance_px2 =
      jacobian * track.covariance_px2 * jacobian.transpose() + covariance_of_moving(block, std::abs(movement.seconds));
  return moved;
}

}  // namespace

TrackRectifier::State TrackRectifier::state_before(std::int32_t tracker_id) const {
  const auto found = states_.find(tracker_id);
  return found == states_.end() ? State{tracker_id, std::nullopt} : found->second;
}

TrackRectifier::State TrackRectifier::left_out(const State& before) {
  if (!before.normalized) return before;  // nobody has seen this id
  const State state{next_id_, std::nullopt};
  next_id_ = next_id_ + 1 < kTrackIds ? next_id_ + 1 : kTrackerIds;
  return state;
}

std::vector<Track> TrackRectifier::rectify(const std::vector<Track>& tracks, const FrameBlur& field,
                                           const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, TimeNs reference_ns) {
  const PointMotion point_motion(field, camera, motion);
  const TimeNs since_newest_ns = reference_ns - newest_ns_;
  const bool gives_velocities = since_newest_ns > 0 && since_newest_ns <= kLongestTrackBreakNs;
  std::map<std::int32_t, State> states;
  std::vector<Track> rectified;
  rectified.reserve(tracks.size());
  for (const Track& track : tracks) {
    const State before = state_before(track.id);
    std::optional<Track> moved =
        at_reference(track, field, camera, motion, point_motion, exposure.middle(track.pixel_px.y()), reference_ns);
    if (!moved) {
      states.emplace(track.id, left_out(before));
      continue;
    }
    if (before.normalized && gives_velocities) {
      moved->velocity_1_s = (moved->normalized - *before.normalized) / to_seconds(since_newest_ns);
    }
    moved->id = before.id;
    states.emplace(track.id, State{before.id, moved->normalized});
    rectified.push_back(*moved);
  }
  newest_ns_ = reference_ns;
  states_ = std::move(states);
  return rectified;
}

}  // namespace gyro_deblur
