// Moves the pixels of a rolling-shutter image to one instant.
#include "features/image_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "base/format.hpp"
#include "base/parallel.hpp"
#include "features/point_motion.hpp"

namespace gyro_deblur {
namespace {

constexpr int kStepPx = GlobalShutterMap::kStepPx;

/// What is known at nodes kStepPx apart, cubic between them (Catmull and Rom): the displacement changes most where a
/// lens distorts most, and linear between nodes it would be wrong by a third of a pixel in the corners of a wide lens.
Eigen::Vector4f cubic_weights(double u) {
  return Eigen::Vector4d(0.5 * u * (u * (2 - u) - 1), 0.5 * (u * u * (3 * u - 5) + 2), 0.5 * u * (u * (4 - 3 * u) + 1),
                         0.5 * u * u * (u - 1))
      .cast<float>();
}

/// Where nodes are in x, or y: the first is outside the image, and the second half a pixel before its first pixel.
double node_px(int index) { return (index - 1) * kStepPx - 0.5; }

/// The four nodes around a place.
struct Between {
  int first;
  Eigen::Vector4f weights;
};

/// @param nodes  in a row or column
Between between(double pixel_px, int nodes) {
  constexpr double kBeyond = 2;  // cells; a pixel at the border comes from beyond it
  const int cells = nodes - 3;
  const double at = std::clamp((pixel_px + 0.5) / kStepPx, -kBeyond, cells + kBeyond);
  const int cell = std::clamp(static_cast<int>(at), 0, cells - 1);
  return {cell, cubic_weights(at - cell)};
}

Eigen::Vector2d interpolate(const cv::Mat& nodes, const Eigen::Vector2d& pixel_px) {
  const Between x = between(pixel_px.x(), nodes.cols), y = between(pixel_px.y(), nodes.rows);
  Eigen::Matrix<float, 2, 4> columns = Eigen::Matrix<float, 2, 4>::Zero();
  for (int j = 0; j < 4; ++j) {
    const float* row = nodes.ptr<float>(y.first + j) + 2 * static_cast<std::ptrdiff_t>(x.first);
    columns += y.weights[j] * Eigen::Map<const Eigen::Matrix<float, 2, 4>>(row);
  }
  return (columns * x.weights).cast<double>();
}

bool is_known(const cv::Vec2f& value) { return std::isfinite(value[0]) && std::isfinite(value[1]); }

/// Gives nodes that are not known the mean of those around them that are, from there on outwards.
/// @return false when none is known
bool fill_gaps(cv::Mat* nodes) {
  const cv::Rect all(0, 0, nodes->cols, nodes->rows);
  for (;;) {
    const cv::Mat before = nodes->clone();
    int known = 0, filled = 0;
    for (int row = 0; row < nodes->rows; ++row) {
      for (int col = 0; col < nodes->cols; ++col) {
        if (is_known(before.at<cv::Vec2f>(row, col))) {
          ++known;
          continue;
        }
        const cv::Rect around = cv::Rect(col - 1, row - 1, 3, 3) & all;
        cv::Vec2f sum(0, 0);
        int count = 0;
        for (int y = around.y; y < around.br().y; ++y) {
          for (int x = around.x; x < around.br().x; ++x) {
            const cv::Vec2f& near = before.at<cv::Vec2f>(y, x);
            if (!is_known(near)) continue;
            sum += near;
            ++count;
          }
        }
        if (count == 0) continue;
        nodes->at<cv::Vec2f>(row, col) = sum / count;
        ++filled;
      }
    }
    if (known == 0) return false;
    if (filled == 0) return true;
  }
}

/// When each row of nodes is seen; the time of the nearest that the motion covers where it does not cover its own.
/// Empty when it covers none.
std::vector<TimeNs> times_of(int rows, int height_px, const CameraMotion& motion, const RowExposure& exposure,
                             TimeNs reference_ns) {
  std::vector<TimeNs> times_ns, covered_ns;
  for (int row = 0; row < rows; ++row) {
    const double y_px = node_px(row);
    times_ns.push_back(exposure.middle(y_px));
    // The outermost nodes lie beyond the image, and perhaps beyond what is known of the motion.
    for (const double row_px : {y_px, std::clamp(y_px, 0.0, height_px - 1.0)}) {
      const TimeNs seen_ns = exposure.middle(row_px);
      if (!motion.covers({std::min(seen_ns, reference_ns), std::max(seen_ns, reference_ns)})) continue;
      covered_ns.push_back(seen_ns);
      break;
    }
  }
  if (covered_ns.empty()) return {};
  const auto [first, last] = std::minmax_element(covered_ns.begin(), covered_ns.end());
  // Of times on both sides of the reference those between are covered, too.
  for (TimeNs& time_ns : times_ns) time_ns = std::clamp(time_ns, *first, *last);
  return times_ns;
}

}  // namespace

Eigen::Vector2d GlobalShutterMap::at(const Eigen::Vector2d& pixel_px) const { return interpolate(nodes_px_, pixel_px); }

bool is_global_shutter(const RowExposure& exposure, TimeNs reference_ns) {
  return exposure.timing().readout_ns == 0 && exposure.middle(0) == reference_ns;
}

GlobalShutterMap global_shutter_map(const FrameBlur& field, const Camera& camera, const CameraMotion& motion,
                                    const RowExposure& exposure, TimeNs reference_ns, int threads) {
  const int width_px = field.grid.width_px(), height_px = field.grid.height_px();
  // One on either side, and the first of another cell behind the image.
  const auto nodes_for = [](int length_px) { return (length_px + kStepPx - 1) / kStepPx + 3; };
  const int rows = nodes_for(height_px), cols = nodes_for(width_px);
  const std::vector<TimeNs> times_ns = times_of(rows, height_px, motion, exposure, reference_ns);
  if (times_ns.empty()) return {};
  const PointMotion point_motion(field, camera, motion);
  const auto to_node = [](const Eigen::Vector2d& px) {
    // cv::remap takes places as 16 bit; NaN stays.
    constexpr double kFarPx = std::numeric_limits<std::int16_t>::max();
    return cv::Vec2f(static_cast<float>(std::clamp(px.x(), -kFarPx, kFarPx)),
                     static_cast<float>(std::clamp(px.y(), -kFarPx, kFarPx)));
  };
  cv::Mat moves_px(rows, cols, CV_32FC2);  // of the image as it arrived
  parallel_for(rows, threads, 1, [&](int row) {
    const PointMotion::Movement movement = point_motion.movement(times_ns[row], reference_ns);
    for (int col = 0; col < cols; ++col) {
      const Eigen::Vector2d pixel_px(node_px(col), node_px(row));
      moves_px.at<cv::Vec2f>(row, col) = to_node(point_motion.moved(pixel_px, movement).pixel_px - pixel_px);
    }
  });
  if (!fill_gaps(&moves_px)) return {};

  GlobalShutterMap map;
  map.size_ = {width_px, height_px};
  map.nodes_px_.create(rows, cols, CV_32FC2);
  parallel_for(rows, threads, 1, [&](int row) {
    Eigen::Vector2d move_px(0, 0), step_px(0, 0);
    for (int col = 0; col < cols; ++col) {
      const Eigen::Vector2d pixel_px(node_px(col), node_px(row));
      // What a row is moved by changes slowly from row to row: a tenth of the error is left each time. It is some
      // pixels at first, and a tenth of one where the two nodes before are known.
      const Eigen::Vector2d before_px = move_px;
      const int iterations = col < 2 ? 5 : 3;
      move_px += step_px;
      for (int i = 0; i < iterations; ++i) move_px = interpolate(moves_px, pixel_px - move_px);
      if (col > 0) step_px = move_px - before_px;
      map.nodes_px_.at<cv::Vec2f>(row, col) = to_node(pixel_px - move_px);
    }
  });
  return map;
}

void GlobalShutterMap::fill(int begin, cv::Mat* x_px, cv::Mat* y_px) const {
  // Of the four nodes around a cell for each of its pixels, which lie half a pixel behind their begin.
  static const auto weights = [] {
    Eigen::Matrix<float, kStepPx, 4> of_pixels;
    for (int i = 0; i < kStepPx; ++i) of_pixels.row(i) = cubic_weights((i + 0.5) / kStepPx);
    return of_pixels;
  }();
  Eigen::Matrix2Xf of_row(2, nodes_px_.cols);
  for (int y = 0; y < x_px->rows; ++y) {
    const Between rows = between(begin + y, nodes_px_.rows);
    of_row.setZero();
    for (int j = 0; j < 4; ++j) {
      of_row +=
          rows.weights[j] * Eigen::Map<const Eigen::Matrix2Xf>(nodes_px_.ptr<float>(rows.first + j), 2, nodes_px_.cols);
    }
    for (int cell = 0; cell < nodes_px_.cols - 3; ++cell) {
      const auto nodes = of_row.middleCols<4>(cell);
      Eigen::Map<Eigen::Matrix<float, kStepPx, 1>> x(x_px->ptr<float>(y) + cell * kStepPx);
      Eigen::Map<Eigen::Matrix<float, kStepPx, 1>> y_to(y_px->ptr<float>(y) + cell * kStepPx);
      x.noalias() = weights * nodes.row(0).transpose();
      y_to.noalias() = weights * nodes.row(1).transpose();
    }
  }
}

cv::Mat to_global_shutter(const cv::Mat& image, const GlobalShutterMap& map, int threads) {
  if (map.empty() || image.size() != map.size() || (image.depth() != CV_8U && image.depth() != CV_16U)) {
    throw std::invalid_argument(format("image of %dx%d px, OpenCV depth %d, does not fit a map of %dx%d px", image.cols,
                                       image.rows, image.depth(), map.size().width, map.size().height));
  }
  cv::Mat moved(image.size(), image.type());
  const int whole_cells_px = (image.cols + kStepPx - 1) / kStepPx * kStepPx;
  // The map of so many rows stays in the fast caches.
  constexpr int kRows = 16;
  parallel_for((image.rows + kRows - 1) / kRows, threads, 1, [&](int strip) {
    const int begin = strip * kRows;
    cv::Mat rows = moved.rowRange(begin, std::min(begin + kRows, image.rows));
    cv::Mat x_px(rows.rows, whole_cells_px, CV_32FC1), y_px(rows.rows, whole_cells_px, CV_32FC1);
    map.fill(begin, &x_px, &y_px);
    cv::remap(image, rows, x_px.colRange(0, image.cols), y_px.colRange(0, image.cols), cv::INTER_LINEAR);
  });
  return moved;
}

}  // namespace gyro_deblur
