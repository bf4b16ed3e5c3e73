// Detects stamps that go back, and counts the resets of time.
#include "sync/time_jump.hpp"

#include <algorithm>

namespace gyro_deblur {
namespace {

/// Messages that may be in flight in subscription queues when time is reset, with a margin: images and what comes with
/// them by tens, IMU samples and readings of the clock by hundreds or thousands.
int straggler_limit(Stream stream) { return stream == Stream::CLOCK ? 5000 : stream == Stream::IMU ? 1000 : 30; }

/// A late camera_info or exposure is no evidence of a time jump. Its image is.
bool detects_resets(Stream stream) { return stream != Stream::CAMERA_INFO && stream != Stream::EXPOSURE; }

}  // namespace

const char* to_string(Stream stream) {
  static constexpr std::array<const char*, kStreams> kNames{"imu", "image", "camera_info", "exposure", "clock"};
  return kNames[static_cast<std::size_t>(stream)];
}

TimeJumpDetector::Result TimeJumpDetector::update(Stream stream, TimeNs stamp_ns, std::size_t messages) {
  State& own = state(stream);
  if (own.rule.add({stamp_ns}, limits_).reset) return note_reset(stream);
  own.stragglers_left -= static_cast<int>(std::min(messages, static_cast<std::size_t>(own.stragglers_left)));
  return Result::FORWARD;
}

TimeJumpDetector::Result TimeJumpDetector::went_back(Stream stream, TimeNs stamp_ns) {
  state(stream).rule.restart({stamp_ns});
  return note_reset(stream);
}

TimeJumpDetector::Result TimeJumpDetector::note_reset(Stream stream) {
  State& own = state(stream);
  const bool known = own.stragglers_left > 0;
  own.stragglers_left = 0;
  if (known) return Result::FOLLOWS;
  if (!detects_resets(stream)) return Result::FORWARD;
  for (std::size_t i = 0; i < kStreams; ++i) {
    const auto other = static_cast<Stream>(i);
    // A stream that has not started yet has nothing old to bring.
    if (other != stream && newest_ns(other)) state(other).stragglers_left = straggler_limit(other);
  }
  return Result::JUMP;
}

int EpochCounter::next(TimeNs stamp_ns) {
  if (last_ns_ && stamp_ns < *last_ns_) ++epoch_;
  if (newest_ns_ && stamp_ns > *newest_ns_) begun_ = epoch_;
  last_ns_ = stamp_ns;
  newest_ns_ = newest_ns_ ? std::max(*newest_ns_, stamp_ns) : stamp_ns;
  return epoch_;
}

int EpochCounter::reset(ShownBy shown_by) {
  if (shown_by == ShownBy::ITSELF || epoch_ == begun_) {
    ++epoch_;
    last_ns_.reset();
  }
  begun_ = epoch_;
  newest_ns_ = last_ns_;
  return epoch_;
}

}  // namespace gyro_deblur
