// How wrong the displacement of blocks is: of the gyroscope alone, with the true velocity, with the images.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "footage.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur::experiments {

/// Of what the pixel sees at the middle of its row's exposure, from the start to the end of that exposure.
Eigen::Vector2d displacement_px(const Camera& camera, const CameraMotion& motion, const RowExposure& exposure,
                                const Eigen::Vector2d& pixel_px);

/// One block of one frame [px over the exposure].
struct BlockErrors {
  int frame = 0;
  double residual_px = 0;    ///< truth less rotation: what there was to find; the error of the gyroscope alone
  double velocity_px = 0;    ///< error with the true velocity and the frame's true median depth
  double images_px = 0;      ///< error with optical flow
  double change_px = 0;      ///< what the images changed of the displacement by rotation
  double normalized = 0;     ///< error of the images' velocity in its own standard deviations; NaN where there is none
  bool from_images = false;  ///< the images were certain enough to be used
};

/// What was filmed; the same flight twice where the scene is cut.
struct Sequence {
  std::vector<const Footage*> of_frame;
  std::vector<int> frames;  ///< of each footage, in order
};

/// All frames of one footage.
Sequence all_frames(const Footage& footage);

/// Of all blocks of all frames after the first two: of the first one nothing is known, and of the second one not how
/// its motion changes.
std::vector<BlockErrors> displacement_errors(const Sequence& sequence, const Light& light,
                                             const RotationTrack& rotation);

}  // namespace gyro_deblur::experiments
