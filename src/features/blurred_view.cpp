// Paths of an image's points during its exposure.
#include "features/blurred_view.hpp"

#include <algorithm>

#include <Eigen/LU>
#include <opencv2/imgproc.hpp>

#include "blur/image_noise.hpp"
#include "blur/path_2d.hpp"
#include "features/corner_prediction.hpp"

namespace gyro_deblur {
namespace {

/// At least that of rounding, which images have whose noise cannot be estimated, such as saturated ones.
double noise_of(const cv::Mat& luminance, const FrameBlur* field) {
  if (field != nullptr && field->noise) return std::max(kRoundingNoise, *field->noise);
  return std::max(kRoundingNoise, image_noise(luminance, PixelLayout::GRAY).value_or(kRoundingNoise));
}

/// Means over 3 x 3 blocks: the scatter of single ones is larger than what the scene changes from block to block.
std::vector<BlurredView::Residual> smoothed_residuals(const FrameBlur& field) {
  std::vector<BlurredView::Residual> residuals;
  for (int i = 0; i < field.grid.size(); ++i) {
    Eigen::Vector2d sum_px_s = Eigen::Vector2d::Zero();
    int count = 0;
    field.grid.for_each_around(i, [&](int around) {
      const BlockBlur& block = field.blocks[static_cast<std::size_t>(around)];
      if (!block.residual) return;
      sum_px_s += block.residual->velocity_px_s;
      ++count;
    });
    residuals.push_back({sum_px_s / std::max(1, count), count > 0});
  }
  return residuals;
}

constexpr double kHalfStepPx = 7;  // within what is compared

/// Jacobian of where the rotation takes a point, if other rows are exposed at other times. Not finite where the
/// rotation of neighbouring rows is not known.
/// @param map  Jacobian if all rows were exposed when the point's row is
Eigen::Matrix2d with_row_times(const Eigen::Matrix2d& map, const Eigen::Vector3d& ray, const Camera& camera,
                               const CameraMotion& motion, const RowExposure& from, double from_row,
                               const RowExposure& to, double to_row) {
  const auto place_at = [&](double row, double row_then) -> Eigen::Vector2d {
    const auto direction = rotated_ray(ray, motion, from.middle(row), to.middle(row_then));
    return camera.project(direction.value_or(Eigen::Vector3d::Zero()));  // not known: NaN
  };
  constexpr double h = kHalfStepPx;
  const Eigen::Vector2d by_from_row = (place_at(from_row + h, to_row) - place_at(from_row - h, to_row)) / (2 * h),
                        by_to_row = (place_at(from_row, to_row + h) - place_at(from_row, to_row - h)) / (2 * h);
  // d place = map d pixel + by_from_row d pixel.y + by_to_row d place.y
  Eigen::Matrix2d left = Eigen::Matrix2d::Identity(), right = map;
  left.col(1) -= by_to_row;
  right.col(1) += by_from_row;
  return left.inverse() * right;
}

/// Second order of where a camera sees a direction, rotated by R_seen_ray, by what is added to its x and y.
/// @param step  > 0: of x and y
LocalMap::Quadratic quadratic_of_projection(const Camera& camera, const Eigen::Matrix3d& R_seen_ray,
                                            const Eigen::Vector3d& ray, const Eigen::Vector2d& pixel_px, double step) {
  const auto away_px = [&](double x, double y) -> Eigen::Vector2d {
    return camera.project(R_seen_ray * (ray + step * Eigen::Vector3d(x, y, 0))) - pixel_px;
  };
  LocalMap::Quadratic quadratic;
  quadratic.col(0) = away_px(1, 0) + away_px(-1, 0);
  quadratic.col(2) = away_px(0, 1) + away_px(0, -1);
  quadratic.col(1) = away_px(1, 1) + away_px(-1, -1) - quadratic.col(0) - quadratic.col(2);
  return quadratic / (2 * step * step);
}

/// By the rotation between the instants at which the two images show the point.
/// @param ray  of the place, z = 1
/// @param map  its Jacobian
LocalMap::Quadratic quadratic_by_rotation(const RotatedPixel& rotated, const Eigen::Vector2d& place_px,
                                          const Eigen::Vector3d& ray, const NearbyRays& rays,
                                          const Eigen::Matrix2d& map) {
  constexpr double kReachPx = 10;  // compared patches reach 10 to 25 px
  const double step = kReachPx / rays.px_per_ray().col(0).norm();
  const Camera& camera = rays.camera();
  const LocalMap::Quadratic now = quadratic_of_projection(camera, Eigen::Matrix3d::Identity(), ray, place_px, step),
                            then = quadratic_of_projection(camera, rotated.rotation, ray, rotated.pixel_px, step);
  const LocalMap::Quadratic quadratic = quadratic_after(then - map * now, rays.ray_per_px());
  return quadratic.allFinite() ? quadratic : LocalMap::Quadratic::Zero();
}

/// Where a point is by the rotation alone, and the Jacobian of that; where it was if the rotation is not known.
PredictedPoint rotate_point(const Eigen::Vector2d& place_px, const NearbyRays& rays, const RowExposure& from,
                            const RowExposure& to, const CameraMotion& motion) {
  const Eigen::Matrix2d identity = Eigen::Matrix2d::Identity();
  const Camera& camera = rays.camera();
  const Eigen::Vector3d ray = rays.ray(place_px);
  const auto rotated = rotated_pixel(place_px, ray, camera, motion, from, to);
  if (!rotated) return {place_px, identity, place_px, identity, true, rays};
  const Eigen::Vector3d direction = rotated->rotation * ray, ray_then = direction / direction.z();
  const NearbyRays near(camera, rotated->pixel_px, ray_then);
  const Eigen::Matrix<double, 3, 2> direction_per_px = rotated->rotation.leftCols<2>() * rays.ray_per_px();
  const Eigen::Matrix2d ray_then_per_px =
      (direction_per_px.topRows<2>() - ray_then.head<2>() * direction_per_px.row(2)) / direction.z();
  Eigen::Matrix2d map = near.px_per_ray() * ray_then_per_px;
  const LocalMap::Quadratic quadratic = quadratic_by_rotation(*rotated, place_px, ray, rays, map);
  if (from.row_time_ns() != 0 || to.row_time_ns() != 0) {
    const Eigen::Matrix2d by_rows =
        with_row_times(map, ray, camera, motion, from, place_px.y(), to, rotated->pixel_px.y());
    if (by_rows.allFinite()) map = by_rows;
  }
  // For a point that moves as fast as the readout, the map grows without bounds.
  constexpr double kLargest = 10;
  if (!(map.norm() < kLargest)) return {rotated->pixel_px, identity, rotated->pixel_px, identity, true, near};
  return {rotated->pixel_px, {map, quadratic}, rotated->pixel_px, map, true, near};
}

}  // namespace

BlurredView::BlurredView(const cv::Mat& luminance, const RowExposure& exposure, const FrameBlur* field)
    : luminance_(luminance.clone()), exposure_(exposure), noise_(noise_of(luminance, field)) {
  if (field == nullptr) return;
  grid_ = field->grid;
  residuals_ = smoothed_residuals(*field);
}

const cv::Mat& BlurredView::half_size() const {
  std::call_once(has_half_size_, [this] {
    const cv::Rect even(0, 0, luminance_.cols / 2 * 2, luminance_.rows / 2 * 2);
    cv::resize(luminance_(even), half_size_, {}, 0.5, 0.5, cv::INTER_AREA);
  });
  return half_size_;
}

BlurredView::Residual BlurredView::residual_at(const Eigen::Vector2d& pixel_px) const {
  Residual mean{Eigen::Vector2d::Zero(), false};
  if (residuals_.empty()) return mean;
  double known = 0;
  for (const BlockGrid::Neighbour& neighbour : grid_.around(pixel_px)) {
    const Residual& block = residuals_[static_cast<std::size_t>(neighbour.index)];
    mean.velocity_px_s += neighbour.share * block.velocity_px_s;
    known += block.is_known ? neighbour.share : 0;
  }
  mean.is_known = known > 0;
  if (mean.is_known) mean.velocity_px_s /= known;
  return mean;
}

BlurredPoint BlurredView::point_at(const Eigen::Vector2d& place_px, const Eigen::Vector3d& ray, const Camera& camera,
                                   const CameraMotion& motion) const {
  const TimeNs start_ns = exposure_.start(place_px.y()), middle_ns = exposure_.middle(place_px.y()),
               end_ns = exposure_.end(place_px.y());
  const Residual residual = residual_at(place_px);
  const bool knows_rotation = motion.covers({start_ns, end_ns});
  std::array<Eigen::Vector2d, kPathInstants> path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const TimeNs instant_ns = start_ns + (end_ns - start_ns) * k / (kPathInstants - 1);
    path_px[k] = to_seconds(instant_ns - middle_ns) * residual.velocity_px_s;
    if (knows_rotation) path_px[k] += camera.project(motion.rotation(middle_ns, instant_ns) * ray) - place_px;
    if (!path_px[k].allFinite()) return {place_px, still_path(), noise_};  // beyond the range of the lens model
  }
  BlurredPoint point{place_px, {}, noise_};
  const std::array<Eigen::Vector2d, kPathInstants> recorded_px = rolling_shutter_path(path_px, exposure_);
  for (int k = 0; k < kPathInstants; ++k) point.path_px[k] = recorded_px[k].cast<float>();
  return point;
}

