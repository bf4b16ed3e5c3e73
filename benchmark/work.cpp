#include "work.hpp"

#include <algorithm>
#include <cmath>

#include "engine/cpu/block_method.hpp"
#include "engine/cpu/block_simd.hpp"
#include "engine/engine.hpp"
#include "engine/seam_blender.hpp"
#include "inverse/line_taps.hpp"
#include "inverse/two_scale_design.hpp"

namespace gyro_deblur::benchmark {
namespace {

// As in two_scale_layout_impl.hpp and two_scale_impl.hpp: coarse outputs that are summed together, and columns in a
// group of int16 samples.
constexpr int kCoarseOutputs = kCoarseGuard + 1;
constexpr int kColumnGroup = 32;
// Instruction sets with vectors of at least so many floats filter 8-bit columns in int16.
constexpr int kLeastFloatsOfIntegerColumns = 8;

double round_up(double n, double step) { return std::ceil(n / step) * step; }

void add_two_scale(const BlockFilter& block, cv::Size size, int lanes_of_vector, Work& work) {
  const LineDirection line = direction_of(block.angle_rad);
  const double stretch = std::abs(line.major), slope = std::abs(line.slope);
  const bool major_is_y = line.major_is_y;
  const double along = major_is_y ? size.height : size.width;
  const double across = major_is_y ? size.width : size.height;

  const bool integers = lanes_of_vector >= kLeastFloatsOfIntegerColumns;
  const int box_half = static_cast<int>(std::floor((block.kernel->box_extent_px * stretch - 1) / 2));
  const double d = TwoScaleDesign::decimation_for(box_half);
  const double radius = std::ceil(std::ceil(block.kernel->radius() * stretch) / d);
  const double columns = round_up(across + slope * along + 5, integers ? kColumnGroup : 2 * lanes_of_vector);
  const double sample_bytes = integers ? sizeof(std::int16_t) : sizeof(float);
  const double group = integers ? kColumnGroup : 2 * lanes_of_vector;
  double& macs = integers ? work.int16_macs : work.float_macs;
  for (double column = 0; column < columns; column += group) {
    // The line through the first pixel of a row goes from column slope * along down to 0; two columns more for the
    // cubic.
    double rows = 0;
    for (double m = 0; m < along; ++m) {
      const double first = slope * (along - m);
      rows += column <= first + across + 5 && column + group > first ? 1 : 0;
    }
    const double coarse_outputs = round_up(std::floor(std::max(rows - 1, 0.0) / d) + 3, kCoarseOutputs);
    const double nodes = coarse_outputs + 2 * radius;
    // Shear: two pixels in, one product of two in int16 or difference and product in float.
    macs += nodes * d * group * 2;
    work.load_bytes += nodes * d * group * 2;
    // Smooth part: every node that is loaded goes into kCoarseOutputs sums.
    const double coarse_macs = coarse_outputs * group * (2 * radius + kCoarseOutputs);
    macs += coarse_macs;
    work.load_bytes += coarse_macs / kCoarseOutputs * sample_bytes;
    // Boxes: two products and four additions with two samples, in float; their first sums.
    work.float_macs += rows * group * 6;
    work.load_bytes += (2 * rows + 2 * box_half) * group * sample_bytes;
  }
  // The cubic across.
  macs += along * across * 4;
  work.load_bytes += along * across * 4 * sample_bytes;
}

void add_exact(const BlockFilter& block, cv::Size size, Work& work) {
  const std::vector<KernelTap> taps = rotate_kernel(*block.kernel, block.angle_rad);
  const bool major_is_y = direction_of(block.angle_rad).major_is_y;
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

Work work_of_float(const FilterGrid& grid) {
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
    const auto [major_is_y, major, slope] = direction_of(block.angle_rad);
    if (takes_sheared_columns(*block.kernel, slope, CV_8U)) {
      const int along = major_is_y ? size.height : size.width;
      const int longest = max_sheared_rows(*block.kernel, slope);
      const int tiles = (along + longest - 1) / longest;
      for (int i = 0; i < tiles; ++i) {
        cv::Size tile = size;
        (major_is_y ? tile.height : tile.width) = along * (i + 1) / tiles - along * i / tiles;
        add_two_scale(block, tile, lanes, work);
      }
    } else {
      add_exact(block, size, work);
    }
  });
  return work;
}

}  // namespace gyro_deblur::benchmark
