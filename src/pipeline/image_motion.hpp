// The optical-flow stage: residual velocities, in addition to the gyroscope or without it.
#pragma once

#include <memory>
#include <optional>

#include "features/residual_flow.hpp"
#include "features/residual_rotation.hpp"
#include "gyro_deblur/time.hpp"
#include "pipeline/frame_context.hpp"

namespace gyro_deblur {

/// Optical flow of one camera's images. Not thread-safe.
class ImageMotion {
 public:
  /// Whether there is optical flow at all. What is known of the images so far is kept unless that changes.
  void enable(bool enabled);
  bool enabled() const { return flow_ != nullptr; }

  /// Forgets the images: for another calibration.
  void reset();

  /// Exposure of the newest image; nothing before the first one. Precondition: enabled().
  std::optional<TimeRange> newest_frame() const { return flow_->newest_frame(); }

  /// Fills the frame's residuals and the result's residual_rotation. Precondition: enabled().
  void follow(const FrameCamera& camera, FrameContext& frame);

  /// After follow(): the frame's exposure is `found`, not the one that it was followed by. Where this moves the
  /// exposure's middle far, corners are followed again. No effect unless enabled().
  void correct_exposure(const RowExposure& found, const FrameCamera& camera, FrameContext& frame);

  /// See PipelineResult::seen_rotation. To be called with each image whose picture is new and whose motion the
  /// gyroscope knows. Precondition: enabled().
  std::optional<ResidualRotation> seen_rotation(const FrameCamera& camera, FrameContext& frame);

 private:
  void find_residuals(const RowExposure& exposure, const FrameCamera& camera, FrameContext& frame);

  std::unique_ptr<ResidualFlow> flow_;        // null: not enabled
  std::optional<ResidualFlow> flow_before_;   // what flow_ was before the newest image, where it may be needed again
  bool images_alone_ = false;                 // of the newest image
  std::unique_ptr<ResidualFlow> whole_flow_;  // without the gyroscope's help, see seen_rotation()
  int frames_without_rotation_ = 0;           // in a row
};

}  // namespace gyro_deblur
