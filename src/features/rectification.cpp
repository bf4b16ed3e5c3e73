#include "gyro_deblur/rectification.hpp"

#include <algorithm>

namespace gyro_deblur {

std::vector<RectifiedPoint> rectify_points(const std::vector<Eigen::Vector2d>& points_px, const FrameBlur& field,
                                           const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, TimeNs reference_ns) {
  std::vector<RectifiedPoint> result;
  result.reserve(points_px.size());
  for (const Eigen::Vector2d& raw_px : points_px) {
    const BlockBlur& block = field.blocks.at(field.grid.index_at(raw_px.x(), raw_px.y()));
    const BlockStatus status = block.status;
    RectifiedPoint point;
    point.deblurred = status == BlockStatus::DEBLURRED;
    point.rectified_px = raw_px;
    Eigen::Vector3d direction = camera.ray(raw_px);
    const TimeNs seen_ns = exposure.middle(raw_px.y());
    if (status != BlockStatus::REJECTED && status != BlockStatus::NO_GYRO &&
        motion.covers({std::min(seen_ns, reference_ns), std::max(seen_ns, reference_ns)})) {
      const Eigen::Vector3d seen = camera.ray(raw_px - block.shown_offset_px());
      const Eigen::Vector3d moved =
          (block.residual ? motion.rotation(seen_ns, reference_ns) : motion.homography(seen_ns, reference_ns)) * seen;
      Eigen::Vector2d moved_px = camera.project(moved);
      if (block.residual) moved_px += to_seconds(reference_ns - seen_ns) * block.residual->velocity_px_s;
      const Eigen::Vector3d seen_there = block.residual ? camera.ray(moved_px) : moved;
      if (moved_px.allFinite() && seen_there.allFinite()) {
        point.rectified_px = moved_px;
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
