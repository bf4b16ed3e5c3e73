// Plays deliveries into a processor, as a camera and a nodelet's worker would, on a clock of their own.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <vector>

#include "engine/engine.hpp"
#include "frame_accounting.hpp"
#include "gyro_deblur/config.hpp"
#include "recording.hpp"

namespace gyro_deblur::test {

struct ReplayOptions {
  Config config;
  EngineFactory make_engine;  ///< absent: the configured one
  /// Simulated time that processing a frame takes; frames that pass through take none. 0: the worker always keeps up.
  TimeNs processing_ns = 0;
  FrameRequest request;
};

struct ReplayResult {
  Balance balance;
  ProcessorStatistics statistics;
  std::size_t peak_waiting = 0;  ///< frames
  /// From the arrival of each image until its frame has left, in frame periods of the recording; in order of size.
  /// Empty for replay_on_threads, which plays as fast as it can.
  std::vector<double> latencies_periods;
  /// Deblurred frames whose predicted extent at the image's centre is off by more than 1 px and a tenth.
  std::size_t mispredicted = 0;
  std::size_t log_lines = 0;
};

/// One thread; the same for the same deliveries. Every image is a message of its own that nobody else holds.
/// @param recording  the truth that the deliveries come from
ReplayResult replay(const Recording& recording, const std::vector<Delivery>& deliveries, const ReplayOptions& options);

/// The same in real time, with a thread that delivers: every delivery when its at_ns has come. Deliveries at one time
/// keep their order.
ReplayResult replay_live(const Recording& recording, const std::vector<Delivery>& deliveries,
                         const ReplayOptions& options);

/// The same with a thread for each stream, one that takes frames out, and one that changes parameters all the time,
/// as fast as they can.
/// @param deliver_part  in (0, 1]: after this part of each stream everything ends, whatever is at work
ReplayResult replay_on_threads(const Recording& recording, const std::vector<Delivery>& deliveries,
                               const ReplayOptions& options, double deliver_part, std::uint64_t seed);

/// Sets some parameters to values that depend on the seed; some of them are refused.
/// @return a configuration that may or may not be valid
Config random_change(const Config& config, std::uint64_t seed);

}  // namespace gyro_deblur::test
