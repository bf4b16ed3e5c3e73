// A camera that rolls before a photograph: everything that the whole pipeline takes.
#pragma once

#include <memory>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/pipeline.hpp"

namespace gyro_deblur::benchmark {

/// A frame of a global shutter with EuRoC's lens distortion, 10 ms exposure and a gyroscope of 200 Hz.
struct PipelineScene {
  cv::Mat frame;  ///< CV_8UC1, blurred, 1 grey level of noise
  CameraCalibration calibration;
  std::unique_ptr<RotationTrack> motion;
  std::unique_ptr<RowExposure> exposure;
};

PipelineScene make_pipeline_scene(cv::Size size, double mean_extent_px);

/// The same, and what it sees kFramePeriodNs later each time.
struct PipelineSequence {
  PipelineScene scene;
  std::vector<cv::Mat> frames;
  RowExposure exposure(std::size_t frame) const;
};

/// As fast as an exposure of half the period allows.
constexpr TimeNs kFramePeriodNs = 20'000'000;

/// @param frames  [1, 5]: the scene's motion is known for so long
PipelineSequence make_pipeline_sequence(cv::Size size, double mean_extent_px, int frames);

/// Options of the scene's pipeline: defaults, but blur of any extent is deblurred, without motion from images, and ORB
/// with 1000 features.
PipelineOptions pipeline_options(int threads);

}  // namespace gyro_deblur::benchmark
