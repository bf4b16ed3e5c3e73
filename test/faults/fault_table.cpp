// Plays a simulated recording through every fault and prints what became of the frames. Fails when a frame is lost,
// repeated, out of order or altered.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <new>
#include <optional>
#include <random>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "busy_processes.hpp"
#include "engine/engine.hpp"
#include "engine/fallback_engine.hpp"
#include "faults.hpp"
#include "gyro_deblur/config.hpp"
#include "process_memory.hpp"
#include "replay.hpp"
#include "ros/image_conversion.hpp"
#include "sync/pass_through.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::test {
namespace {

constexpr TimeNs kSecond = 1'000'000'000;
constexpr double kRates[] = {0.01, 0.1, 0.5};

/// Calls of the engine before it fails.
constexpr int kGoodCalls = 20, kGoodCallsInARow = 9;

/// A device that works for some calls and then fails: for good, or every so often.
template <typename Error>
class FailingEngine : public Engine {
 public:
  FailingEngine(std::unique_ptr<Engine> engine, int good_calls, bool for_good)
      : engine_(std::move(engine)), good_calls_(good_calls), for_good_(for_good) {}

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) override {
    ++calls_;
    const bool fails = for_good_ ? calls_ > good_calls_ : calls_ % (good_calls_ + 1) == 0;
    engine_->filter(src, grid, dst);
    if (!fails) return;
    dst.setTo(cv::Scalar::all(7));  // the result is spoilt
    throw Error();
  }
  std::string name() const override { return "failing"; }

 private:
  std::unique_ptr<Engine> engine_;
  int good_calls_, calls_ = 0;
  bool for_good_;
};

struct DeviceLost : DeviceError {
  DeviceLost() : DeviceError("the device was lost") {}
};

/// The value that the part `part` in (0, 1] of the values does not exceed. Precondition: not empty, in order of size.
double percentile(const std::vector<double>& values, double part) {
  const auto rank = static_cast<std::size_t>(std::ceil(part * static_cast<double>(values.size())));
  return values[std::max<std::size_t>(rank, 1) - 1];
}

struct Row {
  std::string fault, stream, rate;
  ReplayResult result;
  std::size_t allowed_waiting = 0;              ///< 0: not looked at
  std::optional<double> allowed_p99_periods{};  ///< of the latency
  std::set<PassThroughReason> not_allowed{};    ///< for no frame
  std::optional<std::size_t> allowed_mispredicted{};
  std::string reported{};  ///< kind of the input problem that has to be reported; empty: none has to
  bool good() const {
    if (!reported.empty() && result.statistics.input_problems.count(reported) == 0) return false;
    for (const PassThroughReason reason : not_allowed) {
      if (result.balance.passed_through.count(reason) > 0) return false;
    }
    const std::vector<double>& latencies = result.latencies_periods;
    const bool in_time =
        !allowed_p99_periods || latencies.empty() || percentile(latencies, 0.99) <= *allowed_p99_periods;
    const bool predicted = !allowed_mispredicted || result.mispredicted <= *allowed_mispredicted;
    return result.balance.good() && in_time && predicted &&
           (allowed_waiting == 0 || result.peak_waiting <= allowed_waiting);
  }
  std::string latency(double part) const {
    if (result.latencies_periods.empty()) return "";
    char text[20];
    std::snprintf(text, sizeof(text), "%.1f", percentile(result.latencies_periods, part));
    return text;
  }
};

std::string percent(double part) {
  char text[20];
  std::snprintf(text, sizeof(text), "%g %%", 100 * part);
  return text;
}

std::string describe(const std::map<PassThroughReason, std::size_t>& passed_through) {
  std::string text;
  for (const auto& [reason, count] : passed_through) {
    text += (text.empty() ? "" : ", ") + std::string(gyro_deblur::to_string(reason)) + " " + std::to_string(count);
  }
  return text.empty() ? "-" : text;
}

