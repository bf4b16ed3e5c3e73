#include "blur/block_texture.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include <opencv2/imgproc.hpp>

namespace gyro_deblur {
namespace {

// c over the mean square of a gradient of means of 2 x 2 px, for texture whose power falls with the cube of the
// frequency in the plane, which is c / f^2 along any line: integrated over all frequencies. Blur along the line leaves
// less of the gradients along it, in proportion to its extent.
constexpr double kAcross = 0.0254;
constexpr double kAlong = 0.0125, kAlongPerPx = 0.0066;

}  // namespace

cv::Mat means_of_pairs(const cv::Mat& luminance) {
  cv::Mat means;
  cv::resize(luminance, means, {std::max(1, luminance.cols / 2), std::max(1, luminance.rows / 2)}, 0, 0,
             cv::INTER_AREA);
  return means;
}

double texture_along_line(const cv::Mat& means, const cv::Rect& block, double angle_rad, double extent_px,
                          double noise_variance) {
  const int left = block.x / 2, right = std::min((block.x + block.width) / 2, means.cols) - 1;
  const int top = block.y / 2, bottom = std::min((block.y + block.height) / 2, means.rows) - 1;
  if (right <= left || bottom <= top) return 0;
  // Differences along the two diagonals, whose noise is not the same pixels'.
  std::int64_t uu = 0, vv = 0, uv = 0;
  for (int y = top; y < bottom; ++y) {
    const std::uint8_t *a = means.ptr<std::uint8_t>(y), *b = means.ptr<std::uint8_t>(y + 1);
    int row_uu = 0, row_vv = 0, row_uv = 0;
    for (int x = left; x < right; ++x) {
      const int u = b[x + 1] - a[x], v = a[x + 1] - b[x];
      row_uu += u * u;
      row_vv += v * v;
      row_uv += u * v;
    }
    uu += row_uu;
    vv += row_vv;
    uv += row_uv;
  }
  const double count = static_cast<double>(right - left) * (bottom - top);
  // x is along (u + v) / 2, y along (u - v) / 2.
  const double xx = (uu + 2.0 * uv + vv) / (4 * count), yy = (uu - 2.0 * uv + vv) / (4 * count);
  const double xy = (uu - vv) / (4 * count);
  const double dx = std::cos(angle_rad), dy = std::sin(angle_rad);
  const double noise = noise_variance / 4 + 1.0 / 12;  // of a mean, rounded
  const double along = std::max(0.0, dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy - noise);
  const double across = std::max(0.0, dy * dy * xx - 2 * dx * dy * xy + dx * dx * yy - noise);
  return 0.5 * (kAcross * across + (kAlong + kAlongPerPx * extent_px) * along);
}

}  // namespace gyro_deblur
