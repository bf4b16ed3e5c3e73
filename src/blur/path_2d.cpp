// Extent of a curved path.
#include "blur/path_2d.hpp"

#include <Eigen/Geometry>

namespace gyro_deblur {

Eigen::Vector2f extent_of(const Path2d& path_px) {
  Eigen::AlignedBox2f covered_px(Eigen::Vector2f::Zero().eval());
  for (const Eigen::Vector2f& place_px : path_px) covered_px.extend(place_px);
  return covered_px.sizes();
}

}  // namespace gyro_deblur
