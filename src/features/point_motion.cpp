#include "features/point_motion.hpp"

#include <algorithm>

namespace gyro_deblur {
namespace {

/// Two neighbouring columns (rows) of blocks, and where between their centres a coordinate is.
struct Between {
  int before, after;
  double weight_of_after;
};

/// @param center_px  of a column (row); the last one may be smaller than the others
template <typename Center>
Between between(double at_px, int size_px, int count, const Center& center_px) {
  const int before = std::clamp(static_cast<int>((at_px + 0.5) / size_px - 0.5), 0, std::max(0, count - 2));
  const int after = std::min(before + 1, count - 1);
  if (after == before) return {before, after, 0};
  const double from_px = center_px(before), to_px = center_px(after);
  return {before, after, std::clamp((at_px - from_px) / (to_px - from_px), 0.0, 1.0)};
}

}  // namespace

PointMotion::PointMotion(const FrameBlur& field, const Camera& camera, const CameraMotion& motion)
    : camera_(camera), motion_(motion), grid_(field.grid) {
  blocks_.reserve(field.blocks.size());
  for (const BlockBlur& block : field.blocks) {
    const ResidualVelocity residual = block.residual.value_or(ResidualVelocity{});
    blocks_.push_back({block.shown_offset_px(), residual.velocity_px_s, block.residual ? 1.0 : 0.0});
  }
}

PointMotion::Mean PointMotion::mean_at(const Eigen::Vector2d& pixel_px) const {
  const int size_px = grid_.block_size_px(), cols = grid_.cols();
  const Between x = between(std::clamp(pixel_px.x(), 0.0, grid_.width_px() - 1.0), size_px, cols,
                            [this](int col) { return grid_.center(col).x(); });
  const Between y = between(std::clamp(pixel_px.y(), 0.0, grid_.height_px() - 1.0), size_px, grid_.rows(),
                            [this, cols](int row) { return grid_.center(row * cols).y(); });
  Mean mean{Eigen::Vector2d::Zero(), Eigen::Vector2d::Zero(), 0};
  const auto add = [&](int row, int col, double weight) {
    const Mean& block = blocks_[static_cast<std::size_t>(row * cols + col)];
    mean.shown_offset_px += weight * block.shown_offset_px;
    mean.velocity_px_s += weight * block.velocity_px_s;
    mean.share_with_residual += weight * block.share_with_residual;
  };
  add(y.before, x.before, (1 - y.weight_of_after) * (1 - x.weight_of_after));
  add(y.before, x.after, (1 - y.weight_of_after) * x.weight_of_after);
  add(y.after, x.before, y.weight_of_after * (1 - x.weight_of_after));
  add(y.after, x.after, y.weight_of_after * x.weight_of_after);
  return mean;
}

PointMotion::Turn PointMotion::turn(TimeNs from_ns, TimeNs to_ns) const {
  return {motion_.rotation(from_ns, to_ns), motion_.homography(from_ns, to_ns), to_seconds(to_ns - from_ns)};
}

PointMotion::Place PointMotion::moved(const Eigen::Vector2d& shown_px, const Turn& turn) const {
  const Mean mean = mean_at(shown_px);
  const Eigen::Vector3d seen = camera_.ray(shown_px - mean.shown_offset_px);
  const Eigen::Vector3d direction = turn.homography * seen;
  Place place{camera_.project(direction), std::nullopt};
  if (mean.share_with_residual == 0) {
    place.direction = direction;
    return place;
  }
  if (turn.rotation != turn.homography) {
    place.pixel_px += mean.share_with_residual * (camera_.project(turn.rotation * seen) - place.pixel_px);
  }
  place.pixel_px += turn.seconds * mean.velocity_px_s;
  return place;
}

}  // namespace gyro_deblur
