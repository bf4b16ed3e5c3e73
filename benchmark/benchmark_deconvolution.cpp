// Deconvolution of a roll field: engines x sizes x extents x threads; of curved paths by 2-D filters; with helpers that
// wake for the frame, and that spin.

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <benchmark/benchmark.h>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "base/stopwatch.hpp"
#include "engine/engine.hpp"
#include "engines.hpp"
#include "filter_grids.hpp"
#include "inverse/filter_bank.hpp"
#include "paths_2d.hpp"
#include "pipeline/deconvolution.hpp"
#include "roll_scene.hpp"
#include "scene.hpp"

namespace gyro_deblur::benchmark {
namespace {

void deconvolution(::benchmark::State& state, const std::string& engine_name, cv::Size size, double extent_px,
                   int threads) {
  static const FilterBank bank(FilterOptions{});
  static const cv::Mat photograph = natural_images().front();
  const cv::Mat image = extend(photograph, size);
  const FrameBlur field =
      test::Roll::about_center(size.width, size.height, extent_px).field(size.width, size.height, wide_options());
  const auto engine = make_engine(engine_name, threads);
  cv::setNumThreads(threads);
  cv::Mat dst;
  deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst);  // allocates
  for (auto _ : state) {
    deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst);
    ::benchmark::DoNotOptimize(dst.data);
  }
  state.counters["Mpixel/s"] =
      ::benchmark::Counter(1e-6 * size.area(), ::benchmark::Counter::kIsIterationInvariantRate);
}

/// All blocks of 64 px with the inverse of an arc along the rows, or along a diagonal, which needs larger tiles.
void fourier(::benchmark::State& state, cv::Size size, double extent_px, bool is_diagonal, int threads) {
  const cv::Mat image = extend(natural_images().front(), size);
  const WienerInverse2d inverse{test::arc_path(extent_px, 0.2 * extent_px, is_diagonal ? CV_PI / 4 : 0), 0.007f, 0.1f};
  const FilterGrid grid = test::make_grid(size, 64, [&](int) { return BlockFilter{0, nullptr, &inverse}; });
  const auto engine = make_engine("auto", threads);
  cv::Mat dst;
  engine->filter(image, grid, dst);  // allocates
  for (auto _ : state) {
    engine->filter(image, grid, dst);
    ::benchmark::DoNotOptimize(dst.data);
  }
}

/// What it costs that helpers sleep between frames: frames 5 ms apart, in turns with a helper that wakes for the frame
/// and with one that has had loops all the time. The calling thread spins in either case.
void helpers(::benchmark::State& state, cv::Size size, double extent_px) {
  constexpr int kThreads = 2;
  constexpr double kApartMs = 5;
  static const FilterBank bank(FilterOptions{});
  const cv::Mat image = extend(natural_images().front(), size);
  const FrameBlur field =
      test::Roll::about_center(size.width, size.height, extent_px).field(size.width, size.height, wide_options());
  const auto engine = make_engine("auto", kThreads);
  cv::Mat dst;
  deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst);  // allocates
  std::vector<double> spinning_ms, waking_ms;
  for (auto _ : state) {
    for (const bool spins : {true, false}) {
      std::optional<AwakeHelpers> awake;
      if (spins) awake.emplace(kThreads);
      for (const Stopwatch pause; pause.ms() < kApartMs;) {
        if (spins) parallel_for(kThreads, kThreads, 1, [](int) {});
      }
      const Stopwatch watch;
      if (!spins) awake.emplace(kThreads);
      deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst);
      ::benchmark::DoNotOptimize(dst.data);
      (spins ? spinning_ms : waking_ms).push_back(watch.ms());
    }
    state.SetIterationTime(1e-3 * waking_ms.back());
  }
  state.counters["spinning_ms"] = median(spinning_ms);
  state.counters["waking_ms"] = median(waking_ms);
  state.counters["ratio"] = median(waking_ms) / median(spinning_ms);
}

const bool registered = [] {
  for (const auto& [size, extent_px] : {std::pair(cv::Size(752, 480), 5), std::pair(cv::Size(752, 480), 90),
                                        std::pair(cv::Size(1920, 1080), 5), std::pair(cv::Size(1920, 1080), 90)}) {
    const std::string name = "helpers/" + std::to_string(size.width) + "x" + std::to_string(size.height) + "/" +
                             std::to_string(extent_px) + "px";
    ::benchmark::RegisterBenchmark(name.c_str(), helpers, size, extent_px)
        ->Unit(::benchmark::kMillisecond)
        ->UseManualTime()
        ->Iterations(200);
  }
  for (const auto& [size, extent_px] : {std::pair(cv::Size(752, 480), 25), std::pair(cv::Size(1920, 1080), 60)}) {
    for (const bool is_diagonal : {false, true}) {
      for (const int threads : {1, 2}) {
        const std::string name = "fourier/" + std::to_string(size.width) + "x" + std::to_string(size.height) + "/" +
                                 std::to_string(extent_px) + "px/" + (is_diagonal ? "diagonal/" : "rows/") +
                                 std::to_string(threads) + "threads";
        ::benchmark::RegisterBenchmark(name.c_str(), fourier, size, extent_px, is_diagonal, threads)
            ->Unit(::benchmark::kMillisecond)
            ->UseRealTime();
      }
    }
  }
  for (const std::string& engine : available_engines()) {
    for (const cv::Size size : {cv::Size(752, 480), cv::Size(1280, 720), cv::Size(1920, 1080)}) {
      for (const int extent_px : {5, 15, 30, 60, 90, 130}) {
        for (const int threads : {1, 2}) {
          const std::string name = "deconvolution/" + engine + "/" + std::to_string(size.width) + "x" +
                                   std::to_string(size.height) + "/" + std::to_string(extent_px) + "px/" +
                                   std::to_string(threads) + "threads";
          auto* entry = ::benchmark::RegisterBenchmark(name.c_str(), deconvolution, engine, size, extent_px, threads);
          entry->Unit(::benchmark::kMillisecond)->UseRealTime();
          if (engine.compare(0, 8, "filter2d") == 0) entry->Iterations(1);
        }
      }
    }
  }
  return true;
}();

}  // namespace
}  // namespace gyro_deblur::benchmark
