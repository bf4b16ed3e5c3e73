// Ratios between engines. Engines take turns in one process (A B C A B C ...), so that a machine whose speed drifts
// slows all of them by the same share; a ratio is the median over rounds of the ratio within a round.

#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/features2d.hpp>

#include "base/median.hpp"
#include "engine/cpu/block_simd.hpp"
#include "engine/engine.hpp"
#include "engines.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "inverse/filter_bank.hpp"
#include "machine_peaks.hpp"
#include "pipeline/deconvolution.hpp"
#include "pipeline_scene.hpp"
#include "roll_scene.hpp"
#include "scene.hpp"
#include "synthetic_blur.hpp"
#include "tools/output_file.hpp"
#include "tools/tool_main.hpp"
#include "work.hpp"

namespace gyro_deblur::benchmark {
namespace {

// cv::filter2D takes a hundred times as long as the rest: a few rounds of it are enough.
constexpr int kFilter2dRounds = 3;

struct Arguments {
  std::vector<std::string> engines;
  std::vector<std::string> sizes = {"752x480", "1280x720", "1920x1080"};
  std::vector<double> extents_px = {5, 15, 30, 60, 90, 130};
  std::vector<int> threads = {1, 2};
  int rounds = 21;
  std::vector<std::string> pipeline_engines = {"auto"};
  bool no_peaks = false, no_memory = false, no_pipeline = false;
  bool processor_time = false;
  std::string json;
};

/// OpenMP's threads spin for some milliseconds after their work, which would count against the engine whose turn is
/// next, most of all against OpenCL on the processor, which has threads of its own.
void let_threads_rest() { std::this_thread::sleep_for(std::chrono::milliseconds(10)); }

/// Time [ms] on the clock of the wall, or of the processors while they run this process.
double ms_of(bool processor_time, const std::function<void()>& work) {
  const auto now_ms = [processor_time] {
    timespec time{};
    clock_gettime(processor_time ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &time);
    return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
  };
  const double start_ms = now_ms();
  work();
  return now_ms() - start_ms;
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(std::lround(q * static_cast<double>(values.size() - 1)))];
}

/// Median over the rounds that both took part in.
double median_ratio(const std::vector<double>& numerator, const std::vector<double>& denominator) {
  std::vector<double> ratios;
  for (std::size_t i = 0; i < std::min(numerator.size(), denominator.size()); ++i) {
    ratios.push_back(numerator[i] / denominator[i]);
  }
  return median(ratios);
}

cv::Size parse_size(const std::string& text) {
  int width = 0, height = 0;
  if (std::sscanf(text.c_str(), "%dx%d", &width, &height) != 2 || width < 1 || height < 1) {
    throw std::runtime_error("--sizes: \"" + text + "\" is not WIDTHxHEIGHT");
  }
  return {width, height};
}

/// The float engine compiled for the same instruction set.
std::string baseline_of(const std::string& engine) {
  if (engine == "cpu-avx512") return "float-avx512";
  if (engine == "cpu-avx2") return "float-avx2";
  return "float";
}

nlohmann::json measure_deconvolution(const Arguments& arguments, const FilterBank& bank) {
  nlohmann::json records;
  for (const std::string& size_text : arguments.sizes) {
    const cv::Size size = parse_size(size_text);
    const cv::Mat image = extend(natural_images().front(), size);
    for (const int threads : arguments.threads) {
      cv::setNumThreads(threads);
      std::printf("\n%s, %d thread%s: median ms of cpu engines and what they are compared with\n%9s", size_text.c_str(),
                  threads, threads > 1 ? "s" : "", "extent");
      for (const std::string& name : arguments.engines) std::printf(" %16s", name.c_str());
      std::printf("\n");
      for (const double extent_px : arguments.extents_px) {
        const FrameBlur field =
            test::Roll::about_center(size.width, size.height, extent_px).field(size.width, size.height, wide_options());
        const FilterGrid grid = make_filter_grid(field, bank);
        std::vector<std::unique_ptr<Engine>> engines;
        for (const std::string& name : arguments.engines) engines.push_back(make_engine(name, threads));
        std::map<std::string, std::vector<double>> times_ms;
        cv::Mat dst;
        // The first round allocates and is not counted.
        for (int round = -1; round < arguments.rounds; ++round) {
          for (std::size_t e = 0; e < engines.size(); ++e) {
            const std::string& name = arguments.engines[e];
            if (name.compare(0, 8, "filter2d") == 0 && (round < 0 || round >= kFilter2dRounds)) continue;
            let_threads_rest();
            const auto work = [&] { deconvolve(image, PixelLayout::GRAY, field, bank, *engines[e], dst); };
            work();  // threads awake and caches as after its own last frame, not as after another engine's
            const double ms = ms_of(arguments.processor_time, work);
            if (round >= 0) times_ms[name].push_back(ms);
          }
        }
        std::printf("%6.0f px", extent_px);
        for (const std::string& name : arguments.engines) {
          const std::vector<double>& ms = times_ms[name];
          nlohmann::json record = {{"width", size.width},
                                   {"height", size.height},
                                   {"threads", threads},
                                   {"extent_px", extent_px},
                                   {"engine", name},
                                   {"median_ms", median(ms)},
                                   {"min_ms", quantile(ms, 0)},
                                   {"p90_ms", quantile(ms, 0.9)}};
          for (const std::string& other :
               {baseline_of(name), std::string("float"), std::string("filter2d"), std::string("filter2d-float")}) {
            if (times_ms.count(other) != 0) record["speedup_over"][other] = median_ratio(times_ms[other], ms);
          }
          const bool is_float = name.compare(0, 5, "float") == 0;
          if (is_float || name.compare(0, 4, "cpu-") == 0) {
            const BlockSimd* kernels = is_float ? nullptr : find_for_cpu<BlockSimd>(name.c_str() + 4);
            const Work work = is_float ? work_of_float(grid) : work_of_cpu(grid, kernels->lanes);
            record["work"] = {{"float_gmac", work.float_macs / 1e9},
                              {"int16_gmac", work.int16_macs / 1e9},
                              {"load_gb", work.load_bytes / 1e9}};
          }
          std::printf(" %16.2f", median(ms));
          records.push_back(record);
        }
        std::printf("   speed-up");
        for (const std::string& name : arguments.engines) {
          const std::string base = baseline_of(name);
          if (base == name || name.compare(0, 5, "float") == 0 || name.compare(0, 8, "filter2d") == 0) continue;
          if (times_ms.count(base) == 0) continue;
          std::printf("  %s %.1f", name.c_str(), median_ratio(times_ms[base], times_ms[name]));
          if (times_ms.count("filter2d") != 0 && times_ms.count("filter2d-float") != 0) {
            std::printf(" (filter2D %.0f, %.0f)", median_ratio(times_ms["filter2d"], times_ms[name]),
                        median_ratio(times_ms["filter2d-float"], times_ms[name]));
          }
        }
        std::printf("\n");
        std::fflush(stdout);
      }
    }
  }
  return records;
}

/// Stages of everything that deblurs by default, of images that follow one another, and of feature_tracks besides.
struct PipelineRun {
  Pipeline pipeline;
  std::unique_ptr<FeatureTracker> tracker;
  std::map<std::string, std::vector<double>> times_ms;
  PipelineResult result;  ///< of the newest image
};

/// @param is_first  it only warms up
void run_pipeline(const PipelineSequence& sequence, bool is_first, PipelineRun& run) {
  // Where the exposure time is known well, it is estimated for every sixth image (ExposureFilter).
  constexpr double kExposureShare = 1.0 / 6;
  PipelineRequest request{true, false};
  request.exposure.emplace();
  const Camera camera(sequence.scene.calibration);
  for (std::size_t i = 0; i < sequence.frames.size(); ++i) {
    const RowExposure exposure = sequence.exposure(i);
    run.pipeline.estimate(sequence.frames[i], PixelLayout::GRAY, *sequence.scene.motion, exposure, request);
    run.pipeline.validate(ExposureAnswer{exposure.timing().exposure_ns, true});
    run.result = run.pipeline.deblur();
    const double tracks_ms = ms_of(false, [&] {
      run.tracker->track(sequence.frames[i], camera, *sequence.scene.motion, exposure, &run.result.field);
    });
    if (is_first || i == 0) continue;  // optical flow has nothing to follow from
    const StageTimes& t = run.result.times;
    run.times_ms["flow"].push_back(t.flow_ms);
    run.times_ms["blur_field"].push_back(t.blur_field_ms);
    run.times_ms["noise"].push_back(t.noise_ms);
    run.times_ms["exposure"].push_back(t.exposure_ms);
    run.times_ms["validation"].push_back(t.validation_ms);
    run.times_ms["deconvolution"].push_back(t.deconvolution_ms);
    run.times_ms["tracks"].push_back(tracks_ms);
    run.times_ms["deblurring"].push_back(t.flow_ms + t.blur_field_ms + t.noise_ms + kExposureShare * t.exposure_ms +
                                         t.validation_ms + t.deconvolution_ms);
  }
}

/// Stages of the whole pipeline with each engine in turn, and cv::ORB on the same images.
nlohmann::json measure_pipeline(const Arguments& arguments) {
  constexpr int kImages = 5;
  nlohmann::json records;
  const std::pair<cv::Size, double> scenes[] = {{{752, 480}, 15}, {{1280, 720}, 30}, {{1920, 1080}, 90}};
  std::printf(
      "\nPipeline, median ms; sum: with a sixth of exposure; ORB: cv::ORB with 1000 features on the blurred image; "
      "tracks: what feature_tracks add\n"
      "%-22s %8s %6s %11s %6s %9s %11s %14s %6s %8s %8s %7s\n",
      "", "threads", "flow", "blur field", "noise", "exposure", "validation", "deconvolution", "sum", "ORB", "ORB/sum",
      "tracks");
  for (const auto& [size, extent_px] : scenes) {
    const PipelineSequence sequence = make_pipeline_sequence(size, extent_px, kImages);
    for (const int threads : arguments.threads) {
      cv::setNumThreads(threads);
      std::vector<PipelineRun> runs;
      for (const std::string& engine : arguments.pipeline_engines) {
        PipelineOptions options = pipeline_options(threads);
        options.engine = engine;
        options.optical_flow = true;
        runs.push_back({Pipeline(options), std::make_unique<FeatureTracker>(TrackerOptions{}), {}, {}});
        runs.back().tracker->set_threads(threads);
        runs.back().pipeline.set_calibration(sequence.scene.calibration);
      }
      const cv::Ptr<cv::ORB> orb = cv::ORB::create(1000);
      for (int round = -1; round < arguments.rounds; ++round) {
        for (PipelineRun& run : runs) {
          run_pipeline(sequence, round < 0, run);
          for (int i = 1; i < kImages; ++i) {
            std::vector<cv::KeyPoint> keypoints;
            cv::Mat descriptors;
            const double orb_ms =
                ms_of(false, [&] { orb->detectAndCompute(sequence.frames[i], cv::noArray(), keypoints, descriptors); });
            if (round >= 0) run.times_ms["orb"].push_back(orb_ms);
          }
        }
      }
      for (PipelineRun& run : runs) {
        const FrameBlur& field = run.result.field;
        nlohmann::json record = {{"width", size.width},
                                 {"height", size.height},
                                 {"extent_px", extent_px},
                                 {"threads", threads},
                                 {"engine", run.pipeline.engine()},
                                 {"orb_over_deblurring", median_ratio(run.times_ms["orb"], run.times_ms["deblurring"])},
                                 {"blocks", field.blocks.size()},
                                 {"deblurred_blocks", field.count(BlockStatus::DEBLURRED)},
                                 {"rejected_blocks", field.count(BlockStatus::REJECTED)}};
        const auto ms = [&](const char* stage) { return median(run.times_ms[stage]); };
        for (const auto& [stage, values] : run.times_ms) record["median_ms"][stage] = median(values);
        std::printf(
            "%4dx%-4d %4.0f px %6zu/%zu %4d %6.2f %11.3f %6.2f %9.2f %11.2f %14.2f %6.2f %8.2f %8.2f %7.2f  %s\n",
            size.width, size.height, extent_px, field.count(BlockStatus::DEBLURRED), field.blocks.size(), threads,
            ms("flow"), ms("blur_field"), ms("noise"), ms("exposure"), ms("validation"), ms("deconvolution"),
            ms("deblurring"), ms("orb"), record["orb_over_deblurring"].get<double>(), ms("tracks"),
            run.pipeline.engine().c_str());
        records.push_back(record);
      }
      std::fflush(stdout);
    }
  }
  return records;
}

/// Peak resident memory [MiB] of a child that runs `work`. Call before this process starts any thread.
double peak_mib(const std::function<void()>& work) {
  const pid_t child = fork();
  if (child < 0) throw std::runtime_error("fork failed");
  if (child == 0) {
    work();
    _exit(0);
  }
  int status = 0;
  rusage usage{};
  if (wait4(child, &status, 0, &usage) != child || status != 0) throw std::runtime_error("a child failed");
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

nlohmann::json measure_memory(const Arguments& arguments, const FilterBank& bank) {
  // Everything but the engine is there before the children start, so that the difference is the engine's.
  constexpr int kThreads = 2;
  const cv::Size size(1920, 1080);
  const FrameBlur field =
      test::Roll::about_center(size.width, size.height, 90).field(size.width, size.height, wide_options());
  const cv::Mat image(size, CV_8UC1, cv::Scalar(100));
  cv::Mat dst(size, CV_8UC1, cv::Scalar(0));
  make_filter_grid(field, bank);  // makes the kernels
  nlohmann::json result;
  const double without = peak_mib([] {});
  std::printf("Memory at 1920x1080, 90 px, %d threads: peak MiB above the images and kernels\n", kThreads);
  for (const std::string& name : arguments.engines) {
    if (name == "opencl") continue;  // its runtime must not be started before a fork
    const double mib = peak_mib([&] {
                         const auto engine = make_engine(name, kThreads);
                         for (int i = 0; i < 3; ++i) deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst);
                       }) -
                       without;
    std::printf("  %-17s %7.1f\n", name.c_str(), mib);
    result[name] = mib;
  }
  return result;
}

nlohmann::json measure_peaks(const Arguments& arguments) {
  nlohmann::json records;
  for (const int threads : arguments.threads) {
    std::printf("\nPeaks, %d thread%s:", threads, threads > 1 ? "s" : "");
    for (const ArithmeticPeak& peak : measure_arithmetic(threads)) {
      std::printf("  %s %.0f float / %.0f int16 GMAC/s;", peak.instruction_set.c_str(), peak.float_gmac_per_s,
                  peak.int16_gmac_per_s);
      records.push_back({{"threads", threads},
                         {"instruction_set", peak.instruction_set},
                         {"float_gmac_per_s", peak.float_gmac_per_s},
                         {"int16_gmac_per_s", peak.int16_gmac_per_s}});
    }
    for (const BandwidthPeak& peak : measure_bandwidth(threads)) {
      std::printf("  %s %.0f", peak.level.c_str(), peak.gb_per_s);
      records.push_back({{"threads", threads}, {"level", peak.level}, {"gb_per_s", peak.gb_per_s}});
    }
    std::printf(" GB/s\n");
  }
  return records;
}

/// What a cpu or /proc file says, or "unknown".
std::string field_of(const char* path, const std::string& key) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.compare(0, key.size(), key) == 0) {
      const std::size_t colon = line.find(':');
      return colon == std::string::npos ? line : line.substr(line.find_first_not_of(" \t", colon + 1));
    }
  }
  return "unknown";
}