/// Of the first image. Precondition: there is one.
cv::Size image_size(const std::vector<Delivery>& deliveries) {
  const auto first = std::find_if(deliveries.begin(), deliveries.end(),
                                  [](const Delivery& delivery) { return stream_of(delivery) == Stream::IMAGE; });
  const sensor_msgs::Image& image = *std::get<sensor_msgs::ImageConstPtr>(first->message);
  return {static_cast<int>(image.width), static_cast<int>(image.height)};
}

class Table {
 public:
  Table(const Recording& recording, const Config& config, std::size_t reloads)
      : recording_(recording), config_(config), reloads_(reloads) {
    options_.config = config;
  }

  void make(bool quiet) {
    const Stream streams[] = {Stream::IMU, Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE};
    constexpr std::size_t kOthers = 44;
    Progress progress(std::size(kFaults) * std::size(streams) * std::size(kRates) + kOthers, "faults", quiet);
    std::size_t done = 0;
    const auto add = [&](Row row) {
      rows_.push_back(std::move(row));
      progress.done(++done);
    };
    const auto one = [&](const std::string& fault, const std::string& stream, const std::vector<Delivery>& deliveries,
                         const ReplayOptions& options) {
      // What may wait unsettled, and what came while one frame was processed.
      const std::size_t allowed = static_cast<std::size_t>(config_.frame_queue_size) + 1 +
                                  static_cast<std::size_t>(options.processing_ns / recording_.frame_period_ns());
      add({fault, stream, "", replay(recording_, deliveries, options), allowed, std::nullopt});
    };
    const std::vector<Delivery>& all = recording_.deliveries();
    one("none", "", all, options_);
    const double p99_periods = percentile(rows_.back().result.latencies_periods, 0.99);
    // Messages that are lost, or do not come, make frames late by at most this (beyond the first seconds of a stream).
    constexpr double kAllowedPeriods = 2;
    const auto in_time = [&] { rows_.back().allowed_p99_periods = p99_periods + kAllowedPeriods; };
    std::uint64_t seed = 1;
    for (const Fault fault : kFaults) {
      for (const Stream stream : streams) {
        for (const double rate : kRates) {
          one(to_string(fault), gyro_deblur::to_string(stream), inject(all, stream, fault, rate, seed++), options_);
          rows_.back().rate = percent(rate);
          const bool per_image = stream == Stream::CAMERA_INFO || stream == Stream::EXPOSURE;
          if (fault == Fault::DROP && per_image && rate < 0.5) in_time();
        }
      }
    }
    for (const double rate : kRates) {
      std::vector<Delivery> deliveries = all;
      for (const Fault fault : kFaults) {
        for (const Stream stream : streams) deliveries = inject(deliveries, stream, fault, rate / 4, seed++);
      }
      one("all of these at once", "all", deliveries, options_);
      rows_.back().rate = percent(rate / 4) + " each";
    }

    const TimeNs begin_ns = recording_.begin_ns(), length_ns = recording_.end_ns() - begin_ns;
    const TimeNs third_ns = begin_ns + length_ns / 3, two_thirds_ns = begin_ns + 2 * length_ns / 3;
    one("stops and comes back", "imu", silence(all, Stream::IMU, third_ns, two_thirds_ns), options_);
    one("stops for good", "imu", silence(all, Stream::IMU, third_ns, begin_ns + 2 * length_ns), options_);
    std::vector<Delivery> unplugged = all;
    for (const Stream stream : {Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE}) {
      unplugged = silence(unplugged, stream, third_ns, two_thirds_ns);
    }
    one("unplugged and plugged in", "camera", unplugged, options_);
    constexpr double kClippedRadS = 1.5;  // the scene rotates at up to 2.3 rad/s about an axis
    ReplayOptions clipping = options_;
    clipping.config.gyro.range_rad_s = kClippedRadS;
    one("range is 1.5 rad/s", "imu", clip_gyro(all, kClippedRadS), clipping);
    clipping.config.gyro.range_rad_s = 0;
    one("range is 1.5 rad/s, `gyro_range` not set", "imu", clip_gyro(all, kClippedRadS), clipping);
    one("image without camera_info", "camera_info", silence(all, Stream::CAMERA_INFO, 0, begin_ns + 2 * length_ns),
        options_);
    const TimeNs never_ns = begin_ns + 2 * length_ns;
    one("no message", "exposure", silence(all, Stream::EXPOSURE, 0, never_ns), options_);
    one("stops for good", "camera_info", silence(all, Stream::CAMERA_INFO, third_ns, never_ns), options_);
    one("stops for good", "exposure", silence(all, Stream::EXPOSURE, third_ns, never_ns), options_);
    constexpr std::size_t kSparse = 10;
    ReplayOptions sparse = options_;
    sparse.config.exposure_max_age_ns = kSecond;
    one("every tenth alone", "exposure", thin_out(all, Stream::EXPOSURE, kSparse), sparse);
    one("every tenth alone", "camera_info", thin_out(all, Stream::CAMERA_INFO, kSparse), options_);
    for (const auto& [stream, name] : {std::pair(Stream::IMU, "imu"),
                                       {Stream::IMAGE, "image"},
                                       {Stream::CAMERA_INFO, "camera_info"},
                                       {Stream::EXPOSURE, "exposure"}}) {
      one("every tenth has the stamp 0", name, unset_stamps(all, stream, kSparse, kSparse / 2), options_);
      rows_.back().not_allowed = {PassThroughReason::TIME_JUMP, PassThroughReason::NO_CALIBRATION};
    }
    one("the stamp is 0", "camera_info", unset_stamps(all, Stream::CAMERA_INFO, 1), options_);
    rows_.back().not_allowed = {PassThroughReason::NO_CALIBRATION};
    one("comes once", "camera_info", thin_out(all, Stream::CAMERA_INFO, all.size()), options_);
    rows_.back().not_allowed = {PassThroughReason::NO_CALIBRATION};
    // Three frames become ready at once then, and are processed at once: no overload.
    one("comes in batches of 100 ms", "imu", in_batches(all, Stream::IMU, kSecond / 10), options_);
    rows_.back().not_allowed = {PassThroughReason::OVERLOAD};
    for (const TimeNs step_s : {10, -10, 1, -1}) {
      one("clock steps by " + std::to_string(step_s) + " s", "all", step_clock(all, third_ns, step_s * kSecond),
          options_);
    }
    one("clock steps by -10 s and back", "all",
        step_clock(step_clock(all, third_ns, -10 * kSecond), two_thirds_ns, 10 * kSecond), options_);
    std::vector<Delivery> node_clock = all;
    for (Delivery& delivery : node_clock) {
      if (delivery.at_ns >= third_ns) delivery.clock_ns -= 10 * kSecond;
    }
    one("only the node's clock steps by -10 s", "clock", node_clock, options_);
    // They are deblurred with the blur of their picture, wherever the camera points by now.
    const std::size_t mispredicted = rows_.front().result.mispredicted;
    for (const std::size_t period : {2, 5}) {
      one("every " + std::string(period == 2 ? "other" : "fifth") + " repeats the picture before", "image",
          repeat_pictures(all, period), options_);
      rows_.back().allowed_mispredicted = mispredicted;
    }
    one("frozen", "image", freeze(all, third_ns, two_thirds_ns), options_);
    rows_.back().allowed_mispredicted = mispredicted;
    const auto reported = [&](const std::string& fault, const std::string& stream,
                              const std::vector<Delivery>& deliveries, const std::string& kind) {
      one(fault, stream, deliveries, options_);
      rows_.back().reported = kind;
    };
    reported("rates in degrees/s", "imu", scale_rates(all, 180 / M_PI), "imu unit");
    reported("an accelerometer's topic", "imu", scale_rates(all, 0), "imu unit by images");
    reported("10 Hz", "imu", thin_out(all, Stream::IMU, 20), "imu rate");
    reported("another clock, 50 years ahead", "imu", shift_clock(all, Stream::IMU, 50 * 31'536'000 * kSecond),
             "clocks");
    reported("10 times the time that it is", "exposure", set_exposures(all, kSecond / 5, all.size()), "exposure");
    reported("0 at first", "exposure", set_exposures(all, 0, 10), "exposure 0");
    const cv::Size size = image_size(all);
    const auto with_mask = [&all](const std::function<sensor_msgs::ImagePtr()>& make) {
      return with_action(all, kSecond / 2, [make](Processor& processor) { processor.add_mask(*make()); });
    };
    bool left = false;
    const auto half = [size, &left] {
      left = !left;
      cv::Mat used(size, CV_8UC1, cv::Scalar(0));
      used.colRange(left ? 0 : size.width / 2, left ? size.width / 2 : size.width).setTo(255);
      return to_image(used, {}, "mono8");
    };
    one("covers the other half, at 2 Hz", "mask", with_mask(half), options_);
    reported("of another size", "mask",
             with_mask([size] { return to_image(cv::Mat(size / 2, CV_8UC1, cv::Scalar(255)), {}, "mono8"); }),
             "mask size");
    reported("in colour", "mask",
             with_mask([size] { return to_image(cv::Mat(size, CV_8UC3, cv::Scalar::all(255)), {}, "bgr8"); }),
             "mask topic");
    constexpr std::size_t kFramesOfAKind = 7;
    one("size changes", "image", change_sizes(all, kFramesOfAKind), options_);
    one("encoding changes", "image", change_encodings(all, kFramesOfAKind), options_);

    std::uint64_t changes = 0;
    const Action reconfigure = [this, &changes](Processor& processor) {
      try {
        processor.set_config(random_change(config_, changes++));
      } catch (const OptionError&) {
        // Some are meant to be refused.
      }
    };
    one("parameters change at 50 Hz", "", with_action(all, kSecond / 50, reconfigure), options_);
    one("reset is called at 2 Hz", "", with_action(all, kSecond / 2, [](Processor& processor) { processor.reset(); }),
        options_);

    ReplayOptions failing = options_;
    failing.make_engine = [](const std::string&, int threads) {
      return std::make_unique<FallbackEngine>(
          std::make_unique<FailingEngine<DeviceLost>>(make_engine("cpu", threads), kGoodCalls, true),
          make_engine("cpu", threads));
    };
    one("device fails in mid-run", "engine", all, failing);
    failing.make_engine = [](const std::string&, int threads) {
      return std::make_unique<FailingEngine<std::bad_alloc>>(make_engine("cpu", threads), kGoodCallsInARow, false);
    };
    one("memory runs out", "engine", all, failing);
    rows_.back().rate = "10 %";
    ReplayOptions slow = options_;
    for (const int processing_ms : {40, 100}) {
      slow.processing_ns = processing_ms * kSecond / 1000;
      one("processing takes " + std::to_string(processing_ms) + " ms a frame", "engine", all, slow);
    }

    {
      // In real time: what frames become of, and no more. How long they take is in doc/reports/contention.md.
      NeighbourProcesses busy;
      busy.start_busy(make_shared_counts());
      ReplayOptions all_cores = options_;
      all_cores.config.pipeline.threads = 0;
      add({"neighbour: a busy process on every core, in real time", "", "", replay_live(recording_, all, all_cores),
           0});
    }

    Balance reloaded;
    ReplayResult last;
    for (std::size_t i = 0; i < reloads_; ++i) {
      // A short piece each, begun and ended anywhere.
      const std::size_t begin = i * all.size() / (2 * reloads_), end = begin + all.size() / 20;
      last = replay(recording_,
                    {all.begin() + static_cast<std::ptrdiff_t>(begin), all.begin() + static_cast<std::ptrdiff_t>(end)},
                    options_);
      reloaded += last.balance;
    }
    last.balance = reloaded;
    last.latencies_periods.clear();
    add({"unloaded and loaded " + std::to_string(reloads_) + " times", "", "", last, 0, std::nullopt});

    constexpr int kThreadedRuns = 8;
    Balance threaded;
    for (int i = 0; i < kThreadedRuns; ++i) {
      std::mt19937_64 random(seed++);
      const double part = std::uniform_real_distribution<double>(0.05, 1)(random);
      last = replay_on_threads(recording_, all, options_, part, seed++);
      threaded += last.balance;
      last.mispredicted = 0;
    }
    last.balance = threaded;
    add({"shut down during work, " + std::to_string(kThreadedRuns) + " times, streams and changes on threads", "all",
         "", last, 0, std::nullopt});
  }

