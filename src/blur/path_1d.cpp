// Extent of a straight path and its PSF.
#include "blur/path_1d.hpp"

#include <algorithm>
#include <cmath>

namespace gyro_deblur {

double extent_of(const Path1d& path_px) {
  const auto [lowest, highest] = std::minmax_element(path_px.begin(), path_px.end());
  return static_cast<double>(*highest) - *lowest;
}

double share_within(const Path1d& path_px, double begin_px, double end_px) {
  double intervals = 0;
  for (int k = 0; k + 1 < kPathInstants; ++k) {
    const double from = std::min(path_px[k], path_px[k + 1]), to = std::max(path_px[k], path_px[k + 1]);
    if (from == to) {
      intervals += begin_px <= from && from < end_px ? 1 : 0;
    } else {
      intervals += std::max(0.0, std::min(to, end_px) - std::max(from, begin_px)) / (to - from);
    }
  }
  return intervals / (kPathInstants - 1);
}

std::vector<double> box_blur_kernel(double extent_px, int length) {
  std::vector<double> box(length);
  const int radius = length / 2;
  const double half = extent_px / 2;
  for (int i = 0; i < length; ++i) {
    const double position = i - radius;
    const double covered = std::min(position + 0.5, half) - std::max(position - 0.5, -half);
    box[i] = std::max(covered, 0.0) / extent_px;
  }
  return box;
}

std::vector<double> path_blur_kernel(const Path1d& path_px, int length) {
  std::vector<double> taps(length);
  const auto [lowest, highest] = std::minmax_element(path_px.begin(), path_px.end());
  const int radius = length / 2, first = std::max(0, radius + static_cast<int>(std::floor(*lowest)));
  const int last = std::min(length - 1, radius + static_cast<int>(std::ceil(*highest)));
  for (int i = first; i <= last; ++i) taps[i] = share_within(path_px, i - radius - 0.5, i - radius + 0.5);
  return taps;
}

}  // namespace gyro_deblur