std::string processor_name() {
  std::string name = field_of("/proc/cpuinfo", "model name");
  // Linux on 64-bit ARM has no name of the processor, but one of the board.
  std::ifstream board("/proc/device-tree/model");
  if (name == "unknown") std::getline(board, name, '\0');
  return name.empty() ? "unknown" : name;
}

/// Share [0, 1] of all processors' time that others use, over a second of idling here.
double load_of_others() {
  const auto read = [] {
    std::ifstream file("/proc/stat");
    std::string cpu;
    double total = 0, idle = 0, value = 0;
    file >> cpu;
    for (int i = 0; i < 8 && file >> value; ++i) {
      total += value;
      if (i == 3 || i == 4) idle += value;
    }
    return std::make_pair(total, idle);
  };
  const auto before = read();
  std::this_thread::sleep_for(std::chrono::seconds(1));
  const auto after = read();
  const double total = after.first - before.first;
  return total > 0 ? 1 - (after.second - before.second) / total : 0;
}

void run(Arguments arguments) {
  if (arguments.engines.empty()) arguments.engines = available_engines();
  for (const std::string& name : arguments.engines) {
    if (!make_engine(name, 1)) throw std::runtime_error("engine " + name + " cannot run here");
  }
  const FilterBank bank(FilterOptions{});
  nlohmann::json result;
  result["machine"] = {{"processor", processor_name()},
                       {"processors", std::thread::hardware_concurrency()},
                       {"compiler", __VERSION__},
                       {"clock", arguments.processor_time ? "processor" : "wall"},
                       {"rounds", arguments.rounds}};
  // First, because it forks.
  if (!arguments.no_memory) result["memory_mib"] = measure_memory(arguments, bank);
  result["machine"]["load_before"] = load_of_others();
  std::printf("Processor time used by others before the start: %.0f %%\n",
              100 * result["machine"]["load_before"].get<double>());
  if (!arguments.no_peaks) result["peaks"] = measure_peaks(arguments);
  if (!arguments.no_pipeline) result["pipeline"] = measure_pipeline(arguments);
  result["deconvolution"] = measure_deconvolution(arguments, bank);
  result["machine"]["load_after"] = load_of_others();
  std::printf("\nProcessor time used by others after the end: %.0f %%\n",
              100 * result["machine"]["load_after"].get<double>());
  write_json(arguments.json, result);
}

}  // namespace
}  // namespace gyro_deblur::benchmark