  bool good() const {
    for (const Row& row : rows_) {
      if (!row.good()) return false;
    }
    return true;
  }

  std::string markdown() const {
    std::ostringstream out;
    out << "| fault | in | rate | frames in | out | deblurred | unchanged | passed through, by reason | off | lost | "
           "repeated | reordered | altered | most waiting | latency p50 | p99 |\n"
        << "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n";
    Balance sum;
    for (const Row& row : rows_) {
      const Balance& b = row.result.balance;
      sum += b;
      out << "| " << row.fault << " | " << row.stream << " | " << row.rate << " | " << b.frames_in << " | "
          << b.frames_out << " | " << b.deblurred << " | " << b.unchanged << " | " << describe(b.passed_through)
          << " | " << row.result.mispredicted << " | " << b.lost << " | " << b.repeated << " | " << b.reordered << " | "
          << b.altered + b.misstamped + b.retained << " | "
          << (row.allowed_waiting > 0 ? std::to_string(row.result.peak_waiting) : "") << " | " << row.latency(0.5)
          << " | " << row.latency(0.99) << " |" << (row.good() ? "" : " **WRONG**") << "\n";
    }
    out << "| **all** | | | " << sum.frames_in << " | " << sum.frames_out << " | " << sum.deblurred << " | "
        << sum.unchanged << " | " << describe(sum.passed_through) << " | | " << sum.lost << " | " << sum.repeated
        << " | " << sum.reordered << " | " << sum.altered + sum.misstamped + sum.retained << " | | | |\n";
    return out.str();
  }

