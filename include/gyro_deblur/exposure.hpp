// When each row of a frame was exposed (paper section III-C).
#pragma once

#include <deque>
#include <optional>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The image row and the phase of its exposure that a driver's stamp refers to. FIRST is row y = 0 of the image and
/// LAST row N - 1, whichever way the sensor is read.
enum class StampRow { FIRST, MIDDLE, LAST };
enum class StampPhase { START, MIDDLE, END };

/// Timing of one camera.
struct ShutterTiming {
  TimeNs exposure_ns = 0;  ///< t_e, > 0
  TimeNs readout_ns = 0;   ///< t_r: from the first to one past the last row; negative: bottom-up; 0: global
  StampRow stamp_row = StampRow::FIRST;
  StampPhase stamp_phase = StampPhase::START;

  void validate() const;  ///< throws OptionError
};

/// Throws OptionError "NAME = ... s is longer than the frame period ..." when rows would still be read while the next
/// frame is: a wrong unit, most likely. Jitter of stamps is allowed for.
/// @param frame_period_ns  > 0
void require_plausible_readout(const char* name, TimeNs readout_ns, TimeNs frame_period_ns);

/// The time from frame to frame, from the stamps as they come. Lost frames and single bad stamps do not disturb it.
class FramePeriod {
 public:
  void add(TimeNs stamp_ns);
  void clear();
  /// Median of the last intervals [ns], > 0; nothing before there are enough of them.
  std::optional<TimeNs> get() const;

 private:
  std::optional<TimeNs> last_stamp_ns_;
  std::deque<TimeNs> intervals_ns_;
};

/// Exposure of the rows of one frame, in the camera clock: row y of N is exposed from
/// t1(y) = t_f + t_r y / N to t2(y) = t1(y) + t_e.
class RowExposure {
 public:
  /// @param stamp_ns  the image's stamp, camera clock
  /// @param rows      N >= 1
  /// Throws OptionError for bad timing.
  RowExposure(TimeNs stamp_ns, int rows, const ShutterTiming& timing);

  /// y in pixels, may be fractional; 0 is the centre of the first row. Rows outside the image follow the same line.
  TimeNs start(double y) const;
  TimeNs middle(double y) const;
  TimeNs end(double y) const;

  /// From the first start to the last end of any row.
  TimeRange frame() const;

  /// Instant at which rectified coordinates hold: the middle of the exposure of the first, middle ((N - 1) / 2) or last
  /// row, or the stamp itself.
  TimeNs reference_time(RectifyTo rectify_to) const;

  const ShutterTiming& timing() const { return timing_; }

 private:
  TimeNs stamp_ns_;
  int rows_;
  ShutterTiming timing_;
  TimeNs first_row_start_ns_;  // t_f
};

}  // namespace gyro_deblur