int main(int argc, char** argv) {
  gyro_deblur::benchmark::Arguments arguments;
  gyro_deblur::CommandLine app{
      "Times all engines in turn on roll fields and prints their ratios; the processor's peaks, memory, and the "
      "stages of the pipeline.",
      "compare_engines"};
  app.add_option("--engines", arguments.engines, "default: all that can run here");
  app.add_option("--sizes", arguments.sizes).show_default();
  app.add_option("--extents", arguments.extents_px, "mean extents [px]").range(1.0, 250.0).show_default();
  app.add_option("--threads", arguments.threads).range(1, 256).show_default();
  app.add_option("--rounds", arguments.rounds, "turns of every engine").range(1, 10000).show_default();
  app.add_option("--pipeline-engines", arguments.pipeline_engines, "engines of the whole pipeline").show_default();
  app.add_flag("--processor-time", arguments.processor_time,
               "compare processor time instead of wall time: for a busy machine, with --threads 1");
  app.add_flag("--no-peaks", arguments.no_peaks);
  app.add_flag("--no-memory", arguments.no_memory);
  app.add_flag("--no-pipeline", arguments.no_pipeline);
  app.add_option("--json", arguments.json, "also write the numbers as JSON");
  return gyro_deblur::run_tool(app, argc, argv, [&arguments] { gyro_deblur::benchmark::run(arguments); });
}
