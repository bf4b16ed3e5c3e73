#include "replay.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "live.hpp"
#include "sync/pass_through.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>
#include <random>
#include <thread>
#include <utility>

#include <boost/make_shared.hpp>

namespace gyro_deblur::test {
namespace {

/// Truth and prediction are compared at the image's centre.
bool is_mispredicted(const FrameOutput& output, double true_extent_px) {
  if (!output.field || output.reason != PassThroughReason::NONE) return false;
  const FrameBlur& field = *output.field;
  const auto center = static_cast<std::size_t>(
      field.grid.index_at((field.grid.width_px() - 1) / 2.0, (field.grid.height_px() - 1) / 2.0));
  if (field.blocks[center].status != BlockStatus::DEBLURRED) return false;
  constexpr double kTolerancePx = 1, kTolerance = 0.1;
  return std::abs(field.blocks[center].extent_px - true_extent_px) > kTolerancePx + kTolerance * true_extent_px;
}

/// Gives a message to the processor; images go through the accounting as messages of their own.
class Deliverer {
 public:
  Deliverer(const Recording& recording, Processor* processor) : recording_(recording), processor_(processor) {}

  void deliver(const Delivery& delivery) {
    if (const auto* image = std::get_if<sensor_msgs::ImageConstPtr>(&delivery.message)) {
      deliver_image(*image, delivery.frame, delivery.at_ns);
    } else {
      test::deliver(delivery, processor_);
    }
  }

  void take(const FrameOutput& output, ReplayResult* result) {
    const std::lock_guard<std::mutex> lock(mutex_);
    accounting_.out(output);
    const auto frame = frames_.find(output.input.get());
    if (frame == frames_.end()) return;
    // A part of the image has its centre elsewhere.
    const bool whole = output.input->width == whole_width_ && output.input->height == whole_height_;
    if (whole && is_mispredicted(output, recording_.center_extent_px(frame->second.frame))) ++result->mispredicted;
  }

  /// When the frame's image arrived. Precondition: it is one of those that were delivered.
  TimeNs arrival_ns(const FrameOutput& output) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return frames_.at(output.input.get()).arrival_ns;
  }

  Balance balance() const { return accounting_.balance(); }

 private:
  void deliver_image(const sensor_msgs::ImageConstPtr& image, std::size_t frame, TimeNs at_ns) {
    sensor_msgs::ImageConstPtr own = copy_of(image);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      accounting_.in(own);
      frames_[own.get()] = {frame, at_ns};
      whole_width_ = std::max(whole_width_, own->width);
      whole_height_ = own->width == whole_width_ ? own->height : whole_height_;
    }
    processor_->add_image(std::exchange(own, nullptr));
  }

  const Recording& recording_;
  Processor* processor_;
  std::mutex mutex_;
  FrameAccounting accounting_;
  struct Origin {
    std::size_t frame = 0;  // of the recording
    TimeNs arrival_ns = 0;
  };
  std::map<const sensor_msgs::Image*, Origin> frames_;
  std::uint32_t whole_width_ = 0, whole_height_ = 0;
};

Processor::Environment environment_of(const ReplayOptions& options, std::function<TimeNs()> clock,
                                      std::function<TimeNs()> steady_clock, std::atomic<std::size_t>* log_lines) {
  Processor::Environment environment;
  environment.clock = std::move(clock);
  environment.steady_clock = std::move(steady_clock);
  environment.log = [log_lines](LogLevel, const std::string&) { ++*log_lines; };
  environment.exposure_expected = [] { return true; };
  environment.request = [&options] { return options.request; };
  environment.make_engine = options.make_engine;
  return environment;
}

}  // namespace

ReplayResult replay(const Recording& recording, const std::vector<Delivery>& deliveries, const ReplayOptions& options) {
  ReplayResult result;
  TimeNs clock_ns = 0, steady_ns = 0;
  std::atomic<std::size_t> log_lines{0};
  Processor processor(environment_of(
      options, [&clock_ns] { return clock_ns; }, [&steady_ns] { return steady_ns; }, &log_lines));
  processor.set_config(options.config);
  Deliverer deliverer(recording, &processor);

  TimeNs busy_until_ns = 0;
  const Processor::Sink sink = [&](FrameOutput&& output) {
    deliverer.take(output, &result);
    const TimeNs processing_ns = output.reason == PassThroughReason::NONE ? options.processing_ns : 0;
    result.latencies_periods.push_back(static_cast<double>(steady_ns + processing_ns - deliverer.arrival_ns(output)) /
                                       static_cast<double>(recording.frame_period_ns()));
    if (processing_ns == 0) return true;
    busy_until_ns = steady_ns + processing_ns;
    return false;
  };
  for (const Delivery& delivery : deliveries) {
    clock_ns = delivery.clock_ns;
    steady_ns = delivery.at_ns;
    deliverer.deliver(delivery);
    result.peak_waiting = std::max(result.peak_waiting, processor.waiting());
    if (processor.waiting() > 0 && steady_ns >= busy_until_ns) processor.advance(sink);
  }
  do {
    processor.finish(sink);
  } while (processor.waiting() > 0);
  std::sort(result.latencies_periods.begin(), result.latencies_periods.end());
  result.balance = deliverer.balance();
  result.statistics = processor.statistics();
  result.log_lines = log_lines;
  return result;
}

