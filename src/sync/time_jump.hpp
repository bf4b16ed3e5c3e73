// Notices that time went backwards: a bag that loops, a simulation or a driver that was restarted.
#pragma once

#include <array>
#include <cstddef>
#include <optional>

#include "gyro_deblur/time.hpp"
#include "sync/timestamp_filter.hpp"

namespace gyro_deblur {

/// What carries time into the node. Each goes back at its own moment when time is reset.
enum class Stream { IMU, IMAGE, CAMERA_INFO, EXPOSURE, CLOCK };
constexpr std::size_t kStreams = static_cast<std::size_t>(Stream::CLOCK) + 1;  // which stays the last

const char* to_string(Stream stream);

/// What shows that time was reset for a stream: its own next message, or another stream.
enum class ShownBy { ITSELF, OTHER };

/// Watches the newest time of every stream. The first stream to go back reports a jump (camera_info and exposures do
/// not: late ones are no reset); the others, whose last old messages may still arrive, then follow it without
/// a second report. A stream that goes on for long without going back has not been reset. Which stamps count is
/// decided by TimestampFilter with watched_stamps.
class TimeJumpDetector {
 public:
  enum class Result {
    FORWARD,  ///< nothing special
    JUMP,     ///< time was reset: everything from before is of another epoch
    FOLLOWS,  ///< this stream now follows a jump that is known already: what it brought before is of another epoch
  };

  /// @param threshold_ns  going back by up to this is not a reset; > 0
  explicit TimeJumpDetector(TimeNs threshold_ns) : limits_(watched_stamps(threshold_ns)) {}

  void set_threshold(TimeNs threshold_ns) { limits_ = watched_stamps(threshold_ns); }

  /// @param messages  that the stream has brought, of which this is the newest
  Result update(Stream stream, TimeNs stamp_ns, std::size_t messages = 1);

  /// The stream went back to `stamp_ns`, as its owner knows by other means.
  Result went_back(Stream stream, TimeNs stamp_ns);

  /// Newest time of the stream since it went back last; nothing before its first message.
  std::optional<TimeNs> newest_ns(Stream stream) const { return state(stream).rule.newest_ns(); }

  /// True while the stream is expected to follow a jump: what it brings is still of the old epoch.
  bool is_stale(Stream stream) const { return state(stream).stragglers_left > 0; }

  void clear() { states_ = {}; }

 private:
  struct Stamp {
    TimeNs t_ns;
  };
  struct State {
    TimestampFilter<Stamp> rule;
    int stragglers_left = 0;  // messages of the old epoch that may still come after a jump
  };
  Result note_reset(Stream stream);
  State& state(Stream stream) { return states_[static_cast<std::size_t>(stream)]; }
  const State& state(Stream stream) const { return states_[static_cast<std::size_t>(stream)]; }

  StampLimits limits_;
  std::array<State, kStreams> states_;
};

/// Separates what a stream brought before time was reset from what it brought after. Recordings that are shorter than
/// the threshold step back by less, so the first messages of the new epoch may come before the reset is sure. A stream
/// that afterwards gets beyond where it stepped back was out of order, and not reset. (No matter for TimestampFilter:
/// all these messages are kept, whatever their stamps; that another stream was reset decides which of them are old.)
class EpochCounter {
 public:
  /// Epoch of a message that has come.
  int next(TimeNs stamp_ns);

  /// Epoch of the last message that has come.
  int current() const { return epoch_; }

  /// Time was reset. Messages of the returned epoch or later are new. None of those that have come is, if the stream
  /// itself shows it, or has not stepped back since the last reset.
  int reset(ShownBy shown_by);

 private:
  std::optional<TimeNs> last_ns_;
  std::optional<TimeNs> newest_ns_;  // since the last reset
  int epoch_ = 0;
  int begun_ = 0;  // up to this epoch no step back speaks for a reset
};

}  // namespace gyro_deblur
