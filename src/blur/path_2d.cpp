// Extent of a curved path, and paths that a rolling shutter records.
#include "blur/path_2d.hpp"

#include <algorithm>

#include <Eigen/Geometry>

namespace gyro_deblur {

Eigen::Vector2f extent_of(const Path2d& path_px) {
  Eigen::AlignedBox2f covered_px(Eigen::Vector2f::Zero().eval());
  for (const Eigen::Vector2f& place_px : path_px) covered_px.extend(place_px);
  return covered_px.sizes();
}

Eigen::Vector2f extent_along(const Path2d& path_px, float angle_rad) {
  const Eigen::Rotation2Df to_line(-angle_rad);
  Eigen::AlignedBox2f covered_px;
  for (const Eigen::Vector2f& place_px : path_px) covered_px.extend(to_line * place_px);
  return covered_px.sizes();
}

std::array<Eigen::Vector2d, kPathInstants> rolling_shutter_path(
    const std::array<Eigen::Vector2d, kPathInstants>& path_px, const RowExposure& exposure) {
  const double instants_per_row =
      exposure.row_time_ns() * (kPathInstants - 1) / static_cast<double>(exposure.timing().exposure_ns);
  if (instants_per_row == 0) return path_px;
  // Times count in instants, beyond the first and last one too. Between instants the path is a parabola.
  std::array<Eigen::Vector2d, kPathInstants> recorded_px;
  for (int k = 0; k < kPathInstants; ++k) {
    double time = k;
    recorded_px[k] = path_px[k];
    // The place decides the row, the row the time and the time the place: Newton's method. A point that keeps up with
    // the readout would be exposed for ever.
    constexpr int kSteps = 2;
    constexpr double kLeastSlope = 0.2, kMiddle = 0.5 * (kPathInstants - 1), kFarthest = kMiddle / kLeastSlope;
    for (int i = 0; i < kSteps; ++i) {
      const int middle = std::clamp(static_cast<int>(time + 0.5), 1, kPathInstants - 2);
      const double since = time - middle;
      const Eigen::Vector2d speed = 0.5 * (path_px[middle + 1] - path_px[middle - 1]),
                            change = path_px[middle + 1] - 2 * path_px[middle] + path_px[middle - 1];
      const double slope = 1 - instants_per_row * (speed.y() + since * change.y());
      const double step = (k + instants_per_row * recorded_px[k].y() - time) / std::max(slope, kLeastSlope);
      time = std::clamp(time + step, kMiddle - kFarthest, kMiddle + kFarthest);
      const double at = time - middle;
      recorded_px[k] = path_px[middle] + at * speed + 0.5 * at * at * change;
    }
  }
  return recorded_px;
}

}  // namespace gyro_deblur
