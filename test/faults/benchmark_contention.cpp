// Measures a stream of frames under contention, in real time: latency, processor time, and what the others lose.
// Gives a verdict only on a machine that does nothing else. See doc/reports/contention.md.
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <deque>
#include <fstream>
#include <iostream>
#include <mutex>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "busy_processes.hpp"
#include "faults.hpp"
#include "gyro_deblur/config.hpp"
#include "live.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::test {
namespace {

/// From the end of the exposure until the image has come in: the cable. Its gyroscope samples are there by then, so
/// that latency is the package's own.
constexpr TimeNs kTransferNs = 10'000'000;
/// Buffers and kernels are made in the first of it, which does not count.
constexpr double kWarmUpS = 2;
/// What is compared is measured in rounds, so many times: the machine's own speed may drift by a third within minutes.
constexpr int kRounds = 4;
/// What every core must have to give to a process that is always busy.
constexpr double kQuietShare = 0.97;
/// Of a frame's period, the work of the consumer on each core: a front end with tracking and mapping.
constexpr double kConsumerLoad = 0.6;

constexpr double kMaxLatencyRatio = 2, kMaxProcessorRatio = 1.3;
/// By how much the speed of the others may differ between two runs in which nothing else does.
constexpr double kSpeedTolerance = 0.02;

constexpr int kNoVerdict = 77;  // as a test that is skipped

void sleep_s(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

double percentile(std::vector<double> values, double part) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

double process_time_s() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

/// One run of the stream.
struct Run {
  std::vector<double> latency_ms;  ///< from the image's arrival until the frame leaves
  std::vector<double> late_ms;     ///< by how much an image arrived late: what the machine makes of any thread
  double processor_s = 0, wall_s = 0;
  std::size_t deblurred = 0;  ///< frames

  void add(const Run& other) {
    latency_ms.insert(latency_ms.end(), other.latency_ms.begin(), other.latency_ms.end());
    late_ms.insert(late_ms.end(), other.late_ms.begin(), other.late_ms.end());
    processor_s += other.processor_s;
    wall_s += other.wall_s;
    deblurred += other.deblurred;
  }

  nlohmann::json report() const {
    nlohmann::json report;
    report["frames"] = latency_ms.size();
    report["deblurred"] = deblurred;
    for (const auto& [name, part] : {std::pair("p50", 0.50), std::pair("p95", 0.95), std::pair("p99", 0.99)}) {
      report[std::string(name) + "_ms"] = percentile(latency_ms, part);
      report["late_" + std::string(name) + "_ms"] = percentile(late_ms, part);
    }
    report["processor_s"] = processor_s;
    report["wall_s"] = wall_s;
    return report;
  }
};

/// Messages of a camera whose images come in kTransferNs after their exposure.
std::vector<Delivery> as_they_arrive(const Recording& recording, TimeNs* length_ns) {
  std::vector<Delivery> deliveries = recording.repeatable(length_ns);
  for (Delivery& delivery : deliveries) {
    if (stream_of(delivery) != Stream::IMU) delivery.at_ns += kTransferNs;
  }
  std::stable_sort(deliveries.begin(), deliveries.end(),
                   [](const Delivery& a, const Delivery& b) { return a.at_ns < b.at_ns; });
  return deliveries;
}

/// Plays the stream for `seconds` after the warm-up. `on_frame` is called for every frame that leaves.
Run run_stream(const std::vector<Delivery>& deliveries, TimeNs length_ns, const Config& config,
               const FrameRequest& request, double seconds, const std::function<void()>& on_frame) {
  Run run;
  const TimeNs begin_ns = deliveries.front().at_ns, counts_from_ns = begin_ns + to_ns(kWarmUpS);
  const LiveClock clock(begin_ns, seconds);
  Processor::Environment environment;
  environment.clock = environment.steady_clock = [&clock] { return clock.now(); };
  environment.log = [&clock, counts_from_ns](LogLevel level, const std::string& text) {
    if (level >= LogLevel::WARNING && clock.now() >= counts_from_ns)
      std::fprintf(stderr, "benchmark_contention: %s\n", text.c_str());
  };
  environment.exposure_expected = [] { return true; };
  environment.request = [&request] { return request; };
  Processor processor(std::move(environment));
  processor.set_config(config);

  struct Arrival {
    TimeNs at_ns, due_ns;
  };
  std::mutex mutex;
  std::deque<Arrival> arrivals;
  double processor_before_s = 0;
  TimeNs counted_from_ns = 0;
  const auto deliver_shifted = [&](const Delivery& delivery, TimeNs shift_ns) {
    const TimeNs due_ns = delivery.at_ns + shift_ns;
    if (counted_from_ns == 0 && due_ns >= counts_from_ns) {
      processor_before_s = process_time_s();
      counted_from_ns = clock.now();
    }
    const Delivery now = step_clock({delivery}, 0, shift_ns).front();
    if (stream_of(delivery) == Stream::IMAGE) {
      const std::lock_guard<std::mutex> lock(mutex);
      arrivals.push_back({clock.now(), due_ns});
    }
    deliver(now, &processor);
  };
  const Processor::Sink sink = [&](FrameOutput&& output) {
    on_frame();
    const TimeNs left_ns = clock.now();
    const std::lock_guard<std::mutex> lock(mutex);
    const Arrival arrival = arrivals.front();
    arrivals.pop_front();
    if (arrival.due_ns < counts_from_ns) return true;
    run.latency_ms.push_back(1e3 * to_seconds(left_ns - arrival.at_ns));
    run.late_ms.push_back(1e3 * to_seconds(arrival.at_ns - arrival.due_ns));
    run.deblurred += output.reason == PassThroughReason::NONE && output.image != output.input ? 1 : 0;
    return true;
  };
  play_live(deliveries, length_ns, counts_from_ns + to_ns(seconds), clock, deliver_shifted, &processor, sink);
  run.processor_s = process_time_s() - processor_before_s;
  run.wall_s = to_seconds(clock.now() - counted_from_ns);
  return run;
}

void write_all(int file, const void* data, std::size_t bytes) {
  const char* from = static_cast<const char*>(data);
  for (std::size_t done = 0; done < bytes;) {
    const ssize_t n = write(file, from + done, bytes - done);
    if (n <= 0) throw std::runtime_error("the other process has ended");
    done += static_cast<std::size_t>(n);
  }
}

void read_all(int file, void* data, std::size_t bytes) {
  char* to = static_cast<char*>(data);
  for (std::size_t done = 0; done < bytes;) {
    const ssize_t n = read(file, to + done, bytes - done);
    if (n <= 0) throw std::runtime_error("the other process has ended");
    done += static_cast<std::size_t>(n);
  }
}

struct CameraStream {
  std::string name, scene;
  double rate_hz;
};

/// A process that plays a stream on request: what is measured of it is the package's alone.
class Package {
 public:
  /// Forks: the parent must not have had threads.
  Package(const CameraStream& stream, const Config& config, const FrameRequest& request, SharedCounts* counts,
          std::size_t consumers) {
    if (pipe(to_) != 0 || pipe(from_) != 0) throw std::runtime_error("no pipe");
    process_ = fork();
    if (process_ < 0) throw std::runtime_error("no process");
    if (process_ == 0) {
      close(to_[1]);
      close(from_[0]);
      try {
        serve(stream, config, request, counts, consumers);
      } catch (const std::exception& error) {
        std::fprintf(stderr, "benchmark_contention: %s\n", error.what());
      }
      _exit(0);
    }
    close(to_[0]);
    close(from_[1]);
  }
  ~Package() {
    close(to_[1]);
    close(from_[0]);
  }
  Package(const Package&) = delete;
  Package& operator=(const Package&) = delete;

  /// Returns when the stream has been rendered.
  void wait_until_ready() {
    char ready;
    read_all(from_[0], &ready, 1);
  }

  void start(double seconds, bool feeds_consumers) {
    const Command command{seconds, feeds_consumers};
    write_all(to_[1], &command, sizeof(command));
  }

  Run finish() {
    std::size_t frames = 0;
    Run run;
    read_all(from_[0], &frames, sizeof(frames));
    run.latency_ms.resize(frames);
    run.late_ms.resize(frames);
    read_all(from_[0], run.latency_ms.data(), frames * sizeof(double));
    read_all(from_[0], run.late_ms.data(), frames * sizeof(double));
    read_all(from_[0], &run.processor_s, sizeof(double));
    read_all(from_[0], &run.wall_s, sizeof(double));
    read_all(from_[0], &run.deblurred, sizeof(run.deblurred));
    return run;
  }

 private:
  struct Command {
    double seconds;
    bool feeds_consumers;
  };

  /// The child's, until the parent closes its end.
  void serve(const CameraStream& stream, const Config& config, const FrameRequest& request, SharedCounts* counts,
             std::size_t consumers) {
    TimeNs length_ns = 0;
    const std::vector<Delivery> deliveries = as_they_arrive(Recording(stream.scene, 1e3), &length_ns);
    write_all(from_[1], "r", 1);
    while (true) {
      Command command{};
      if (read(to_[0], &command, sizeof(command)) != sizeof(command)) return;
      const Run run = run_stream(deliveries, length_ns, config, request, command.seconds, [&] {
        for (std::size_t i = 0; command.feeds_consumers && i < consumers; ++i) sem_post(&counts->frames[i]);
      });
      const std::size_t frames = run.latency_ms.size();
      write_all(from_[1], &frames, sizeof(frames));
      write_all(from_[1], run.latency_ms.data(), frames * sizeof(double));
      write_all(from_[1], run.late_ms.data(), frames * sizeof(double));
      write_all(from_[1], &run.processor_s, sizeof(double));
      write_all(from_[1], &run.wall_s, sizeof(double));
      write_all(from_[1], &run.deblurred, sizeof(run.deblurred));
    }
  }

  int to_[2] = {}, from_[2] = {};
  pid_t process_ = -1;
};

/// What a process that is always busy gets of each core when nothing is measured.
struct Quietness {
  std::vector<double> shares;  ///< of a core's time
  double units_per_s = 0;      ///< of one core
  bool quiet() const { return *std::min_element(shares.begin(), shares.end()) >= kQuietShare; }
};

std::uint64_t units_done(const SharedCounts& counts, std::size_t cores) {
  return std::accumulate(counts.units, counts.units + cores, std::uint64_t{0},
                         [](std::uint64_t sum, const std::atomic<std::uint64_t>& units) { return sum + units; });
}

Quietness look_around(SharedCounts* counts) {
  constexpr double kLookS = 2;
  NeighbourProcesses busy;
  const auto begin = std::chrono::steady_clock::now();
  busy.start_busy(counts);
  sleep_s(kLookS);
  Quietness quietness;
  const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  for (const double time_s : busy.end()) quietness.shares.push_back(time_s / wall_s);
  const double cores = static_cast<double>(quietness.shares.size());
  quietness.units_per_s = static_cast<double>(units_done(*counts, quietness.shares.size())) / (cores * wall_s);
  return quietness;
}

/// One stream under each load.
class Measurement {
 public:
  Measurement(const CameraStream& stream, const Config& config, const FrameRequest& request, double seconds,
              SharedCounts* counts)
      : stream_(stream),
        seconds_(seconds),
        counts_(counts),
        cores_(cores_to_run_on().size()),
        package_(stream, config, request, counts, cores_),
        second_(stream, config, request, counts, cores_) {
    package_.wait_until_ready();
    second_.wait_until_ready();
  }

  nlohmann::json measure() {
    report_["stream"] = stream_.name;
    report_["rate_hz"] = stream_.rate_hz;
    const Quietness before = look_around(counts_);
    Run alone, busy, consumed, one, other;
    BusySpeed busy_speed;
    ConsumerSpeed consumer_speed;
    for (int round = 0; round < kRounds; ++round) {
      alone.add(run(seconds_ / kRounds));
      busy.add(with_busy(seconds_ / kRounds, &busy_speed));
      consumed.add(with_consumers(seconds_ / kRounds, before.units_per_s, &consumer_speed));
      package_.start(seconds_ / kRounds, false);
      second_.start(seconds_ / kRounds, false);
      one.add(package_.finish());
      other.add(second_.finish());
    }
    report_["alone"] = alone.report();
    check_run("busy", busy, alone);
    check_busy_speed(busy_speed, busy);
    report_["consumer"] = consumed.report();
    check_consumer_speed(consumer_speed, consumed);
    check_run("two at once", one, alone);
    check_run("two at once, the other", other, alone);
    const Quietness after = look_around(counts_);
    report_["quiet_before"] = before.shares;
    report_["quiet_after"] = after.shares;
    report_["quiet"] = before.quiet() && after.quiet();
    report_["good"] = good_;
    return report_;
  }

 private:
  Run run(double seconds, bool feeds_consumers = false) {
    package_.start(seconds, feeds_consumers);
    return package_.finish();
  }

  void check(const std::string& what, double value, double limit) {
    const bool good = value <= limit;
    report_["verdicts"].push_back({{"what", what}, {"value", value}, {"limit", limit}, {"good", good}});
    good_ = good_ && good;
  }

  void check_run(const std::string& load, const Run& run, const Run& alone) {
    report_[load] = run.report();
    check(load + ": p95 against alone", percentile(run.latency_ms, 0.95) / percentile(alone.latency_ms, 0.95),
          kMaxLatencyRatio);
    check(load + ": processor time against alone", run.processor_s / alone.processor_s, kMaxProcessorRatio);
  }

  /// What busy processes do in a time; their sum over rounds.
  struct BusySpeed {
    double units_without = 0, seconds_without = 0, units_with = 0, seconds_with = 0;
  };

  void count_units(const std::function<void()>& meanwhile, double* units, double* seconds) const {
    const auto begin = std::chrono::steady_clock::now();
    const std::uint64_t before = units_done(*counts_, cores_);
    meanwhile();
    *units += static_cast<double>(units_done(*counts_, cores_) - before);
    *seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  }

  Run with_busy(double seconds, BusySpeed* speed) {
    NeighbourProcesses busy;
    busy.start_busy(counts_);
    const auto nothing = [seconds] { sleep_s(seconds / 2); };
    Run loaded_run;
    count_units(nothing, &speed->units_without, &speed->seconds_without);
    count_units([&] { loaded_run = run(seconds); }, &speed->units_with, &speed->seconds_with);
    count_units(nothing, &speed->units_without, &speed->seconds_without);
    return loaded_run;
  }

  void check_busy_speed(const BusySpeed& speed, const Run& run) {
    const double without = speed.units_without / speed.seconds_without, with = speed.units_with / speed.seconds_with;
    const double used = run.processor_s / (run.wall_s * static_cast<double>(cores_));
    report_["busy_speed"] = {{"without", without}, {"with", with}, {"used_by_package", used}};
    check("busy: speed that the other processes lose", 1 - with / without, used + kSpeedTolerance);
  }

  /// How long consumers work on frames; sums over rounds.
  struct ConsumerSpeed {
    double ms_without = 0, frames_without = 0, ms_with = 0, frames_with = 0;
  };

  void count_consumed(double* ms, double* frames) const {
    for (std::size_t i = 0; i < cores_; ++i) {
      const int consumed = std::min<int>(counts_->consumed[i], kMaxFrames);
      *ms = std::accumulate(counts_->consumer_ms[i], counts_->consumer_ms[i] + consumed, *ms);
      *frames += consumed;
    }
  }

  Run with_consumers(double seconds, double units_per_s, ConsumerSpeed* speed) {
    const int units = static_cast<int>(kConsumerLoad * units_per_s / stream_.rate_hz);
    {
      NeighbourProcesses consumers;
      consumers.start_consumers(counts_, units);
      auto next = std::chrono::steady_clock::now();
      for (int frame = 0; frame < (kWarmUpS + seconds) * stream_.rate_hz; ++frame) {
        next += std::chrono::nanoseconds(to_ns(1 / stream_.rate_hz));
        std::this_thread::sleep_until(next);
        for (std::size_t i = 0; i < cores_; ++i) sem_post(&counts_->frames[i]);
      }
      count_consumed(&speed->ms_without, &speed->frames_without);
    }
    NeighbourProcesses consumers;
    consumers.start_consumers(counts_, units);
    const Run loaded_run = run(seconds, true);
    count_consumed(&speed->ms_with, &speed->frames_with);
    return loaded_run;
  }

  void check_consumer_speed(const ConsumerSpeed& speed, const Run& run) {
    const double without = speed.ms_without / speed.frames_without, with = speed.ms_with / speed.frames_with;
    const double package_ms = 1e3 * run.processor_s / static_cast<double>(run.latency_ms.size());
    report_["consumer_speed"] = {{"without_ms", without}, {"with_ms", with}, {"package_ms", package_ms}};
    check("consumer: time of its work on a frame against without", with / without,
          (without + package_ms) / without + kSpeedTolerance);
  }

  const CameraStream stream_;
  const double seconds_;
  SharedCounts* const counts_;
  const std::size_t cores_;
  Package package_, second_;
  nlohmann::json report_;
  bool good_ = true;
};

void print(const nlohmann::json& report) {
  std::printf("\n%s at %g Hz\n%-24s %7s %7s %7s %12s %14s\n", report["stream"].get<std::string>().c_str(),
              report["rate_hz"].get<double>(), "", "p50", "p95", "p99 [ms]", "late p95 [ms]", "processor [%]");
  for (const char* name : {"alone", "busy", "consumer", "two at once", "two at once, the other"}) {
    const nlohmann::json& run = report[name];
    std::printf("%-24s %7.2f %7.2f %7.2f %13.2f %14.1f\n", name, run["p50_ms"].get<double>(),
                run["p95_ms"].get<double>(), run["p99_ms"].get<double>(), run["late_p95_ms"].get<double>(),
                100 * run["processor_s"].get<double>() / run["wall_s"].get<double>());
  }
  for (const nlohmann::json& verdict : report["verdicts"]) {
    std::printf("%-60s %6.3f, at most %6.3f %s\n", verdict["what"].get<std::string>().c_str(),
                verdict["value"].get<double>(), verdict["limit"].get<double>(),
                verdict["good"].get<bool>() ? "" : "  TOO MUCH");
  }
}

int main_of(int argc, char** argv) {
  const std::string folder = std::string(GYRO_DEBLUR_SOURCE_DIR) + "/test/faults/";
  std::string config_path = folder + "contention.yaml", json_path, only;
  double seconds = 20;
  bool even_if_busy = false, keypoints = false;
  CommandLine app{"Measures streams of frames under contention, in real time.", "benchmark_contention"};
  app.add_option("--seconds", seconds, "of each of them, in all its rounds [20]").range(1.0, 600.0);
  app.add_option("--config", config_path, "keys of config/default.yaml");
  app.add_option("--json", json_path, "where to write the numbers");
  app.add_option("--only", only, "one stream: 752x480 or 1920x1080").one_of({"752x480", "1920x1080"});
  app.add_flag("--keypoints", keypoints, "keypoints as well as images");
  app.add_flag("--even-if-busy", even_if_busy,
               "measures also on a machine that does something else, without a verdict");
  if (const std::optional<int> ended = read_arguments(app, argc, argv)) return *ended;
  try {
    const Config config = load_known_config(config_path);
    FrameRequest request;
    request.keypoints = keypoints;
    SharedCounts* counts = make_shared_counts();
    if (!look_around(counts).quiet() && !even_if_busy) {
      std::cerr << "benchmark_contention: no verdict: others use this machine, a busy process gets less than "
                << 100 * kQuietShare << " % of a core\n";
      return kNoVerdict;
    }
    bool good = true, quiet = true;
    nlohmann::json reports = nlohmann::json::array();
    for (const CameraStream& stream : {CameraStream{"752x480", folder + "contention_752x480.yaml", 20},
                                       CameraStream{"1920x1080", folder + "contention_1920x1080.yaml", 30}}) {
      if (!only.empty() && only != stream.name) continue;
      reports.push_back(Measurement(stream, config, request, seconds, counts).measure());
      print(reports.back());
      good = good && reports.back()["good"];
      quiet = quiet && reports.back()["quiet"];
    }
    if (!json_path.empty()) {
      std::ofstream file(json_path);
      file << nlohmann::json{{"cores", cores_to_run_on().size()},
                             {"seconds", seconds},
                             {"rounds", kRounds},
                             {"streams", reports}}
                  .dump(1)
           << "\n";
      if (!file.flush()) throw std::runtime_error(json_path + ": cannot be written");
    }
    if (!quiet) {
      std::cerr << "benchmark_contention: no verdict: others used this machine meanwhile\n";
      return kNoVerdict;
    }
    std::printf("\n%s\n", good ? "within all limits" : "NOT within all limits");
    return good ? 0 : 1;
  } catch (const std::exception& error) {
    std::cerr << "benchmark_contention: " << error.what() << "\n";
    return 1;
  }
}

}  // namespace
}  // namespace gyro_deblur::test

int main(int argc, char** argv) { return gyro_deblur::test::main_of(argc, argv); }
