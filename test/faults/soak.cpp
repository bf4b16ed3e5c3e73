// Plays a recording again and again through the processor, faster than it was taken, with a few faults of every kind,
// and writes memory and latency over time. Fails when a frame is lost, memory grows or frames take ever longer.
#include <time.h>

#include <algorithm>
#include <cstdio>
#include <deque>
#include <fstream>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>

#include "faults.hpp"
#include "gyro_deblur/config.hpp"
#include "process_memory.hpp"
#include "replay.hpp"
#include "ros/conversions.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::test {
namespace {

constexpr TimeNs kSecond = 1'000'000'000;
/// Of each kind of fault in each stream; 24 kinds together.
constexpr double kFaultRate = 0.001;
/// Between the run's second quarter, when all buffers have been filled, and its end. A frame is 0.03 MiB.
constexpr double kMaxGrowthMib = 4;
/// Processor time of a frame in yardsticks, over the same stretch.
constexpr double kMaxSlowdown = 1.5;
/// Frames between two looks at the yardstick.
constexpr std::size_t kYardstickPeriod = 10;

double thread_time_ms() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
}

/// Processor time [ms] of work that is always the same: how fast the machine is just now, other programs included.
double yardstick_ms() {
  static const cv::Mat image(480, 640, CV_8UC1, cv::Scalar(100));
  static cv::Mat blurred;
  const double before_ms = thread_time_ms();
  cv::GaussianBlur(image, blurred, {}, 2);
  return thread_time_ms() - before_ms;
}

double percentile(std::vector<double> values, double part) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// What happened in a stretch of simulated time.
struct Window {
  std::vector<double> latency_ms, processor_ms, yardstick_ms;
  nlohmann::json report(double end_s, std::size_t waiting) const {
    return {{"t_s", end_s},
            {"memory_mib", process_memory_mib()},
            {"frames", latency_ms.size()},
            {"waiting", waiting},
            {"p50_ms", percentile(latency_ms, 0.50)},
            {"p95_ms", percentile(latency_ms, 0.95)},
            {"p99_ms", percentile(latency_ms, 0.99)},
            {"processor_p50_ms", percentile(processor_ms, 0.50)},
            {"processor_p95_ms", percentile(processor_ms, 0.95)},
            {"processor_p99_ms", percentile(processor_ms, 0.99)},
            {"yardstick_ms", percentile(yardstick_ms, 0.50)}};
  }
};

nlohmann::json soak(const Recording& recording, const Config& config, double seconds, double window_s, bool quiet) {
  TimeNs length_ns = 0;
  const std::vector<Delivery> piece = recording.repeatable(&length_ns);
  const TimeNs begin_ns = piece.front().at_ns;
  const auto rounds = static_cast<std::uint64_t>(std::max<TimeNs>(1, to_ns(seconds) / length_ns));

  TimeNs clock_ns = 0;
  std::size_t log_lines = 0;
  Processor::Environment environment;
  environment.clock = environment.steady_clock = [&clock_ns] { return clock_ns; };
  environment.log = [&log_lines](LogLevel, const std::string&) { ++log_lines; };
  environment.exposure_expected = [] { return true; };
  environment.request = [] {
    FrameRequest request;
    request.overlay = request.markers = true;
    return request;
  };
  Processor processor(std::move(environment));
  processor.set_config(config);

  nlohmann::json windows = nlohmann::json::array();
  Window window;
  TimeNs window_end_ns = begin_ns + to_ns(window_s);
  std::deque<const sensor_msgs::Image*> expected;  // in order; the processor holds them
  std::size_t frames_in = 0, frames_out = 0, wrong = 0;
  const Processor::Sink sink = [&](FrameOutput&& output) {
    ++frames_out;
    if (expected.empty() || expected.front() != output.input.get()) {
      ++wrong;
    } else {
      expected.pop_front();
    }
    window.latency_ms.push_back(output.total_ms);
    return true;
  };
  Progress progress(rounds, "rounds of the recording", quiet);
  for (std::uint64_t round = 0; round < rounds; ++round) {
    std::vector<Delivery> deliveries =
        step_clock(piece, begin_ns, static_cast<TimeNs>(round) * length_ns);  // shifts stamps and clock
    std::uint64_t seed = 100 * round;
    for (const Fault fault : kFaults) {
      for (const Stream stream : {Stream::IMU, Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE}) {
        deliveries = inject(deliveries, stream, fault, kFaultRate, seed++);
      }
    }
    for (Delivery& delivery : deliveries) {
      clock_ns = delivery.at_ns + static_cast<TimeNs>(round) * length_ns;
      if (const auto* image = std::get_if<sensor_msgs::ImageConstPtr>(&delivery.message)) {
        ++frames_in;
        expected.push_back(image->get());
      }
      deliver(delivery, &processor);
      if (processor.waiting() == 0) continue;
      const double before_ms = thread_time_ms();
      const std::size_t out_before = frames_out;
      processor.advance(sink);
      if (frames_out == out_before + 1) window.processor_ms.push_back(thread_time_ms() - before_ms);
      if (frames_out > out_before && frames_out % kYardstickPeriod == 0) window.yardstick_ms.push_back(yardstick_ms());
      if (clock_ns >= window_end_ns) {
        windows.push_back(window.report(to_seconds(window_end_ns - begin_ns), processor.waiting()));
        window = {};
        window_end_ns += to_ns(window_s);
      }
    }
    progress.done(round + 1);
  }
  processor.finish(sink);
  const ProcessorStatistics statistics = processor.statistics();
  nlohmann::json report;
  report["simulated_s"] = to_seconds(static_cast<TimeNs>(rounds) * length_ns);
  report["frames_in"] = frames_in;
  report["frames_out"] = frames_out;
  report["lost"] = frames_in - frames_out;
  report["out_of_order"] = wrong;
  for (const auto& [reason, count] : statistics.passed_through) report["passed_through"][to_string(reason)] = count;
  report["time_jumps"] = statistics.time_jumps;
  report["log_lines"] = log_lines;
  report["windows"] = std::move(windows);
  return report;
}

