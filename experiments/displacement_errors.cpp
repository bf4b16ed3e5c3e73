#include "displacement_errors.hpp"

#include <limits>
#include <numeric>

#include "features/residual_flow.hpp"
#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::experiments {
Eigen::Vector2d displacement_px(const Camera& camera, const CameraMotion& motion, const RowExposure& exposure,
                                const Eigen::Vector2d& pixel_px) {
  const TimeNs middle_ns = exposure.middle(pixel_px.y());
  const Eigen::Vector3d ray = camera.ray(pixel_px);
  return camera.project(motion.rotation(middle_ns, exposure.end(pixel_px.y())) * ray) -
         camera.project(motion.rotation(middle_ns, exposure.start(pixel_px.y())) * ray);
}

Sequence all_frames(const Footage& footage) {
  Sequence sequence;
  sequence.frames.resize(footage.frames());
  std::iota(sequence.frames.begin(), sequence.frames.end(), 0);
  sequence.of_frame.assign(sequence.frames.size(), &footage);
  return sequence;
}

std::vector<BlockErrors> displacement_errors(const Sequence& sequence, const Light& light,
                                             const RotationTrack& rotation) {
  constexpr std::size_t kFirst = 2;
  std::vector<BlockErrors> errors;
  const Camera& camera = sequence.of_frame.front()->camera();
  const BlurFieldEstimator estimator(camera, BlurFieldOptions{});
  const BlockGrid& grid = estimator.grid();
  ResidualFlow flow;
  for (std::size_t k = 0; k < sequence.frames.size(); ++k) {
    const Footage& footage = *sequence.of_frame[k];
    const int i = sequence.frames[k];
    const RowExposure exposure = footage.exposure(i);
    const ResidualField velocities = flow.follow(footage.image(i, light), camera, rotation, exposure, grid);
    if (k < kFirst) continue;
    const FrameBlur field = estimator.estimate(rotation, exposure, velocities);
    const double depth_m = footage.median_depth_m(i, grid);
    const double exposure_s = to_seconds(exposure.timing().exposure_ns);
    for (int b = 0; b < grid.size(); ++b) {
      const Eigen::Vector2d center_px = grid.center(b), truth_px = footage.truth().truth_displacement(i, center_px);
      const Eigen::Vector2d rotation_px = displacement_px(camera, rotation, exposure, center_px);
      if (!truth_px.allFinite() || !rotation_px.allFinite()) continue;
      const Eigen::Vector2d residual_px = truth_px - rotation_px;
      const auto& used = field.blocks[b].residual;
      const Eigen::Vector2d images_px = used ? exposure_s * used->velocity_px_s : Eigen::Vector2d(0, 0);
      BlockErrors& e = errors.emplace_back();
      e.frame = i;
      e.residual_px = residual_px.norm();
      e.velocity_px = (footage.displacement_at_depth(i, center_px, depth_m) - truth_px).norm();
      e.images_px = (images_px - residual_px).norm();
      e.change_px = images_px.norm();
      e.from_images = used.has_value();
      e.normalized = std::numeric_limits<double>::quiet_NaN();
      if (!velocities.empty() && velocities[b]) {
        e.normalized = (velocities[b]->velocity_px_s - residual_px / exposure_s).norm() / velocities[b]->stddev_px_s;
      }
    }
  }
  return errors;
}

}  // namespace gyro_deblur::experiments
