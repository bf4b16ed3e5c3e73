// When each row of a frame was exposed (paper section III-C).
#pragma once

#include <cstddef>
#include <deque>
#include <optional>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The image row and the phase of its exposure that a driver's stamp refers to. FIRST is row y = 0 of the image and
/// LAST row N - 1, whichever row the sensor reads first. Times are computed from the order of the values.
enum class StampRow { FIRST, MIDDLE, LAST };
enum class StampPhase { START, MIDDLE, END };

/// Timing of one camera.
struct ShutterTiming {
  TimeNs exposure_ns = 0;  ///< t_e, > 0; in a Config 0: not known
  TimeNs readout_ns = 0;   ///< t_r: rows times the time of one row; negative: bottom-up; 0: global
  StampRow stamp_row = StampRow::FIRST;
  StampPhase stamp_phase = StampPhase::START;

  void validate() const;  ///< throws OptionError
};

/// Throws OptionError "NAME = ... s is longer than the frame period ..." when rows would still be read while the next
/// frame is: a wrong unit, most likely.
/// @param frame_period_ns  > 0; the readout may exceed it by a tenth, as data sheets are rounded
void require_plausible_readout(const char* name, TimeNs readout_ns, TimeNs frame_period_ns);

/// The time from frame to frame, from the stamps as they come, which scatter when a driver stamps on arrival. Lost
/// frames make it longer.
class FramePeriod {
 public:
  void add(TimeNs stamp_ns);
  void clear() { stamps_.clear(); }
  /// Frame period [ns], > 0: over the last frames, the median of the time from one to the frame span() later, divided
  /// by span(). Nothing before there are enough frames. A few bad stamps do not disturb it.
  std::optional<TimeNs> get() const;
  /// Throws OptionError as the function does, once enough frames have come to know. However stamps scatter within a
  /// period, a readout that is not longer than the true one passes.
  void require_plausible_readout(const char* name, TimeNs readout_ns) const;
  /// The same of an exposure: an image's ends before the next one's begins. Goes by the longer of the period and the
  /// newest intervals, as a camera that exposes for longer may lower its rate. Until there are enough frames to know a
  /// period to a tenth, only what is far above it is refused.
  void require_plausible_exposure(const char* name, TimeNs exposure_ns) const;

 private:
  std::optional<TimeNs> estimate() const;
  /// Median of the newest intervals; nothing before there are enough of them.
  std::optional<TimeNs> newest_interval() const;
  std::size_t span() const;  // in frames; even, so that pairs of frames with about the same stamp do not matter

  struct Stamp {
    TimeNs t_ns;
    int resets;  // of time, that came before
  };
  std::deque<Stamp> stamps_;
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

  /// From the start of one row to that of the next [ns]; negative: bottom-up; 0: global shutter.
  double row_time_ns() const { return static_cast<double>(timing_.readout_ns) / rows_; }

  /// From the first start to the last end of any row.
  TimeRange frame() const;

  /// Instant at which rectified coordinates hold: the middle of the exposure of the first, middle ((N - 1) / 2) or last
  /// row, or the stamp itself.
  TimeNs reference_time(RectifyTo rectify_to) const;

  const ShutterTiming& timing() const { return timing_; }

  /// The same image had it been exposed for `exposure_ns`: what its stamp refers to stays where it is. Throws
  /// OptionError for a bad exposure.
  RowExposure with_exposure(TimeNs exposure_ns) const;

 private:
  TimeNs stamp_ns_;
  int rows_;
  ShutterTiming timing_;
  TimeNs first_row_start_ns_;  // t_f
};

/// Ratios of true to assumed exposure that are searched.
constexpr double kMinExposureRatio = 0.3, kMaxExposureRatio = 3;

/// How long an image was exposed, compared with the exposure for which its blur field was computed.
struct ExposureEstimate {
  double ratio = 1;       ///< true over assumed exposure, kMinExposureRatio to kMaxExposureRatio
  double log_stddev = 0;  ///< standard deviation of the natural logarithm of the ratio, > 0
};

}  // namespace gyro_deblur
