// Stages of the pipeline, and cv::ORB on the same frame for comparison. Arguments: width, height, mean extent, threads.

#include <algorithm>

#include <benchmark/benchmark.h>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"
#include "blur/blur_validation.hpp"
#include "features/image_rectification.hpp"
#include "features/residual_flow.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "pipeline_scene.hpp"

namespace gyro_deblur::benchmark {
namespace {

PipelineScene scene_of(const ::benchmark::State& state) {
  cv::setNumThreads(static_cast<int>(state.range(3)));
  return make_pipeline_scene({static_cast<int>(state.range(0)), static_cast<int>(state.range(1))},
                             static_cast<double>(state.range(2)));
}

/// Two samples say that the camera stands still.
GyroOptions standing_gyro() {
  GyroOptions options;
  options.max_gap_ns = 1'000'000'000;
  return options;
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
  const int threads = static_cast<int>(state.range(3));
  for (auto _ : state) {
    const AwakeHelpers helpers(threads);
    ::benchmark::DoNotOptimize(validate_blur_field(field, scene.frame, options.validation, threads));
  }
}

/// Of a camera that stands still before a scene that moves: every corner has an image to be found in.
void optical_flow(::benchmark::State& state) {
  constexpr TimeNs kPeriodNs = 50'000'000;
  const PipelineScene scene = scene_of(state);
  const Camera camera(scene.calibration);
  const BlockGrid grid(scene.frame.cols, scene.frame.rows, BlurFieldOptions().block_size_px);
  cv::Mat moved;
  cv::warpAffine(scene.frame, moved, cv::Matx23d(1, 0, 6, 0, 1, -4), scene.frame.size(), cv::INTER_NEAREST,
                 cv::BORDER_REPLICATE);
  const TimeNs first_ns = scene.exposure->frame().begin_ns;
  const RotationTrack motion(
      {{first_ns - kPeriodNs, Eigen::Vector3d::Zero()}, {first_ns + 2 * kPeriodNs, Eigen::Vector3d::Zero()}},
      standing_gyro(), Eigen::Matrix3d::Identity());
  const RowExposure first(first_ns, scene.frame.rows, scene.exposure->timing());
  const RowExposure second(first_ns + kPeriodNs, scene.frame.rows, scene.exposure->timing());
  ResidualFlow flow;
  for (auto _ : state) {
    state.PauseTiming();
    flow.reset();
    flow.follow(scene.frame, camera, motion, first, grid, static_cast<int>(state.range(3)));
    state.ResumeTiming();
    const AwakeHelpers helpers(static_cast<int>(state.range(3)));
    ::benchmark::DoNotOptimize(flow.follow(moved, camera, motion, second, grid, static_cast<int>(state.range(3))));
  }
  state.counters["corners"] = static_cast<double>(flow.samples().size());
}

/// What an image adds to the processing where feature_tracks are wanted.
/// @param knows_residuals  whether the blur field has residual velocities, as optical flow gives them
void feature_tracks(::benchmark::State& state, bool knows_residuals) {
  constexpr int kFrames = 5;
  cv::setNumThreads(static_cast<int>(state.range(3)));
  const PipelineSequence sequence =
      make_pipeline_sequence({static_cast<int>(state.range(0)), static_cast<int>(state.range(1))},
                             static_cast<double>(state.range(2)), kFrames);
  const Camera camera(sequence.scene.calibration);
  FrameBlur field =
      BlurFieldEstimator(camera, pipeline_options(1).blur_field).estimate(*sequence.scene.motion, sequence.exposure(0));
  field.noise = 1;
  if (knows_residuals) {
    for (BlockBlur& block : field.blocks) block.residual.emplace();
  }
  FeatureTracker tracker{TrackerOptions{}};
  tracker.set_threads(static_cast<int>(state.range(3)));
  std::size_t frame = 0;
  double corners = 0, followed = 0;
  const auto track = [&]() -> const std::vector<Track>& {
    return tracker.track(sequence.frames[frame], camera, *sequence.scene.motion, sequence.exposure(frame), &field);
  };
  for (auto _ : state) {
    if (frame == 0 || ++frame == sequence.frames.size()) {
      state.PauseTiming();
      frame = 0;
      tracker.reset();
      track();
      frame = 1;
      state.ResumeTiming();
    }
    const std::vector<Track>& tracks = track();
    corners += static_cast<double>(tracks.size());
    followed += static_cast<double>(
        std::count_if(tracks.begin(), tracks.end(), [](const Track& each) { return each.length > 1; }));
  }
  state.counters["corners"] = corners / static_cast<double>(state.iterations());
  state.counters["followed"] = followed / static_cast<double>(state.iterations());
}

void global_shutter(::benchmark::State& state) {
  const PipelineScene scene = scene_of(state);
  const Camera camera(scene.calibration);
  ShutterTiming timing = scene.exposure->timing();
  timing.readout_ns = 20'000'000;
  const RowExposure exposure(scene.exposure->frame().begin_ns, scene.frame.rows, timing);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  const FrameBlur field = BlurFieldEstimator(camera, pipeline_options(1).blur_field).estimate(*scene.motion, exposure);
  const int threads = static_cast<int>(state.range(3));
  for (auto _ : state) {
    const GlobalShutterMap map = global_shutter_map(field, camera, *scene.motion, exposure, reference_ns, threads);
    ::benchmark::DoNotOptimize(to_global_shutter(scene.frame, map, threads));
  }
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
BENCHMARK(optical_flow)->Apply(scenes);
BENCHMARK(validation)->Apply(scenes);
BENCHMARK_CAPTURE(feature_tracks, by_residuals, true)->Apply(scenes);
BENCHMARK_CAPTURE(feature_tracks, by_rotation, false)->Apply(scenes);
BENCHMARK(global_shutter)->Apply(scenes);
BENCHMARK_CAPTURE(whole_frame, image, PipelineRequest{true, false})->Apply(scenes);
BENCHMARK_CAPTURE(whole_frame, image_and_orb, PipelineRequest{true, true})->Apply(scenes);
BENCHMARK(orb_1000)->Apply(scenes);

}  // namespace
}  // namespace gyro_deblur::benchmark
