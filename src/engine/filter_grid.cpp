// Borders of the blocks of a filter grid.
#include "engine/engine.hpp"

namespace gyro_deblur {

cv::Rect FilterGrid::rect(int index) const {
  const int col = index % cols(), row = index / cols();
  return {x[col], y[row], x[col + 1] - x[col], y[row + 1] - y[row]};
}

}  // namespace gyro_deblur
