// Weights that interpolate an image between its pixels.
#pragma once

#include <Eigen/Core>

#include "features/alignment_simd.hpp"

namespace gyro_deblur {

/// Of the pixels that are read along an axis, so many are before the one that the place is in.
constexpr int kInterpolationBefore = 2;

/// kInterpolationSteps + 1 rows of kInterpolationStride weights, by the fraction of a pixel, for
/// AlignmentSimd::sample_row(). Lanczos' window of three pixels about sinc, with unit sum.
const float* interpolation_table();

/// A row of it.
using InterpolationWeights = Eigen::Array<float, kInterpolationStride, 1>;
/// @param fraction  [0, 1]
Eigen::Map<const InterpolationWeights> interpolation_weights(double fraction);

}  // namespace gyro_deblur