ReplayResult replay_live(const Recording& recording, const std::vector<Delivery>& deliveries,
                         const ReplayOptions& options) {
  ReplayResult result;
  const TimeNs begin_ns = deliveries.front().at_ns, end_ns = deliveries.back().at_ns + 1;
  std::atomic<std::size_t> log_lines{0};
  const LiveClock clock(begin_ns);
  const auto now = [&clock] { return clock.now(); };
  Processor processor(environment_of(options, now, now, &log_lines));
  processor.set_config(options.config);
  Deliverer deliverer(recording, &processor);
  play_live(
      deliveries, end_ns - begin_ns, end_ns, clock,
      [&deliverer](const Delivery& delivery, TimeNs) { deliverer.deliver(delivery); }, &processor,
      [&](FrameOutput&& output) {
        result.peak_waiting = std::max(result.peak_waiting, processor.waiting());
        deliverer.take(output, &result);
        return true;
      });
  result.balance = deliverer.balance();
  result.statistics = processor.statistics();
  result.log_lines = log_lines;
  return result;
}

ReplayResult replay_on_threads(const Recording& recording, const std::vector<Delivery>& deliveries,
                               const ReplayOptions& options, double deliver_part, std::uint64_t seed) {
  ReplayResult result;
  std::atomic<TimeNs> clock_ns{deliveries.front().clock_ns};
  std::atomic<std::size_t> log_lines{0};
  const auto clock = [&clock_ns] { return clock_ns.load(); };
  Processor processor(environment_of(options, clock, clock, &log_lines));
  processor.set_config(options.config);
  Deliverer deliverer(recording, &processor);

  std::atomic<bool> stop{false};
  std::vector<std::thread> feeders;
  for (const Stream stream : {Stream::IMU, Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE}) {
    feeders.emplace_back([&, stream] {
      std::vector<const Delivery*> own;
      for (const Delivery& delivery : deliveries) {
        if (stream_of(delivery) == stream) own.push_back(&delivery);
      }
      own.resize(static_cast<std::size_t>(std::ceil(deliver_part * static_cast<double>(own.size()))));
      for (const Delivery* delivery : own) {
        deliverer.deliver(*delivery);
        if (stream == Stream::IMAGE) clock_ns = delivery->clock_ns;
      }
    });
  }
  std::thread worker([&] {
    while (!stop) {
      processor.advance([&](FrameOutput&& output) {
        deliverer.take(output, &result);
        return !stop;
      });
      std::this_thread::yield();
    }
  });
  std::thread owner([&] {
    for (std::uint64_t i = 0; !stop; ++i) {
      try {
        processor.set_config(random_change(options.config, seed + i));
      } catch (const OptionError&) {
        // Some are meant to be refused.
      }
      processor.statistics();
      if (i % 50 == 49) processor.reset();
      std::this_thread::yield();
    }
  });
  for (std::thread& feeder : feeders) feeder.join();
  stop = true;
  worker.join();
  owner.join();
  processor.finish([&](FrameOutput&& output) {
    deliverer.take(output, &result);
    return true;
  });
  result.balance = deliverer.balance();
  result.statistics = processor.statistics();
  result.log_lines = log_lines;
  return result;
}

Config random_change(const Config& config, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  const auto pick = [&random](int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); };
  Config changed = config;
  switch (pick(0, 6)) {
    case 0:
      changed.pipeline.filter.noise_to_signal_ratio = 0.001 * pick(1, 100);
      break;
    case 1:
      changed.pipeline.blur_field.block_size_px = 2 * pick(3, 64);  // 6 is refused
      break;
    case 2:
      changed.pipeline.blur_field.min_extent_px = pick(0, 5);  // 0 is refused
      break;
    case 3:
      changed.pipeline.validation.rule = pick(0, 1) == 1 ? ValidationRule::LIKELIHOOD : ValidationRule::NONE;
      break;
    case 4:
      changed.pipeline.keypoints.max_keypoints = pick(1, 500);
      break;
    case 5:
      changed.pipeline.keypoints.detector = pick(0, 1) == 1 ? "ORB" : "nonsense";
      break;
    default:
      changed.pipeline.validation.false_accept_rate = 0.01 * pick(0, 50);  // 0 is refused
      break;
  }
  return changed;
}

}  // namespace gyro_deblur::test