/// Median of a value of the windows in the second quarter and in the last one.
template <typename Value>
std::pair<double, double> early_and_late(const nlohmann::json& windows, Value value) {
  const auto quarter = [&](std::size_t index) {
    std::vector<double> values;
    for (std::size_t i = index * windows.size() / 4; i < (index + 1) * windows.size() / 4; ++i) {
      values.push_back(value(windows[i]));
    }
    return percentile(values, 0.5);
  };
  return {quarter(1), quarter(3)};
}

double memory_mib(const nlohmann::json& window) { return window["memory_mib"]; }
double frame_in_yardsticks(const nlohmann::json& window) {
  return window["processor_p50_ms"].get<double>() / window["yardstick_ms"].get<double>();
}

int main_of(int argc, char** argv) {
  const std::string folder = std::string(GYRO_DEBLUR_SOURCE_DIR) + "/test/faults/";
  std::string scene = folder + "scene.yaml", config_path = folder + "config.yaml", json_path;
  double seconds = 600, window_s = 10;
  bool quiet = false;
  CommandLine app{"Plays a recording again and again through the processor and follows memory and latency.", "soak"};
  app.add_option("--seconds", seconds, "of simulated time [600]").range(40.0, 1e6);
  app.add_option("--window", window_s, "seconds of simulated time for each point [10]").range(0.1, 600.0);
  app.add_option("--scene", scene, "of the simulator");
  app.add_option("--config", config_path, "keys of config/default.yaml");
  app.add_option("--json", json_path, "where to write the points");
  app.add_flag("--quiet", quiet, "no progress");
  if (const std::optional<int> ended = read_arguments(app, argc, argv)) return *ended;
  try {
    cv::setNumThreads(1);  // all of a frame's processor time is the thread's that is measured
    const Recording recording(scene, 10);
    const nlohmann::json report = soak(recording, load_known_config(config_path), seconds, window_s, quiet);
    if (!json_path.empty()) {
      std::ofstream file(json_path);
      file << report.dump(1) << "\n";
      if (!file.flush()) throw std::runtime_error(json_path + ": cannot be written");
    }
    const nlohmann::json &first = report["windows"].front(), &last = report["windows"].back();
    const auto [early_mib, late_mib] = early_and_late(report["windows"], memory_mib);
    const auto [early, late] = early_and_late(report["windows"], frame_in_yardsticks);
    const double growth_mib = late_mib - early_mib, slowdown = late / early;
    std::printf("%.0f s simulated: %zu frames in, %zu out, %zu lost, %zu out of order; passed through %s\n",
                report["simulated_s"].get<double>(), report["frames_in"].get<std::size_t>(),
                report["frames_out"].get<std::size_t>(), report["lost"].get<std::size_t>(),
                report["out_of_order"].get<std::size_t>(), report["passed_through"].dump().c_str());
    std::printf("memory %.1f MiB at first, %.1f MiB at last, %+.2f MiB from the second quarter to the last\n",
                first["memory_mib"].get<double>(), last["memory_mib"].get<double>(), growth_mib);
    std::printf("a frame takes %.2f yardsticks in the second quarter, %.2f in the last one\n", early, late);
    for (const char* key : {"p50_ms", "p95_ms", "p99_ms", "processor_p50_ms", "processor_p95_ms", "processor_p99_ms"}) {
      std::printf("%-17s %.2f at first, %.2f at last\n", key, first[key].get<double>(), last[key].get<double>());
    }
    if (report["lost"] != 0 || report["out_of_order"] != 0 || !(growth_mib <= kMaxGrowthMib) ||
        !(slowdown <= kMaxSlowdown)) {
      std::cerr << "soak: frames were lost or out of order, memory grew by more than " << kMaxGrowthMib
                << " MiB, or frames came to take " << kMaxSlowdown << " times as long\n";
      return 1;
    }
  } catch (const std::exception& error) {
    std::cerr << "soak: " << error.what() << "\n";
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace gyro_deblur::test

int main(int argc, char** argv) { return gyro_deblur::test::main_of(argc, argv); }
