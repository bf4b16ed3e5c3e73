// Moves tracks to the reference time.
#include "features/track_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "features/point_covariance.hpp"
#include "features/point_motion.hpp"

namespace gyro_deblur {

std::vector<Track> TrackRectifier::rectify(const std::vector<Track>& tracks, const FrameBlur& field,
                                           const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, TimeNs reference_ns) {
  const PointMotion point_motion(field, camera, motion);
  const TimeNs since_newest_ns = reference_ns - newest_ns_;
  if (since_newest_ns > kLongestTrackBreakNs) normalized_.clear();
  std::map<std::int32_t, Eigen::Vector2d> normalized;
  std::vector<Track> rectified;
  rectified.reserve(tracks.size());
  for (const Track& track : tracks) {
    const BlockBlur& block =
        field.blocks[static_cast<std::size_t>(field.grid.index_at(track.pixel_px.x(), track.pixel_px.y()))];
    const TimeNs seen_ns = exposure.middle(track.pixel_px.y());
    const bool is_known = field.images_alone
                              ? block.residual.has_value()
                              : motion.covers({std::min(seen_ns, reference_ns), std::max(seen_ns, reference_ns)});
    if (!is_known) continue;
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
    if (!place.pixel_px.allFinite() || !direction.allFinite() || !jacobian.allFinite()) continue;
    Track& moved = rectified.emplace_back(track);
    moved.pixel_px = place.pixel_px;
    moved.normalized = camera.normalized(direction);
    moved.covariance_px2 = jacobian * track.covariance_px2 * jacobian.transpose() +
                           covariance_of_moving(block, std::abs(movement.seconds));
    const auto before = normalized_.find(track.id);
    if (before != normalized_.end() && since_newest_ns > 0) {
      moved.velocity_1_s = (moved.normalized - before->second) / to_seconds(since_newest_ns);
    }
    normalized[track.id] = moved.normalized;
  }
  newest_ns_ = reference_ns;
  normalized_ = std::move(normalized);
  return rectified;
}

}  // namespace gyro_deblur
