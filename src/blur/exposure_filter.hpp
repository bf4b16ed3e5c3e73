// The exposure time over many images.
#pragma once

#include <optional>

#include "blur/exposure_estimate.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Combines the exposure estimates of consecutive images into the exposure time now: a Kalman filter of the logarithm
/// of the exposure and, while it moves, of its speed. A camera's auto exposure keeps it constant, changes it steadily,
/// or makes it jump. It moves when two consecutive estimates contradict the state on the same side and agree with each
/// other. One alone is an outlier.
class ExposureFilter {
 public:
  /// One call for each new image, in the order of stamps; an earlier stamp than the last one resets.
  /// @param stamp_ns         of the image
  /// @param assumed_ns       exposure for which the blur field was computed, > 0; it may differ from image to image
  /// @param estimate         of this image; nothing where it was not made, or is not known
  /// @param mean_brightness  mean grey level of this image, 0 to 255; where it changes the exposure may have changed
  void add(TimeNs stamp_ns, TimeNs assumed_ns, const std::optional<ExposureEstimate>& estimate, double mean_brightness);

  struct State {
    TimeNs exposure_ns;  ///< > 0
    double log_stddev;   ///< standard deviation of the natural logarithm of exposure_ns, at the stamp of the last add()
  };
  /// Exposure at the last image; nothing before images gave it, after reset(), and where they have not for so long that
  /// it may be off by more than a quarter (one standard deviation).
  std::optional<State> state() const;

  /// Whether the exposure should be estimated from the next image. Not where the exposure is known well and was
  /// confirmed a few images ago: a change is then found a few images later, or at once where the brightness changes.
  bool wants_estimate() const;

  /// Forgets everything: after a time jump, or for another camera.
  void reset();

 private:
  /// Logarithm of an exposure [ns], and its speed [1/s], 0 of an exposure at rest.
  struct Value {
    TimeNs stamp_ns;
    double log_ns, variance;
    double per_s = 0, speed_variance = 0, covariance = 0;
    bool moves = false;
    int slow_updates = 0;  ///< in a row, of one that moves
  };
  Value predicted() const;
  double extra_variance() const;
  bool follows_candidate(const Value& measured) const;
  void update(const Value& measured);
  void jump(const Value& from, const Value& measured);

  std::optional<Value> value_;          // at the last update
  std::optional<Value> candidate_;      // an estimate that contradicts it, or the first one
  std::optional<TimeNs> stamp_ns_;      // of the last image
  double darkest_ = 0, brightest_ = 0;  // logarithms of the mean brightness since value_
  int images_since_ = 0;                // the last update
  int images_since_look_ = 0;           // the last one with an attempt
  int in_vain_ = 0;                     // attempts in a row without an estimate
};

}  // namespace gyro_deblur
