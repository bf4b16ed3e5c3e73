// Where a deblurred image shows a point, against BlockBlur::apparent_offset_px().
#pragma once

#include <vector>

namespace gyro_deblur::experiments {

/// One image, blurred the same everywhere, along the line of the blur, from where the scene is at the middle of the
/// exposure.
struct ApparentPlace {
  double extent_px = 0;
  double chord_middle_px = 0, mean_place_px = 0;  ///< of the path
  double said_px = 0;                             ///< what apparent_offset_px() says
  double measured_px = 0;                         ///< where corners of the sharp image are found in the deblurred one
};

/// Paths that accelerate as far as they still count as even, for extents of 10 to 60 px.
/// @param images  textures to blur, >= 1
std::vector<ApparentPlace> apparent_places(int images);

/// Slope of the line through the origin nearest to the points (x, y).
double slope(const std::vector<double>& x, const std::vector<double>& y);

}  // namespace gyro_deblur::experiments
