// A camera that pans over a synthetic image, deblurred with the core's public headers alone.
#pragma once

#include <gyro_deblur/camera.hpp>
#include <gyro_deblur/exposure.hpp>
#include <gyro_deblur/frame_blur.hpp>
#include <gyro_deblur/gyro_buffer.hpp>
#include <gyro_deblur/pipeline.hpp>
#include <gyro_deblur/rotation_track.hpp>

#include <cmath>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

struct SyntheticPan {
  cv::Mat sharp, blurred;
  gyro_deblur::PipelineResult result;

  /// Root mean square difference from the sharp image, away from the border.
  double error_of(const cv::Mat& image) const {
    const cv::Rect inner(30, 30, sharp.cols - 60, sharp.rows - 60);
    return cv::norm(image(inner), sharp(inner), cv::NORM_L2) / std::sqrt(inner.area());
  }
  /// Deblurring takes away two fifths of the error; anything like that will do.
  bool is_deblurred() const {
    return result.image.size() == sharp.size() && error_of(result.image) < 0.75 * error_of(blurred);
  }
};

inline SyntheticPan deblur_synthetic_pan() {
  using namespace gyro_deblur;
  constexpr int kWidth = 320, kHeight = 240, kExtentPx = 15;
  constexpr double kFocalPx = 300;
  constexpr TimeNs kExposureNs = 20'000'000, kStampNs = 1'000'000'000;

  SyntheticPan pan;
  pan.sharp.create(kHeight, kWidth, CV_8UC1);
  cv::RNG rng(5);
  rng.fill(pan.sharp, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(pan.sharp, pan.sharp, {}, 1.5);
  cv::normalize(pan.sharp, pan.sharp, 30, 220, cv::NORM_MINMAX);
  cv::blur(pan.sharp, pan.blurred, {kExtentPx, 1});

  CameraCalibration camera;
  camera.width_px = kWidth;
  camera.height_px = kHeight;
  camera.fx_px = camera.fy_px = kFocalPx;
  camera.cx_px = (kWidth - 1) / 2.0;
  camera.cy_px = (kHeight - 1) / 2.0;
  const double rate_rad_s = 2 * std::atan(kExtentPx / (2 * kFocalPx)) / to_seconds(kExposureNs);
  std::vector<GyroSample> samples;
  for (TimeNs t_ns = 0; t_ns <= 2 * kStampNs; t_ns += 5'000'000) samples.push_back({t_ns, {0, rate_rad_s, 0}});
  const RotationTrack track(samples, {}, Eigen::Matrix3d::Identity());
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;

  Pipeline pipeline({});
  pipeline.set_calibration(camera);
  pan.result = pipeline.process(pan.blurred, PixelLayout::GRAY, track, RowExposure(kStampNs, kHeight, timing),
                                PipelineRequest{});
  return pan;
}
