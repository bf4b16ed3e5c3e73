// Exposure times of rows, and the frame period.
#include "gyro_deblur/exposure.hpp"

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/format.hpp"
#include "base/median.hpp"
#include "motion/shutter_table.hpp"

namespace gyro_deblur {
namespace {

static_assert(static_cast<int>(StampRow::FIRST) == 0 && static_cast<int>(StampRow::MIDDLE) == 1 &&
                  static_cast<int>(StampRow::LAST) == 2 && static_cast<int>(StampPhase::START) == 0 &&
                  static_cast<int>(StampPhase::MIDDLE) == 1 && static_cast<int>(StampPhase::END) == 2 &&
                  static_cast<int>(RectifyTo::FIRST_ROW) == 0 && static_cast<int>(RectifyTo::MIDDLE_ROW) == 1 &&
                  static_cast<int>(RectifyTo::LAST_ROW) == 2,
              "halves of an image, or of an exposure");

/// Row, in pixels, that a stamp refers to.
double row_of(StampRow row, int rows) { return 0.5 * static_cast<int>(row) * (rows - 1); }

/// Part of the exposure that has passed.
double fraction_of(StampPhase phase) { return 0.5 * static_cast<int>(phase); }

TimeNs row_offset_ns(const ShutterTiming& timing, double y, int rows) {
  return std::llround(static_cast<double>(timing.readout_ns) * y / rows);
}

TimeNs phase_offset_ns(const ShutterTiming& timing, StampPhase phase) {
  return std::llround(static_cast<double>(timing.exposure_ns) * fraction_of(phase));
}

void require_within_period(const char* name, TimeNs time_ns, TimeNs frame_period_ns, double tolerance) {
  const double time_s = std::abs(to_seconds(time_ns)), period_s = to_seconds(frame_period_ns);
  if (time_s <= (1 + tolerance) * period_s) return;
  throw OptionError(format("%s = %g s is longer than the frame period %g s: is its unit right?", name,
                           to_seconds(time_ns), period_s));
}

/// The unit that was probably meant, for a time beyond a limit of some seconds.
std::string unit_hint(double value_s, double max_s) {
  for (const auto& [unit, per_second] : {std::pair{"milliseconds", 1e3}, std::pair{"microseconds", 1e6}}) {
    if (std::abs(value_s) > 1 && std::abs(value_s) / per_second <= max_s)
      return std::string(": is it in ") + unit + "?";
  }
  return {};
}

/// Of a frame period. The longest span makes the tolerance a tenth; there are more than as many of them among the
/// frames that are kept, so that the median shows it.
constexpr std::size_t kShortestSpan = 2, kLongestSpan = 30, kKeptFrames = 75, kFewestFrames = 6;
/// One period of scatter over a span of n makes the estimate 1 / n too short, for which a tolerance of 2 / n would do.
/// Three are a tenth at the longest span, and allow for frames that wait for their stamps in a queue of three.
constexpr double kScatterFrames = 3;

}  // namespace

void ShutterTiming::validate() const {
  for_each_parameter(*this, [](const Row& row, const auto& value) {
    try {
      require_allowed(row, value);
    } catch (const OptionError& error) {
      if constexpr (std::is_same_v<decltype(value), const TimeNs&>) {
        throw OptionError(error.what() + unit_hint(to_seconds(value), row.limits->max));
      }
      throw;
    }
  });
}

void require_plausible_readout(const char* name, TimeNs readout_ns, TimeNs frame_period_ns) {
  require_within_period(name, readout_ns, frame_period_ns, 0.1);
}

void FramePeriod::add(TimeNs stamp_ns) {
  int resets = 0;
  if (!stamps_.empty()) {
    resets = stamps_.back().resets;
    // Scatter takes a stamp back by less.
    const std::optional<TimeNs> period_ns = estimate();
    if (stamp_ns < (period_ns ? stamps_.back().t_ns - *period_ns : stamps_.front().t_ns)) ++resets;
  }
  stamps_.push_back({stamp_ns, resets});
  if (stamps_.size() > kKeptFrames) stamps_.pop_front();
}

std::size_t FramePeriod::span() const {
  return std::max(2 * (stamps_.size() * kLongestSpan / kKeptFrames / 2), kShortestSpan);
}

std::optional<TimeNs> FramePeriod::get() const { return stamps_.size() < kFewestFrames ? std::nullopt : estimate(); }

std::optional<TimeNs> FramePeriod::newest_interval() const {
  constexpr std::size_t kIntervals = 5;
  std::vector<TimeNs> intervals_ns;
  for (std::size_t i = stamps_.size(); i-- > 1 && intervals_ns.size() < kIntervals;) {
    if (stamps_[i].resets == stamps_[i - 1].resets) intervals_ns.push_back(stamps_[i].t_ns - stamps_[i - 1].t_ns);
  }
  if (intervals_ns.size() < kIntervals) return std::nullopt;
  return median(std::move(intervals_ns));
}

std::optional<TimeNs> FramePeriod::estimate() const {
  std::vector<TimeNs> periods_ns;
  const std::size_t n = span();
  for (std::size_t i = n; i < stamps_.size(); ++i) {
    const Stamp &from = stamps_[i - n], &to = stamps_[i];
    const TimeNs period_ns = (to.t_ns - from.t_ns) / static_cast<TimeNs>(n);
    if (from.resets == to.resets && period_ns > 0) periods_ns.push_back(period_ns);
  }
  if (periods_ns.empty()) return std::nullopt;
  return median(std::move(periods_ns));
}

void FramePeriod::require_plausible_readout(const char* name, TimeNs readout_ns) const {
  const std::optional<TimeNs> period_ns = get();
  if (!period_ns || static_cast<double>(span()) <= kScatterFrames) return;
  require_within_period(name, readout_ns, *period_ns, kScatterFrames / static_cast<double>(span()));
}

void FramePeriod::require_plausible_exposure(const char* name, TimeNs exposure_ns) const {
  // Of bursts of up to three frames, four frames are of two bursts, and seven show a period.
  constexpr std::size_t kFewestFramesOfMean = 4, kFewestFramesOfMedian = 7;
  TimeNs period_ns = 0;
  if (stamps_.size() < kFewestFramesOfMean) return;
  if (stamps_.size() >= kFewestFramesOfMedian) {
    period_ns = std::max(get().value_or(0), newest_interval().value_or(0));
  } else if (stamps_.front().resets == stamps_.back().resets) {
    period_ns = (stamps_.back().t_ns - stamps_.front().t_ns) / static_cast<TimeNs>(stamps_.size() - 1);
  }
  if (period_ns <= 0) return;
  require_within_period(name, exposure_ns, period_ns, kScatterFrames / static_cast<double>(span()));
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

RowExposure RowExposure::with_exposure(TimeNs exposure_ns) const {
  ShutterTiming timing = timing_;
  timing.exposure_ns = exposure_ns;
  return {stamp_ns_, rows_, timing};
}

TimeRange RowExposure::frame() const {
  const double last = rows_ - 1;
  return {std::min(start(0), start(last)), std::max(end(0), end(last))};
}

TimeNs RowExposure::reference_time(RectifyTo rectify_to) const {
  if (rectify_to == RectifyTo::STAMP) return stamp_ns_;
  return middle(row_of(static_cast<StampRow>(rectify_to), rows_));
}

}  // namespace gyro_deblur
