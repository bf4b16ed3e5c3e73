// Moves keypoints to the reference time.
#include "features/rectification.hpp"

#include <algorithm>

#include "features/point_motion.hpp"

namespace gyro_deblur {

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
    if (status != BlockStatus::REJECTED && status != BlockStatus::NO_GYRO && status != BlockStatus::MASKED &&
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
