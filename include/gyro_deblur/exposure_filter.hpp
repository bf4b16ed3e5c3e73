// The exposure time over many images.
#pragma once

#include <optional>

#include "gyro_deblur/exposure_estimate.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Combines the exposure estimates of consecutive images into the exposure time now: a Kalman filter of the logarithm
/// of the exposure. A camera's auto exposure leaves it at rest, lets it glide, or moves it by a jump: a jump is two
/// consecutive estimates on the same side of the state that agree with each other. One alone is an outlier.
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
  /// Exposure at the last image; nothing before images told it, after reset(), and where they have not for so long that
  /// it may be off by more than a quarter (one standard deviation).
  std::optional<State> state() const;

  /// Whether the next image should be looked at. Not where the exposure is known well and was confirmed a few images
  /// ago: a change is then found a few images later, or at once where the brightness changes.
  bool wants_estimate() const;

  /// Forgets everything: after a time jump, or for another camera.
  void reset();

 private:
  /// Logarithm of an exposure [ns].
  struct Value {
    double log_ns, variance;
    TimeNs stamp_ns;
  };
  bool follows_candidate(const Value& measured) const;
  double variance_now() const;
  void update(const Value& measured);
  void jump(const Value& measured);

  std::optional<Value> value_;          // of the last update
  std::optional<Value> candidate_;      // an estimate that contradicts it, or the first one
  std::optional<TimeNs> stamp_ns_;      // of the last image
  double speed_per_s_ = 0;              // at which log_ns may be moving
  double darkest_ = 0, brightest_ = 0;  // logarithms of the mean brightness since value_
  int images_since_ = 0;                // the last update
  int in_vain_ = 0;                     // images in a row that were looked at and told nothing
};

}  // namespace gyro_deblur
