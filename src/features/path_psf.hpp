// PSF of a point's path, and how it correlates the noise of an image that is blurred by it.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

#include "blur/path_2d.hpp"

namespace gyro_deblur {

/// Pixels, both ends included.
struct PixelBox {
  int first_x = 0, last_x = -1, first_y = 0, last_y = -1;
  int width() const { return last_x - first_x + 1; }
  int height() const { return last_y - first_y + 1; }
  PixelBox grown(const PixelBox& by) const {
    return {first_x + by.first_x, last_x + by.last_x, first_y + by.first_y, last_y + by.last_y};
  }
  bool contains(const PixelBox& other) const {
    return other.first_x >= first_x && other.last_x <= last_x && other.first_y >= first_y && other.last_y <= last_y;
  }
};

/// Two pixels that are read for one that is written: one, and the next along the axis of the PSF's pairs.
struct PathPair {
  int x, y;             ///< of the first, from the first of PathPsf::reach
  float first, second;  ///< shares
};

/// The pixels that are read for one that is written.
struct PathPsf {
  std::vector<PathPair> pairs;  ///< shares sum to 1; no pixel has shares in two pairs
  int axis = 0;                 ///< 0: a pair's second pixel is to the right of its first; 1: below
  PixelBox reach;               ///< of all pixels, from the written one; two or more along each axis
  float energy = 0;             ///< sum of the squared shares
};

/// PSF whose mean is that of the mirrored path, to rounding. A path that follows one axis, within 45 degrees and
/// without going back, has two pixels in each row or column that it crosses. Each sample of other paths has four
/// (bilinear).
/// @param path_px  finite, extents up to kMax2dExtentPx
void rasterize(const Path2d& path_px, PathPsf* psf);

/// Pixels x columns and y >= 0 rows apart, and those the other way.
struct NoiseLag {
  int x, y;
  float correlation;  ///< of white noise of variance 1 that is blurred by a path; both ways together
};

/// Correlations that a path makes, as a straight path of uniform speed with its variance would.
/// @param spacing  >= 1 in x and y, one of them 1 [px]: of the pixels that lags count
/// @param lags     overwritten
void find_noise_lags(const Path2d& path_px, const std::array<int, 2>& spacing, std::vector<NoiseLag>* lags);

}  // namespace gyro_deblur
