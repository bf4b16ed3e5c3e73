#include "shutter_errors.hpp"

#include "features/image_rectification.hpp"
#include "features/residual_flow.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/pipeline.hpp"

namespace gyro_deblur::experiments {
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
    std::vector<Eigen::Vector2d> shown_px, moved_px;  // at its row's time, and at the reference time
    for (int y = kStepPx / 2; y < size.height; y += kStepPx) {
      for (int x = kStepPx / 2; x < size.width; x += kStepPx) {
        const Eigen::Vector2d there_px = footage.truth().truth_rectified(i, Eigen::Vector2d(x, y), reference_ns);
        if (!(there_px.x() >= 0 && there_px.x() <= size.width - 1 && there_px.y() >= 0 &&
              there_px.y() <= size.height - 1)) {
          continue;
        }
        shown_px.emplace_back(x, y);
        moved_px.push_back(there_px);
      }
    }
    const std::array<ResidualField, 3> residuals = {ResidualField{}, by_images,
                                                    true_residuals(footage, i, rotation, estimator.grid())};
    for (std::size_t k = 0; k < shown_px.size(); ++k) errors[0].push_back((moved_px[k] - shown_px[k]).norm());
    for (std::size_t m = 0; m < residuals.size(); ++m) {
      FrameBlur field = estimator.estimate(rotation, exposure, residuals[m]);
      // Where the scene is, not where deblurring shows it: that is measured by itself.
      for (BlockBlur& block : field.blocks) block.chord_middle_px = block.mean_place_px = Eigen::Vector2f::Zero();
      const GlobalShutterMap map = global_shutter_map(field, camera, rotation, exposure, reference_ns);
      for (std::size_t k = 0; k < shown_px.size(); ++k) {
        errors[m + 1].push_back((map.at(moved_px[k]) - shown_px[k]).norm());
      }
    }
  }
  return errors;
}

CurvedFrame most_curved_frame(const Footage& footage) {
  const RotationTrack rotation = footage.rotation();
  Pipeline pipeline{PipelineOptions{}};
  pipeline.set_calibration(footage.camera().calibration());
  PipelineRequest request;
  request.keypoints = false;
  request.global_shutter = true;
  const double right_px = footage.camera().calibration().width_px - 1,
               bottom_px = footage.camera().calibration().height_px - 1;
  double largest_px = -1;
  CurvedFrame curved;
  for (int i = 0; i < footage.frames(); ++i) {
    const cv::Mat image = footage.image(i, kDaylight);
    const PipelineResult result = pipeline.process(image, PixelLayout::GRAY, rotation, footage.exposure(i), request);
    const auto moved_px = [&](double x, double y) -> Eigen::Vector2d {
      const Eigen::Vector2d shown_px(x, y);
      return footage.truth().truth_rectified(i, shown_px, footage.truth().reference_time(i)) - shown_px;
    };
    const double sheared_px = (moved_px(0.5 * right_px, 0) - moved_px(0.5 * right_px, bottom_px)).norm();
    if (!(sheared_px > largest_px)) continue;
    largest_px = sheared_px;
    curved = {image, result.global_shutter.empty() ? image : result.global_shutter};
  }
  return curved;
}

}  // namespace gyro_deblur::experiments
