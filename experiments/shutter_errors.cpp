#include "shutter_errors.hpp"

#include <opencv2/imgproc.hpp>

#include "features/residual_flow.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/image_rectification.hpp"

namespace gyro_deblur::experiments {
namespace {

/// The map at places between pixels.
std::vector<cv::Vec2f> looked_up(const cv::Mat& map, const std::vector<cv::Point2f>& places) {
  cv::Mat found;
  cv::remap(map, found, cv::Mat(places, false), cv::noArray(), cv::INTER_LINEAR);
  return std::vector<cv::Vec2f>(found.begin<cv::Vec2f>(), found.end<cv::Vec2f>());
}

}  // namespace

std::array<std::vector<double>, 4> shutter_errors(const Footage& footage, const Light& light) {
  constexpr int kFirst = 2, kStepPx = 16;
  const Camera& camera = footage.camera();
  const cv::Size size(camera.calibration().width_px, camera.calibration().height_px);
  const RotationTrack rotation = footage.rotation();
  const BlurFieldEstimator estimator(camera, BlurFieldOptions{});
  ResidualFlow flow;
  std::array<std::vector<double>, 4> errors;
  for (int i = 0; i < footage.frames(); ++i) {
    const RowExposure exposure = footage.exposure(i);
    const ResidualField by_images = flow.follow(footage.image(i, light), camera, rotation, exposure, estimator.grid());
    if (i < kFirst) continue;
    const TimeNs reference_ns = footage.truth().reference_time(i);
    std::vector<cv::Point2f> shown, moved;  // at its row's time, and at the reference time
    for (int y = kStepPx / 2; y < size.height; y += kStepPx) {
      for (int x = kStepPx / 2; x < size.width; x += kStepPx) {
        const Eigen::Vector2d there_px = footage.truth().truth_rectified(i, Eigen::Vector2d(x, y), reference_ns);
        const cv::Point2f there(static_cast<float>(there_px.x()), static_cast<float>(there_px.y()));
        if (!(there.x >= 0 && there.x <= size.width - 1 && there.y >= 0 && there.y <= size.height - 1)) continue;
        shown.emplace_back(static_cast<float>(x), static_cast<float>(y));
        moved.push_back(there);
      }
    }
    const std::array<ResidualField, 3> residuals = {ResidualField{}, by_images,
                                                    true_residuals(footage, i, rotation, estimator.grid())};
    for (std::size_t k = 0; k < shown.size(); ++k) errors[0].push_back(cv::norm(moved[k] - shown[k]));
    for (std::size_t m = 0; m < residuals.size(); ++m) {
      FrameBlur field = estimator.estimate(rotation, exposure, residuals[m]);
      // Where the scene is, not where deblurring shows it: that is measured by itself.
      for (BlockBlur& block : field.blocks) block.chord_middle_px = block.mean_place_px = Eigen::Vector2f::Zero();
      const std::vector<cv::Vec2f> found =
          looked_up(global_shutter_map(field, camera, rotation, exposure, reference_ns), moved);
      for (std::size_t k = 0; k < shown.size(); ++k) {
        errors[m + 1].push_back(cv::norm(cv::Point2f(found[k]) - shown[k]));
      }
    }
  }
  return errors;
}

}  // namespace gyro_deblur::experiments
