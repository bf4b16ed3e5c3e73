// Paths of an image's points during its exposure.
#include "features/blurred_view.hpp"

#include <algorithm>

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
  bool by_residual = true;
  const auto rotate = [&](const Eigen::Vector2d& at_px) -> Eigen::Vector2d {
    return predicted_pixel(at_px, rays.ray(at_px), rays.camera(), motion, from.exposure(), to.exposure())
        .value_or(at_px);
  };
  const auto residual = [&](const Eigen::Vector2d& at_px, const Eigen::Vector2d& rotated_px) -> Eigen::Vector2d {
    const BlurredView::Residual before = from.residual_at(at_px), now = to.residual_at(rotated_px);
    by_residual = by_residual && (before.is_known || now.is_known);
    const double both = (before.is_known ? 1 : 0) + (now.is_known ? 1 : 0);
    const double seconds = to_seconds(to.exposure().middle(rotated_px.y()) - from.exposure().middle(at_px.y()));
    return seconds / std::max(1.0, both) * (before.velocity_px_s + now.velocity_px_s);
  };
  PredictedPoint predicted;
  predicted.rotated_px = rotate(place_px);
  predicted.place_px = predicted.rotated_px + residual(place_px, predicted.rotated_px);
  constexpr double kHalfStepPx = 7;  // as far as the compared patch reaches in most directions
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d step_px = kHalfStepPx * Eigen::Vector2d::Unit(axis);
    const Eigen::Vector2d ahead_px = rotate(place_px + step_px), behind_px = rotate(place_px - step_px);
    predicted.rotated_map.col(axis) = (ahead_px - behind_px) / (2 * kHalfStepPx);
    predicted.map.col(axis) =
        predicted.rotated_map.col(axis) +
        (residual(place_px + step_px, ahead_px) - residual(place_px - step_px, behind_px)) / (2 * kHalfStepPx);
  }
  predicted.by_residual = by_residual;
  if (!predicted.rotated_map.allFinite()) predicted.rotated_map.setIdentity();
  if (!predicted.map.allFinite()) predicted.map.setIdentity();
  return predicted;
}

}  // namespace gyro_deblur
