// Path of a scene point along a line during the exposure, and its PSF.
#pragma once

#include <vector>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// From the lowest to the highest place [px].
double extent_of(const Path1d& path_px);

/// Share of the exposure, 0 to 1, that the path spends in [begin_px, end_px).
double share_within(const Path1d& path_px, double begin_px, double end_px);

/// Box of `extent_px` as `length` taps (odd): centred, unit sum, edges weighted by coverage. Preconditions:
/// extent_px > 0, length odd and >= extent_px.
std::vector<double> box_blur_kernel(double extent_px, int length);

/// The blur of a point that runs along `path_px`: the share of the exposure that it spends in each pixel, as `length`
/// taps (odd), the middle of the exposure at the middle one. Precondition: the path stays inside the taps.
std::vector<double> path_blur_kernel(const Path1d& path_px, int length);

}  // namespace gyro_deblur
