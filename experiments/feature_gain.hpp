// What a front end gets of blurred frames: tracks, and matches with the sharp frame.
#pragma once

#include <array>
#include <string>

#include "footage.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur::experiments {

/// How a frame is deblurred.
enum class Knowledge { NONE, ROTATION, IMAGES, TRUTH };
constexpr std::array<Knowledge, 4> kAllKnowledge = {Knowledge::NONE, Knowledge::ROTATION, Knowledge::IMAGES,
                                                    Knowledge::TRUTH};

/// The residual velocities that make the displacement of blocks that of the truth, as certain as can be.
ResidualField true_residuals(const Footage& footage, int frame, const RotationTrack& rotation, const BlockGrid& grid);

/// Means of frames.
struct FeatureCounts {
  double tracks = 0;         ///< that went where the scene went since the frame before, to 1 px
  double sift = 0, orb = 0;  ///< correct matches with the sharp frame, of 1000 features, to 3 px
};

/// Deblurs all frames and counts; one for each of kAllKnowledge. Matches are those of every `step`-th frame.
/// Precondition: a global shutter.
std::array<FeatureCounts, 4> feature_counts(Footage& footage, const Light& light, int step);

}  // namespace gyro_deblur::experiments