PredictedPoint predict_point(const Eigen::Vector2d& place_px, const NearbyRays& rays, const BlurredView& from,
                             const BlurredView& to, const CameraMotion& motion) {
  PredictedPoint predicted = rotate_point(place_px, rays, from.exposure(), to.exposure(), motion);
  const auto residual = [&](const Eigen::Vector2d& at_px, const Eigen::Vector2d& rotated_px) -> Eigen::Vector2d {
    const BlurredView::Residual before = from.residual_at(at_px), now = to.residual_at(rotated_px);
    predicted.by_residual = predicted.by_residual && (before.is_known || now.is_known);
    const double both = (before.is_known ? 1 : 0) + (now.is_known ? 1 : 0);
    const double seconds = to_seconds(to.exposure().middle(rotated_px.y()) - from.exposure().middle(at_px.y()));
    return seconds / std::max(1.0, both) * (before.velocity_px_s + now.velocity_px_s);
  };
  predicted.place_px = predicted.rotated_px + residual(place_px, predicted.rotated_px);
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d step_px = kHalfStepPx * Eigen::Vector2d::Unit(axis),
                          rotated_step_px = kHalfStepPx * predicted.rotated_map.col(axis);
    predicted.map.jacobian.col(axis) += (residual(place_px + step_px, predicted.rotated_px + rotated_step_px) -
                                         residual(place_px - step_px, predicted.rotated_px - rotated_step_px)) /
                                        (2 * kHalfStepPx);
  }
  if (!predicted.map.jacobian.allFinite()) predicted.map.jacobian = predicted.rotated_map;
  return predicted;
}

}  // namespace gyro_deblur
