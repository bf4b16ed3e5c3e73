// Grids of blocks for tests of the engines.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "engine/engine.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"

namespace gyro_deblur::test {

/// 0, block_px, 2 block_px, ..., length_px.
inline std::vector<int> borders_of(int length_px, int block_px) {
  std::vector<int> borders;
  for (int border = 0; border < length_px; border += block_px) borders.push_back(border);
  borders.push_back(length_px);
  return borders;
}

/// A grid of blocks of `block_px`, block i with the filter that filter_of(i) returns.
template <typename FilterOf>
FilterGrid make_grid(cv::Size size, int block_px, const FilterOf& filter_of) {
  FilterGrid grid{borders_of(size.width, block_px), borders_of(size.height, block_px), {}};
  for (int i = 0; i < grid.cols() * grid.rows(); ++i) grid.blocks.push_back(filter_of(i));
  return grid;
}

/// One block.
inline FilterGrid one_block(cv::Size size, double angle_rad, const LineKernel& kernel) {
  return {{0, size.width}, {0, size.height}, {{angle_rad, &kernel}}};
}

}  // namespace gyro_deblur::test
