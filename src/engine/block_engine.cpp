// Checks, and copies of blocks without a filter, that all engines share.
#include "engine/block_engine.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "base/parallel.hpp"

namespace gyro_deblur {
namespace {

/// Throws std::invalid_argument unless `src` is a non-empty CV_8U or CV_16U with 1 to 4 channels, and `grid` covers it.
void require_filterable(const cv::Mat& src, const FilterGrid& grid) {
  if ((src.depth() != CV_8U && src.depth() != CV_16U) || src.channels() > 4 || src.empty()) {
    throw std::invalid_argument("an engine takes CV_8U or CV_16U with 1 to 4 channels, at least 1x1");
  }
  const auto covers = [](const std::vector<int>& borders, int length) {
    return borders.size() >= 2 && borders.front() == 0 && borders.back() == length &&
           std::adjacent_find(borders.begin(), borders.end(), std::greater_equal<>()) == borders.end();
  };
  if (!covers(grid.x, src.cols) || !covers(grid.y, src.rows)) {
    throw std::invalid_argument("the borders of a grid must rise from 0 to the image's " + std::to_string(src.cols) +
                                "x" + std::to_string(src.rows) + " px");
  }
  const std::size_t needed = static_cast<std::size_t>(grid.cols()) * grid.rows();
  if (grid.blocks.size() != needed) {
    throw std::invalid_argument("a grid of " + std::to_string(needed) + " blocks has " +
                                std::to_string(grid.blocks.size()) + " filters");
  }
}

}  // namespace

void BlockEngine::filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  require_filterable(src, grid);
  dst.create(src.size(), src.type());
  seams_.plan(grid, src.type());
  with_kernel_.clear();
  with_inverse_.clear();
  for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
    if (grid.blocks[i].kernel != nullptr) with_kernel_.push_back(i);
    if (grid.blocks[i].inverse != nullptr) with_inverse_.push_back(i);
  }
  is_copied_ = false;
  filter_blocks(src, grid, with_kernel_, seams_, dst);
  fourier_filter_.filter(src, grid, with_inverse_, threads(), seams_, dst);
  copy_untouched(src, grid, dst);
  seams_.blend(src, threads(), dst);
}

void BlockEngine::copy_untouched(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  if (is_copied_) return;
  is_copied_ = true;
  for (int i = 0; i < static_cast<int>(grid.blocks.size()); ++i) {
    if (grid.blocks[i].copies()) src(grid.rect(i)).copyTo(dst(grid.rect(i)));
  }
}

int BlockEngine::threads() const { return threads_or_all(threads_); }

}  // namespace gyro_deblur
