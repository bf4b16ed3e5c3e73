// Measures the texture of a block by its gradients.
#include "blur/block_texture.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace gyro_deblur {
namespace {

// c over the mean square of a gradient of means of 2 x 2 px, for texture whose power falls with the cube of the
// two-dimensional frequency, which is c / f^2 along any line: integrated over all frequencies. Blur reduces the
// gradients along its line in proportion to its extent.
constexpr double kAcross = 0.0254;
constexpr double kAlong = 0.0125, kAlongPerPx = 0.0066;

}  // namespace

double texture_along_line(const cv::Mat& luminance, const cv::Rect& block, double angle_rad, double extent_px,
                          double noise_variance) {
  // Differences of means along the two diagonals, whose noise is not the same pixels'. Every second row of them will
  // do.
  const int cols = block.width / 2;
  std::int64_t uu = 0, vv = 0, uv = 0, count = 0;
  // Sums of 2 x 2 px. In 16 bits compilers multiply and add eight at a time.
  thread_local std::vector<std::int16_t> upper, lower;
  upper.resize(std::max(cols, 0));
  lower.resize(upper.size());
  const auto sum_rows = [&](int y, std::int16_t* sums) {
    const std::uint8_t *a = luminance.ptr<std::uint8_t>(y) + block.x, *b = luminance.ptr<std::uint8_t>(y + 1) + block.x;
    for (int x = 0; x < cols; ++x) {
      std::uint16_t pair_a, pair_b;
      std::memcpy(&pair_a, a + 2 * x, sizeof pair_a);
      std::memcpy(&pair_b, b + 2 * x, sizeof pair_b);
      sums[x] = static_cast<std::int16_t>((pair_a & 0xff) + (pair_a >> 8) + (pair_b & 0xff) + (pair_b >> 8));
    }
  };
  std::int16_t *above = upper.data(), *below = lower.data();
  constexpr int kRows = 4;
  for (int y = block.y; y + kRows <= block.y + block.height; y += kRows) {
    sum_rows(y, above);
    sum_rows(y + 2, below);
    int row_uu = 0, row_vv = 0, row_uv = 0;
    for (int x = 0; x + 1 < cols; ++x) {
      const auto u = static_cast<std::int16_t>(below[x + 1] - above[x]);
      const auto v = static_cast<std::int16_t>(above[x + 1] - below[x]);
      row_uu += u * u;
      row_vv += v * v;
      row_uv += u * v;
    }
    uu += row_uu;
    vv += row_vv;
    uv += row_uv;
    count += cols - 1;
  }
  if (count <= 0) return 0;
  // x is along (u + v) / 2, y along (u - v) / 2; sums are four times the means.
  const double scale = 1.0 / (16 * 4 * static_cast<double>(count));
  const auto sum_uu = static_cast<double>(uu), sum_vv = static_cast<double>(vv), sum_uv = static_cast<double>(uv);
  const double xx = (sum_uu + 2 * sum_uv + sum_vv) * scale, yy = (sum_uu - 2 * sum_uv + sum_vv) * scale;
  const double xy = (sum_uu - sum_vv) * scale;
  const double dx = std::cos(angle_rad), dy = std::sin(angle_rad);
  const double noise = noise_variance / 4;  // of a mean
  const double along = std::max(0.0, dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy - noise);
  const double across = std::max(0.0, dy * dy * xx - 2 * dx * dy * xy + dx * dx * yy - noise);
  return 0.5 * (kAcross * across + (kAlong + kAlongPerPx * extent_px) * along);
}

}  // namespace gyro_deblur
