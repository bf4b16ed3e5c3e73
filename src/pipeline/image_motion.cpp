// Runs optical flow for a pipeline.
#include "pipeline/image_motion.hpp"

#include <cstddef>
#include <cstdlib>
#include <utility>

#include "features/gyro_unit_watch.hpp"

namespace gyro_deblur {
namespace {

/// Residual velocities of blocks that have a pixel that is used.
ResidualField of_used(ResidualField residuals, const BlockGrid& grid, const PixelMask& mask) {
  for (std::size_t i = 0; !mask.empty() && i < residuals.size(); ++i) {
    const cv::Rect rect = grid.rect(static_cast<int>(i));
    if (mask.masked_in(rect) == rect.area()) residuals[i].reset();
  }
  return residuals;
}

/// Rate of a camera [rad/s], in its axes; 0 where its motion is not known. At most 3000 rad/s, where the rotation
/// within the time that it is taken over is half a revolution.
Eigen::Vector3d rate_at(const CameraMotion& motion, TimeNs t_ns) {
  constexpr TimeNs kHalfNs = 500'000;
  const TimeRange range{t_ns - kHalfNs, t_ns + kHalfNs};
  if (!motion.covers(range)) return Eigen::Vector3d::Zero();
  const Eigen::AngleAxisd rotation(motion.rotation(range.begin_ns, range.end_ns));
  return -rotation.angle() / to_seconds(range.end_ns - range.begin_ns) * rotation.axis();
}

/// Whether corners have to be followed again by the exposure that was found. Its middle is another one, by more than
/// 1 % of the time since the image before: so much of the rotation was taken for residual velocities.
bool moves_corners(const TimeRange& before, const RowExposure& assumed, const RowExposure& found) {
  constexpr TimeNs kParts = 100;
  return kParts * std::abs(found.middle(0) - assumed.middle(0)) > assumed.start(0) - before.begin_ns;
}

}  // namespace

void ImageMotion::enable(bool enabled) {
  if (enabled == this->enabled()) return;
  flow_ = enabled ? std::make_unique<ResidualFlow>() : nullptr;
  flow_before_.reset();
  images_alone_ = false;
}

void ImageMotion::reset() {
  if (flow_) flow_->reset();
  flow_before_.reset();
  whole_flow_.reset();
}

void ImageMotion::follow(const FrameCamera& camera, FrameContext& frame) {
  if (frame.images_alone != images_alone_) {
    flow_->change_motion(camera.camera, camera.grid(), frame.images_alone ? &frame.motion : nullptr);
  }
  images_alone_ = frame.images_alone;
  flow_->set_mask(camera.mask);
  flow_before_.reset();
  if (frame.request.exposure) flow_before_ = *flow_;
  find_residuals(frame.exposure, camera, frame);
}

void ImageMotion::find_residuals(const RowExposure& exposure, const FrameCamera& camera, FrameContext& frame) {
  const bool repeats_picture = frame.request.repeats_picture;
  // A picture that was not followed the first time, for it passed through then, is followed now.
  std::optional<ResidualField> found;
  if (repeats_picture) found = flow_->found_for(exposure, camera.grid());
  frame.residuals = found ? *std::move(found)
                          : flow_->follow(frame.luminance(), camera.camera, frame.known_motion(), exposure,
                                          camera.grid(), camera.threads);
  if (frame.images_alone || repeats_picture) return;
  frame.result.residual_rotation = fit_residual_rotation(of_used(frame.residuals, camera.grid(), camera.mask),
                                                         camera.grid(), camera.camera, frame.motion, exposure);
}

void ImageMotion::correct_exposure(const RowExposure& found, const FrameCamera& camera, FrameContext& frame) {
  if (!flow_) return;
  const std::optional<TimeRange> before = flow_before_ ? flow_before_->newest_frame() : std::nullopt;
  if (before && moves_corners(*before, frame.exposure, found)) {
    *flow_ = *std::move(flow_before_);
    flow_before_.reset();
    find_residuals(found, camera, frame);
  } else {
    flow_->correct_exposure(camera.camera, found);
  }
}

std::optional<ResidualRotation> ImageMotion::seen_rotation(const FrameCamera& camera, FrameContext& frame) {
  // Fast motion, and images in which nothing can be followed, are soon over; a wrong unit lasts.
  constexpr int kFewestFrames = 3;
  const FrameBlur& field = frame.result.field;
  const bool too_large = 2 * field.count(BlockStatus::TOO_LARGE) > field.blocks.size();
  if (frame.result.residual_rotation && !too_large) {
    frames_without_rotation_ = 0;
    whole_flow_.reset();
    ResidualRotation seen = *frame.result.residual_rotation;
    seen.rate_rad_s += seen.known_rad_s;
    return seen;
  }
  const BlockGrid& grid = camera.grid();
  const Eigen::Vector3d gyro_rad_s = rate_at(frame.motion, frame.exposure.middle(0.5 * (grid.height_px() - 1)));
  if (++frames_without_rotation_ < kFewestFrames || gyro_rad_s.norm() < GyroUnitWatch::kLeastGyroRadS) {
    return std::nullopt;
  }
  if (!whole_flow_) whole_flow_ = std::make_unique<ResidualFlow>();
  whole_flow_->set_mask(camera.mask);
  const StationaryCamera stationary;
  const ResidualField whole =
      whole_flow_->follow(frame.luminance(), camera.camera, stationary, frame.exposure, grid, camera.threads);
  std::optional<ResidualRotation> seen =
      fit_residual_rotation(of_used(whole, grid, camera.mask), grid, camera.camera, stationary, frame.exposure);
  if (seen) seen->known_rad_s = gyro_rad_s;
  return seen;
}

}  // namespace gyro_deblur
