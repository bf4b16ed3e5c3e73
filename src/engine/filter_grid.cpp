#include "engine/filter_grid.hpp"

#include <algorithm>
#include <functional>
#include <stdexcept>
#include <string>

namespace gyro_deblur {

cv::Rect FilterGrid::rect(int index) const {
  const int col = index % cols(), row = index / cols();
  return {x[col], y[row], x[col + 1] - x[col], y[row + 1] - y[row]};
}

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

}  // namespace gyro_deblur
