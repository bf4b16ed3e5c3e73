#include "pipeline_scene.hpp"

#include <cstdint>

#include <opencv2/imgproc.hpp>

#include "analytic_motion.hpp"
#include "gyro_deblur/exposure.hpp"
#include "roll_scene.hpp"
#include "scene.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::benchmark {

namespace {

constexpr TimeNs kExposureNs = 10'000'000, kStampNs = 1'000'000'000;

}  // namespace

PipelineScene make_pipeline_scene(cv::Size size, double mean_extent_px) {
  constexpr TimeNs kGyroPeriodNs = 5'000'000;
  const test::Roll roll = test::Roll::about_center(size.width, size.height, mean_extent_px);

  PipelineScene scene;
  scene.frame = test::expose(roll.blur(extend(natural_images().front(), size)), 1, 1);
  // cam0 of EuRoC, scaled to the image.
  const double scale = size.width / 752.0;
  scene.calibration.width_px = size.width;
  scene.calibration.height_px = size.height;
  scene.calibration.fx_px = 458.654 * scale;
  scene.calibration.fy_px = 457.296 * scale;
  scene.calibration.cx_px = roll.pivot_px.x;
  scene.calibration.cy_px = roll.pivot_px.y;
  scene.calibration.model = "plumb_bob";
  scene.calibration.coefficients = {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05};

  // A scene that rotates by an angle in the image is a camera that rotates by its negative.
  const auto motion = test::AnalyticMotion::constant_rate({0, 0, -roll.rotation_rad / to_seconds(kExposureNs)});
  scene.motion =
      std::make_unique<RotationTrack>(motion.sample({kStampNs - 100'000'000, kStampNs + 100'000'000}, kGyroPeriodNs),
                                      GyroOptions{}, Eigen::Matrix3d::Identity());
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;
  scene.exposure = std::make_unique<RowExposure>(kStampNs, size.height, timing);
  return scene;
}

RowExposure PipelineSequence::exposure(std::size_t frame) const {
  return RowExposure(kStampNs + static_cast<TimeNs>(frame) * kFramePeriodNs, scene.frame.rows,
                     scene.exposure->timing());
}

PipelineSequence make_pipeline_sequence(cv::Size size, double mean_extent_px, int frames) {
  PipelineSequence sequence{make_pipeline_scene(size, mean_extent_px), {}};
  const test::Roll roll = test::Roll::about_center(size.width, size.height, mean_extent_px);
  const cv::Mat sharp = extend(natural_images().front(), size);
  for (int i = 0; i < frames; ++i) {
    const double rotation_rad = -roll.rotation_rad * i * to_seconds(kFramePeriodNs) / to_seconds(kExposureNs);
    const cv::Mat map = cv::getRotationMatrix2D(cv::Point2f(roll.pivot_px), rotation_rad * 180 / CV_PI, 1);
    cv::Mat rotated;
    cv::warpAffine(sharp, rotated, map, size, cv::INTER_CUBIC, cv::BORDER_REFLECT_101);
    sequence.frames.push_back(test::expose(roll.blur(rotated), 1, static_cast<std::uint64_t>(i) + 1));
  }
  return sequence;
}

PipelineOptions pipeline_options(int threads) {
  PipelineOptions options;
  options.blur_field.max_extent_px = wide_options().max_extent_px;
  options.keypoints.detector = "ORB";
  options.keypoints.descriptor = "ORB";
  options.optical_flow = false;  // one frame, again and again: it is measured by itself
  options.threads = threads;
  return options;
}

}  // namespace gyro_deblur::benchmark
