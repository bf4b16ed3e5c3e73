// Finds and rectifies the keypoints of an image.
#include "pipeline/keypoint_stage.hpp"

#include <cstddef>
#include <exception>
#include <limits>
#include <utility>
#include <vector>

#include "base/stopwatch.hpp"
#include "features/point_covariance.hpp"
#include "features/point_motion.hpp"

namespace gyro_deblur {
namespace {

std::vector<Eigen::Vector2d> positions(const std::vector<cv::KeyPoint>& keypoints) {
  std::vector<Eigen::Vector2d> points;
  points.reserve(keypoints.size());
  for (const cv::KeyPoint& keypoint : keypoints) points.emplace_back(keypoint.pt.x, keypoint.pt.y);
  return points;
}

/// Covariances of a result's rectified points. @param luminance  deblurred
std::vector<Eigen::Matrix2d> covariances(const cv::Mat& luminance, const std::string& detector,
                                         const RowExposure& exposure, const PipelineResult& result) {
  const PointCovariance covariance(luminance, result.field);
  const PointErrors& errors = detector == "SIFT" || detector == "AKAZE" ? kBlobErrors : kCornerErrors;
  std::vector<Eigen::Matrix2d> of_points;
  of_points.reserve(result.points.size());
  for (std::size_t i = 0; i < result.points.size(); ++i) {
    const cv::KeyPoint& keypoint = result.features.keypoints[i];
    const Eigen::Vector2d pixel_px(keypoint.pt.x, keypoint.pt.y);
    of_points.push_back(covariance.at(pixel_px, corner_radius_px(keypoint, detector), errors));
    if (!result.points[i].rectified) continue;
    const BlockBlur& block = result.field.blocks[result.field.grid.index_at(pixel_px.x(), pixel_px.y())];
    of_points.back() += covariance_of_moving(block, to_seconds(result.reference_ns - exposure.middle(pixel_px.y())));
  }
  return of_points;
}

}  // namespace

void KeypointStage::set_options(KeypointOptions options) noexcept {
  if (options == options_) return;
  extractor_.reset();
  options_ = std::move(options);
}

void KeypointStage::find(const cv::Mat& luminance, const FrameCamera& camera, FrameContext& frame) {
  PipelineResult& result = frame.result;
  const StageTimer timer(&result.times.keypoints_ms);
  extract(luminance, camera.mask, &result);
  result.points = rectify_points(positions(result.features.keypoints), result.field, camera.camera,
                                 frame.known_motion(), frame.exposure, result.reference_ns);
  result.covariances_px2 = covariances(luminance, options_.detector, frame.exposure, result);
}

void KeypointStage::find_unrectified(const cv::Mat& luminance, const PixelMask& mask,
                                     const std::optional<Camera>& camera, PipelineResult* result) {
  extract(luminance, mask, result);
  for (const Eigen::Vector2d& pixel_px : positions(result->features.keypoints)) {
    RectifiedPoint point;
    point.rectified_px = pixel_px;
    point.normalized = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    if (camera) point.normalized = camera->normalized(camera->ray(pixel_px));
    result->points.push_back(point);
    // The blur of the image is not known.
    result->covariances_px2.push_back(Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity()).asDiagonal());
  }
}

void KeypointStage::extract(const cv::Mat& luminance, const PixelMask& mask, PipelineResult* result) {
  try {
    if (!extractor_) extractor_ = std::make_unique<FeatureExtractor>(options_);
    result->features = extractor_->extract(luminance, mask);
  } catch (const std::exception& error) {
    result->features = {};
    result->keypoints_text = error.what();
  }
}

}  // namespace gyro_deblur
