#include "gyro_deblur/image_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"

namespace gyro_deblur {
namespace {

constexpr int kStepPx = 16;

/// Residual velocities [px/s] of blocks, to be interpolated.
class VelocityField {
 public:
  explicit VelocityField(const FrameBlur& field) : grid_(field.grid) {
    for (const BlockBlur& block : field.blocks) {
      velocities_.push_back(block.residual ? block.residual->velocity_px_s : Eigen::Vector2d::Zero());
      moves_ = moves_ || block.residual;
    }
  }

  Eigen::Vector2d at(const Eigen::Vector2d& pixel_px) const {
    if (!moves_) return Eigen::Vector2d::Zero();
    const double size = grid_.block_size_px();
    const double col = std::clamp((pixel_px.x() + 0.5) / size - 0.5, 0.0, grid_.cols() - 1.0);
    const double row = std::clamp((pixel_px.y() + 0.5) / size - 0.5, 0.0, grid_.rows() - 1.0);
    const int col0 = std::min(static_cast<int>(col), std::max(0, grid_.cols() - 2));
    const int row0 = std::min(static_cast<int>(row), std::max(0, grid_.rows() - 2));
    const int col1 = std::min(col0 + 1, grid_.cols() - 1), row1 = std::min(row0 + 1, grid_.rows() - 1);
    const double u = col - col0, v = row - row0;
    const auto block = [&](int r, int c) { return velocities_[r * grid_.cols() + c]; };
    return (1 - v) * ((1 - u) * block(row0, col0) + u * block(row0, col1)) +
           v * ((1 - u) * block(row1, col0) + u * block(row1, col1));
  }

 private:
  BlockGrid grid_;
  std::vector<Eigen::Vector2d> velocities_;
  bool moves_ = false;
};

}  // namespace

cv::Mat global_shutter_map(const FrameBlur& field, const Camera& camera, const CameraMotion& motion,
                           const RowExposure& exposure, TimeNs reference_ns) {
  const int width = camera.calibration().width_px, height = camera.calibration().height_px;
  const VelocityField velocities(field);
  // Nodes lie outside the image on all sides, so that every pixel is between four.
  const int cols = (width - 1) / kStepPx + 2, rows = (height - 1) / kStepPx + 2;
  cv::Mat nodes(rows, cols, CV_32FC2);
  run_parallel(rows, 1, 1, [&](int row) {
    for (int col = 0; col < cols; ++col) {
      const Eigen::Vector2d at_px(std::min(col * kStepPx, width - 1), std::min(row * kStepPx, height - 1));
      const Eigen::Vector3d ray = camera.ray(at_px);
      Eigen::Vector2d from_px = at_px;
      // The row decides when it is seen, and that decides the row.
      for (int iteration = 0; iteration < 3; ++iteration) {
        const TimeNs seen_ns = exposure.middle(std::clamp(from_px.y(), 0.0, height - 1.0));
        if (!motion.covers({std::min(seen_ns, reference_ns), std::max(seen_ns, reference_ns)})) {
          from_px = at_px;
          break;
        }
        from_px = camera.project(motion.rotation(reference_ns, seen_ns) * ray) +
                  to_seconds(seen_ns - reference_ns) * velocities.at(from_px);
        if (!from_px.allFinite()) break;
      }
      nodes.at<cv::Vec2f>(row, col) = {static_cast<float>(from_px.x()), static_cast<float>(from_px.y())};
    }
  });
  cv::Mat map(height, width, CV_32FC2);
  for (int y = 0; y < height; ++y) {
    const int row = y / kStepPx, y0 = row * kStepPx, y1 = std::min(y0 + kStepPx, height - 1);
    const float v = y1 > y0 ? static_cast<float>(y - y0) / static_cast<float>(y1 - y0) : 0;
    for (int col = 0; col + 1 < cols; ++col) {
      const int x0 = col * kStepPx, x1 = std::min(x0 + kStepPx, width - 1);
      const cv::Vec2f left = nodes.at<cv::Vec2f>(row, col) * (1 - v) + nodes.at<cv::Vec2f>(row + 1, col) * v;
      const cv::Vec2f right = nodes.at<cv::Vec2f>(row, col + 1) * (1 - v) + nodes.at<cv::Vec2f>(row + 1, col + 1) * v;
      const cv::Vec2f step = (right - left) * (1.0f / static_cast<float>(std::max(1, x1 - x0)));
      for (int x = x0; x < std::min(x0 + kStepPx, width); ++x) {
        map.at<cv::Vec2f>(y, x) = left + step * static_cast<float>(x - x0);
      }
    }
  }
  return map;
}

cv::Mat to_global_shutter(const cv::Mat& image, const cv::Mat& map) {
  cv::Mat moved;
  cv::remap(image, moved, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar::all(0));
  return moved;
}

}  // namespace gyro_deblur
