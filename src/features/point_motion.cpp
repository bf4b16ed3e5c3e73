// Moves a point from one instant to another.
#include "features/point_motion.hpp"

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

}  // namespace gyro_deblur