 private:
  const Recording& recording_;
  const Config& config_;
  std::size_t reloads_;
  ReplayOptions options_;
  std::vector<Row> rows_;
};

int main_of(int argc, char** argv) {
  const std::string folder = std::string(GYRO_DEBLUR_SOURCE_DIR) + "/test/faults/";
  std::string scene = folder + "scene.yaml", config_path = folder + "config.yaml", markdown_path;
  double seconds = 10;
  std::size_t reloads = 200;
  bool quiet = false;
  CommandLine app{"Plays a simulated recording through every fault and prints what became of the frames.",
                  "fault_table"};
  app.add_option("--seconds", seconds, "length of the recording [10]").range(0.5, 10.0);
  app.add_option("--reloads", reloads, "how often to unload and load [200]").range(1, 10000);
  app.add_option("--scene", scene, "of the simulator");
  app.add_option("--config", config_path, "keys of config/default.yaml");
  app.add_option("--markdown", markdown_path, "also write the table into a file");
  app.add_flag("--quiet", quiet, "no progress");
  if (const std::optional<int> ended = read_arguments(app, argc, argv)) return *ended;

  try {
    const Config config = load_known_config(config_path);
    const Recording recording(scene, seconds);
    Table table(recording, config, reloads);
    const double memory_before_mib = process_memory_mib();
    table.make(quiet);
    const std::string text = table.markdown();
    std::cout << text << "\nmemory of the process: " << static_cast<int>(memory_before_mib) << " MiB before, "
              << static_cast<int>(process_memory_mib()) << " MiB after\n";
    if (!markdown_path.empty()) {
      std::ofstream file(markdown_path);
      file << text;
      if (!file.flush()) throw std::runtime_error(markdown_path + ": cannot be written");
    }
    if (!table.good()) {
      std::cerr << "fault_table: the rows with WRONG lost, repeated, reordered or altered frames, held too many or too "
                   "long, or went by another blur than the picture's\n";
      return 1;
    }
  } catch (const std::exception& error) {
    std::cerr << "fault_table: " << error.what() << "\n";
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace gyro_deblur::test

int main(int argc, char** argv) { return gyro_deblur::test::main_of(argc, argv); }
