// Moves points from one instant to another.
#include "features/point_motion.hpp"

#include <algorithm>

namespace gyro_deblur {

PointMotion::PointMotion(const FrameBlur& field, const Camera& camera, const CameraMotion& motion)
    : camera_(camera), motion_(motion), grid_(field.grid), images_alone_(field.images_alone) {
  blocks_.reserve(field.blocks.size());
  for (const BlockBlur& block : field.blocks) {
    const ResidualVelocity residual = block.residual.value_or(ResidualVelocity{});
    blocks_.push_back({block.apparent_offset_px(), residual.velocity_px_s, block.residual ? 1.0 : 0.0});
  }
}

PointMotion::Mean PointMotion::mean_at(const Eigen::Vector2d& pixel_px) const {
  Mean mean{Eigen::Vector2d::Zero(), Eigen::Vector2d::Zero(), 0};
  for (const BlockGrid::Neighbour& neighbour : grid_.around(pixel_px)) {
    const Mean& block = blocks_[static_cast<std::size_t>(neighbour.index)];
    mean.apparent_offset_px += neighbour.share * block.apparent_offset_px;
    mean.velocity_px_s += neighbour.share * block.velocity_px_s;
    mean.share_with_residual += neighbour.share * block.share_with_residual;
  }
  // Without a gyroscope a block of unknown velocity is not at rest: it moves as its neighbours do.
  if (images_alone_ && mean.share_with_residual > 0) mean.velocity_px_s /= mean.share_with_residual;
  return mean;
}

PointMotion::Movement PointMotion::movement(TimeNs from_ns, TimeNs to_ns) const {
  const Eigen::Matrix3d rotation = images_alone_ ? Eigen::Matrix3d::Identity() : motion_.rotation(from_ns, to_ns);
  return {rotation, to_seconds(to_ns - from_ns)};
}

PointMotion::Place PointMotion::moved(const Eigen::Vector2d& shown_px, const Movement& movement) const {
  const Mean mean = mean_at(shown_px);
  return moved_by(mean, shown_px - mean.apparent_offset_px, movement);
}

PointMotion::Place PointMotion::moved_from(const Eigen::Vector2d& place_px, const Movement& movement) const {
  return moved_by(mean_at(place_px), place_px, movement);
}

PointMotion::Place PointMotion::moved_by(const Mean& mean, const Eigen::Vector2d& place_px,
                                         const Movement& movement) const {
  const Eigen::Vector3d direction = movement.rotation * camera_.ray(place_px);
  const Eigen::Vector2d rotated_px = camera_.project(direction);
  if (mean.share_with_residual == 0) return {rotated_px, direction};
  return {rotated_px + movement.seconds * mean.velocity_px_s, std::nullopt};
}

std::vector<RectifiedPoint> rectify_points(const std::vector<Eigen::Vector2d>& points_px, const FrameBlur& field,
                                           const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, TimeNs reference_ns) {
  const PointMotion point_motion(field, camera, motion);
  std::vector<RectifiedPoint> result;
  result.reserve(points_px.size());
  for (const Eigen::Vector2d& raw_px : points_px) {
    const BlockStatus status = field.blocks.at(field.grid.index_at(raw_px.x(), raw_px.y())).status;
    RectifiedPoint point;
    point.deblurred = status == BlockStatus::DEBLURRED;
    point.rectified_px = raw_px;
    Eigen::Vector3d direction = camera.ray(raw_px);
    const TimeNs seen_ns = exposure.middle(raw_px.y());
    if (status != BlockStatus::REJECTED && has_known_blur(status) &&
        motion.covers({std::min(seen_ns, reference_ns), std::max(seen_ns, reference_ns)})) {
      const PointMotion::Place moved = point_motion.moved(raw_px, point_motion.movement(seen_ns, reference_ns));
      const Eigen::Vector3d seen_there = moved.direction ? *moved.direction : camera.ray(moved.pixel_px);
      if (moved.pixel_px.allFinite() && seen_there.allFinite()) {
        point.rectified_px = moved.pixel_px;
        point.rectified = true;
        direction = seen_there;
      }
    }
    point.normalized = camera.normalized(direction);
    result.push_back(point);
  }
  return result;
}

}  // namespace gyro_deblur
