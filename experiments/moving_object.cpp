#include "moving_object.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "displacement_errors.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "sim/texture.hpp"

namespace gyro_deblur::experiments {
namespace {

const cv::Size kObject(260, 200);

/// The object's light and its share of each pixel while its corner goes from `from` to `to`, even in time.
struct Layer {
  cv::Mat light, share;  // CV_32F
};

Layer moved_object(const cv::Mat& object, const cv::Size& size, const cv::Point2d& from, const cv::Point2d& to) {
  const int steps = std::max(1, static_cast<int>(std::ceil(2 * cv::norm(to - from))));
  Layer layer{cv::Mat::zeros(size, CV_32F), cv::Mat::zeros(size, CV_32F)};
  const cv::Mat all = cv::Mat::ones(object.size(), CV_32F);
  for (int k = 0; k < steps; ++k) {
    const cv::Point2d at = from + (k + 0.5) / steps * (to - from);
    const cv::Matx23d move(1, 0, at.x, 0, 1, at.y);
    for (const auto& [image, sum] : {std::pair(&object, &layer.light), std::pair(&all, &layer.share)}) {
      cv::Mat placed;
      cv::warpAffine(*image, placed, move, size, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar(0));
      *sum += placed / steps;
    }
  }
  return layer;
}

/// Where the corner of the object is: in the middle of the image halfway through.
struct Course {
  cv::Point2d start, velocity_px_s;
  double period_s;
  int frames;

  cv::Point2d at(double t_s) const { return start + (t_s - 0.5 * frames * period_s) * velocity_px_s; }
};

void count(const BlockBlur& blur, const Eigen::Vector2d& displacement_px, const Eigen::Vector2d& truth_px,
           BlockCounts* counts) {
  constexpr double kWrongPx = 3;
  const double error_px = (displacement_px - truth_px).norm();
  const bool is_blurred = truth_px.norm() >= BlurFieldOptions{}.min_extent_px;
  ++counts->blocks;
  counts->errors_px.push_back(error_px);
  if (is_blurred) ++counts->blurred;
  if (blur.status == BlockStatus::DEBLURRED && error_px >= kWrongPx) ++counts->wrong;
  if (blur.status != BlockStatus::DEBLURRED && is_blurred) ++counts->left;
}

/// @param all_of_it  of the exposure: where nothing but the object is seen
/// @param any_of_it  where anything of it is seen
void evaluate(const FrameBlur& field, const Footage& footage, int i, const RotationTrack& rotation,
              const cv::Rect2d& all_of_it, const cv::Rect2d& any_of_it, const Eigen::Vector2d& path_px,
              ObjectResult* result) {
  const RowExposure exposure = footage.exposure(i);
  for (int b = 0; b < field.grid.size(); ++b) {
    const cv::Rect2d block(field.grid.rect(b));
    const Eigen::Vector2d center_px = field.grid.center(b);
    Eigen::Vector2d displacement = displacement_px(footage.camera(), rotation, exposure, center_px);
    const BlockBlur& blur = field.blocks[b];
    if (blur.residual) displacement += to_seconds(exposure.timing().exposure_ns) * blur.residual->velocity_px_s;
    if ((block & all_of_it).area() >= block.area()) {
      count(blur, displacement, path_px, &result->object);
    } else if ((block & any_of_it).area() == 0) {
      count(blur, displacement, footage.truth().truth_displacement(i, center_px), &result->surroundings);
    }
  }
}

}  // namespace

ObjectScene film_object(const Footage& footage, const cv::Point2d& velocity_px_s) {
  constexpr int kFirst = 2;
  const cv::Size size(footage.camera().calibration().width_px, footage.camera().calibration().height_px);
  cv::Mat object;
  cv::cvtColor(sim::procedural_texture(kObject.width, kObject.height, 77), object, cv::COLOR_BGR2GRAY);
  object.convertTo(object, CV_32F);
  const double period_s = to_seconds(footage.exposure(1).start(0) - footage.exposure(0).start(0));
  const Course course{cv::Point2d(0.5 * (size.width - kObject.width), 0.5 * (size.height - kObject.height)),
                      velocity_px_s, period_s, footage.frames()};
  const RotationTrack rotation = footage.rotation();
  PipelineOptions with, without;
  without.optical_flow = false;
  Pipeline images(with), alone(without);
  PipelineRequest request;
  request.keypoints = false;
  ObjectScene scene;
  for (Pipeline* pipeline : {&images, &alone}) pipeline->set_calibration(footage.camera().calibration());
  for (int i = 0; i < footage.frames(); ++i) {
    const RowExposure exposure = footage.exposure(i);
    const double exposure_s = to_seconds(exposure.timing().exposure_ns);
    const cv::Point2d middle = course.at(i * period_s), path = exposure_s * velocity_px_s;
    const Layer layer = moved_object(object, size, middle - 0.5 * path, middle + 0.5 * path);
    cv::Mat image;
    footage.image(i, kDaylight).convertTo(image, CV_32F);
    image = image.mul(1 - layer.share) + layer.light;
    image.convertTo(image, CV_8U);
    const bool is_middle = i == footage.frames() / 2;
    if (is_middle) scene.blurred = image;
    const cv::Size2d half_path(0.5 * std::abs(path.x), 0.5 * std::abs(path.y));
    const cv::Rect2d all_of_it(middle.x + half_path.width, middle.y + half_path.height,
                               kObject.width - 2 * half_path.width, kObject.height - 2 * half_path.height);
    const cv::Rect2d any_of_it(middle.x - half_path.width, middle.y - half_path.height,
                               kObject.width + 2 * half_path.width, kObject.height + 2 * half_path.height);
    for (auto [pipeline, counts] : {std::pair(&images, &scene.images), std::pair(&alone, &scene.alone)}) {
      const PipelineResult result = pipeline->process(image, PixelLayout::GRAY, rotation, exposure, request);
      if (is_middle) counts->shown = result.image.empty() ? image : result.image;
      if (i >= kFirst) evaluate(result.field, footage, i, rotation, all_of_it, any_of_it, {path.x, path.y}, counts);
    }
  }
  return scene;
}

}  // namespace gyro_deblur::experiments
