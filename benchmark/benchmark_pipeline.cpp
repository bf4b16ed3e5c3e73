// Stages of the pipeline, and cv::ORB on the same frame for comparison. Arguments: width, height, mean extent, threads.

#include <benchmark/benchmark.h>
#include <opencv2/features2d.hpp>

#include "gyro_deblur/blur_validation.hpp"
#include "pipeline_scene.hpp"

namespace gyro_deblur::benchmark {
namespace {

PipelineScene scene_of(const ::benchmark::State& state) {
  cv::setNumThreads(static_cast<int>(state.range(3)));
  return make_pipeline_scene({static_cast<int>(state.range(0)), static_cast<int>(state.range(1))},
                             static_cast<double>(state.range(2)));
}

void blur_field(::benchmark::State& state) {
  const PipelineScene scene = scene_of(state);
  const BlurFieldEstimator estimator(Camera(scene.calibration), pipeline_options(1).blur_field);
  for (auto _ : state) ::benchmark::DoNotOptimize(estimator.estimate(*scene.motion, *scene.exposure));
}

void validation(::benchmark::State& state) {
  const PipelineScene scene = scene_of(state);
  const PipelineOptions options = pipeline_options(1);
  const FrameBlur field =
      BlurFieldEstimator(Camera(scene.calibration), options.blur_field).estimate(*scene.motion, *scene.exposure);
  for (auto _ : state) ::benchmark::DoNotOptimize(validate_blur_field(field, scene.frame, options.validation));
}

void whole_frame(::benchmark::State& state, PipelineRequest request) {
  const PipelineScene scene = scene_of(state);
  Pipeline pipeline(pipeline_options(static_cast<int>(state.range(3))));
  pipeline.set_calibration(scene.calibration);
  for (auto _ : state) {
    ::benchmark::DoNotOptimize(
        pipeline.process(scene.frame, PixelLayout::GRAY, *scene.motion, *scene.exposure, request));
  }
}

void orb_1000(::benchmark::State& state) {
  const PipelineScene scene = scene_of(state);
  const cv::Ptr<cv::ORB> orb = cv::ORB::create(1000);
  for (auto _ : state) {
    std::vector<cv::KeyPoint> keypoints;
    cv::Mat descriptors;
    orb->detectAndCompute(scene.frame, cv::noArray(), keypoints, descriptors);
    ::benchmark::DoNotOptimize(descriptors.data);
  }
}

void scenes(::benchmark::internal::Benchmark* entry) {
  for (const int threads : {1, 2}) {
    entry->Args({752, 480, 15, threads})->Args({1280, 720, 30, threads})->Args({1920, 1080, 90, threads});
  }
  entry->Unit(::benchmark::kMillisecond)->UseRealTime();
}

BENCHMARK(blur_field)->Apply(scenes);
BENCHMARK(validation)->Apply(scenes);
BENCHMARK_CAPTURE(whole_frame, image, PipelineRequest{true, false})->Apply(scenes);
BENCHMARK_CAPTURE(whole_frame, image_and_orb, PipelineRequest{true, true})->Apply(scenes);
BENCHMARK(orb_1000)->Apply(scenes);

}  // namespace
}  // namespace gyro_deblur::benchmark
