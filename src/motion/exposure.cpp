#include "gyro_deblur/exposure.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <vector>

#include "base/median.hpp"

namespace gyro_deblur {
namespace {

/// Row, in pixels, that a stamp refers to.
double row_of(StampRow row, int rows) {
  switch (row) {
    case StampRow::FIRST:
      return 0;
    case StampRow::MIDDLE:
      return 0.5 * (rows - 1);
    case StampRow::LAST:
      return rows - 1;
  }
  return 0;
}

/// Part of the exposure that has passed.
double fraction_of(StampPhase phase) {
  switch (phase) {
    case StampPhase::START:
      return 0;
    case StampPhase::MIDDLE:
      return 0.5;
    case StampPhase::END:
      return 1;
  }
  return 0;
}

TimeNs row_offset_ns(const ShutterTiming& timing, double y, int rows) {
  return std::llround(static_cast<double>(timing.readout_ns) * y / rows);
}

TimeNs phase_offset_ns(const ShutterTiming& timing, StampPhase phase) {
  return std::llround(static_cast<double>(timing.exposure_ns) * fraction_of(phase));
}

}  // namespace

void require_plausible_readout(const char* name, TimeNs readout_ns, TimeNs frame_period_ns) {
  constexpr double kJitter = 0.1;  // of the period; drivers that stamp on arrival scatter by some milliseconds
  const double readout_s = std::abs(to_seconds(readout_ns)), period_s = to_seconds(frame_period_ns);
  if (readout_s <= (1 + kJitter) * period_s) return;
  std::ostringstream text;
  text << name << " = " << to_seconds(readout_ns) << " s is longer than the frame period " << period_s
       << " s: is its unit right?";
  throw OptionError(text.str());
}

void FramePeriod::add(TimeNs stamp_ns) {
  constexpr std::size_t kKept = 15;
  if (last_stamp_ns_ && stamp_ns > *last_stamp_ns_) {
    intervals_ns_.push_back(stamp_ns - *last_stamp_ns_);
    if (intervals_ns_.size() > kKept) intervals_ns_.pop_front();
  }
  last_stamp_ns_ = stamp_ns;
}

void FramePeriod::clear() { *this = FramePeriod(); }

std::optional<TimeNs> FramePeriod::get() const {
  constexpr std::size_t kEnough = 5;
  if (intervals_ns_.size() < kEnough) return std::nullopt;
  return median(std::vector<TimeNs>(intervals_ns_.begin(), intervals_ns_.end()));
}

RowExposure::RowExposure(TimeNs stamp_ns, int rows, const ShutterTiming& timing)
    : stamp_ns_(stamp_ns), rows_(rows), timing_(timing) {
  timing.validate();
  if (rows < 1) throw OptionError("rows = " + std::to_string(rows) + " of an image must be at least 1");
  first_row_start_ns_ = stamp_ns - row_offset_ns(timing, row_of(timing.stamp_row, rows), rows) -
                        phase_offset_ns(timing, timing.stamp_phase);
}

TimeNs RowExposure::start(double y) const { return first_row_start_ns_ + row_offset_ns(timing_, y, rows_); }

TimeNs RowExposure::middle(double y) const { return start(y) + phase_offset_ns(timing_, StampPhase::MIDDLE); }

TimeNs RowExposure::end(double y) const { return start(y) + timing_.exposure_ns; }

TimeRange RowExposure::frame() const {
  const double last = rows_ - 1;
  return {std::min(start(0), start(last)), std::max(end(0), end(last))};
}

TimeNs RowExposure::reference_time(RectifyTo rectify_to) const {
  switch (rectify_to) {
    case RectifyTo::FIRST_ROW:
      return middle(row_of(StampRow::FIRST, rows_));
    case RectifyTo::MIDDLE_ROW:
      return middle(row_of(StampRow::MIDDLE, rows_));
    case RectifyTo::LAST_ROW:
      return middle(row_of(StampRow::LAST, rows_));
    case RectifyTo::STAMP:
      return stamp_ns_;
  }
  return stamp_ns_;
}

}  // namespace gyro_deblur
