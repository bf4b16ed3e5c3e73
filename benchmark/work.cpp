#include "work.hpp"

#include <algorithm>
#include <cmath>

#include "core/seam_blender.hpp"
#include "cpu/block_kernels.hpp"

namespace gyro_deblur::benchmark {
namespace {

// As in src/cpu: from which extent on lanes are used, and on them two scales; samples of the smooth part in an extent;
// weights of running sums (five at either end of the box).
constexpr double kMinTwoScaleExtentPx = 30;
constexpr double kMinCoarseExtentPx = 48;
constexpr double kCoarseSamplesPerExtent = 20;
constexpr int kEdgeWeights = 10;
constexpr int kCoarseOutputs = kCoarseGuard + 1;

double round_up(double n, double step) { return std::ceil(n / step) * step; }

void add_two_scale(const BlockFilter& block, cv::Size size, int lanes_of_vector, Work& work) {
  const double dx = std::cos(block.angle_rad), dy = std::sin(block.angle_rad);
  const double stretch = std::max(std::abs(dx), std::abs(dy));
  const double slope = std::min(std::abs(dx), std::abs(dy)) / stretch;
  const bool major_is_y = std::abs(dy) > std::abs(dx);
  const double along = major_is_y ? size.height : size.width;
  const double across = major_is_y ? size.width : size.height;

  const double extent = block.kernel->box_extent_px * stretch;
  const double d = extent < kMinCoarseExtentPx ? 1.0 : std::round(extent / kCoarseSamplesPerExtent);
  const double radius = std::ceil(block.kernel->radius() * stretch / d);
  const double lanes = round_up(across + slope * (along - 1) + 6, lanes_of_vector);
  const double coarse_outputs = round_up(along / d + 5, kCoarseOutputs);
  const double nodes = coarse_outputs + 2 * radius;
  const double edge_weights = d > 1 ? kEdgeWeights : 0;

  // Shear: two pixels in; difference, product and sum, and the running sums near the tile.
  work.float_macs += nodes * d * lanes * 3;
  work.load_bytes += nodes * d * lanes * 2;
  // Smooth part: every node that is loaded goes into kCoarseOutputs sums.
  const double coarse_macs = coarse_outputs * lanes * (2 * radius + kCoarseOutputs);
  work.float_macs += coarse_macs;
  work.load_bytes += coarse_macs / kCoarseOutputs * sizeof(float);
  // Sum of the parts for three more pixels than come out, and the cubic across.
  work.float_macs += along * ((across + 3) * (4 + edge_weights) + across * 4);
  work.load_bytes += along * ((across + 3) * (4 + edge_weights) + across * 4) * sizeof(float);
}

void add_exact(const BlockFilter& block, cv::Size size, Work& work) {
  const std::vector<KernelTap> taps = rotate_kernel(*block.kernel, block.angle_rad);
  const bool major_is_y = std::abs(std::sin(block.angle_rad)) > std::abs(std::cos(block.angle_rad));
  const auto step = [&](const KernelTap& tap) { return major_is_y ? tap.dy : tap.dx; };
  // Two neighbours across make a pair.
  double pairs = 0;
  for (std::size_t i = 0; i < taps.size(); ++i, ++pairs) {
    if (i + 1 < taps.size() && step(taps[i + 1]) == step(taps[i])) ++i;
  }
  work.int16_macs += 2 * pairs * size.area();
  work.load_bytes += pairs * size.area() * sizeof(std::int32_t);
}

/// Calls add(block, what is computed of it) for every filtered block.
template <typename Add>
void for_each_filtered(const FilterGrid& grid, const Add& add) {
  SeamBlender seams;
  seams.plan(grid, CV_8UC1);
  for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
    if (grid.blocks[i].kernel != nullptr) add(grid.blocks[i], seams.reach(i).size());
  }
}

}  // namespace

Work work_of_reference(const FilterGrid& grid) {
  Work work;
  for_each_filtered(grid, [&](const BlockFilter& block, cv::Size size) {
    const double macs = static_cast<double>(rotate_kernel(*block.kernel, block.angle_rad).size()) * size.area();
    work.float_macs += macs;
    work.load_bytes += macs * sizeof(float);  // sums stay in registers, pixels do not
  });
  return work;
}

Work work_of_cpu(const FilterGrid& grid, int lanes) {
  Work work;
  for_each_filtered(grid, [&](const BlockFilter& block, cv::Size size) {
    if (block.kernel->box_extent_px >= kMinTwoScaleExtentPx) {
      add_two_scale(block, size, lanes, work);
    } else {
      add_exact(block, size, work);
    }
  });
  return work;
}

}  // namespace gyro_deblur::benchmark
