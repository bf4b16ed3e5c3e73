// Which exposure time an image is deblurred by: what a driver's message says, else the parameter, else the images.
#pragma once

#include <cstddef>
#include <optional>

#include "blur/exposure_estimate.hpp"
#include "blur/exposure_filter.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Where an exposure time is from.
enum class ExposureOrigin {
  MESSAGE,    ///< of the image, or of its neighbours
  SETTING,    ///< of the driver; holds for all images
  PARAMETER,  ///< exposure_time
  IMAGES,     ///< their blur
  ASSUMED,    ///< not known: a guess, which blur is compared with
};

/// "exposure message", "driver's setting", "exposure_time", "images" or "not known". Never null.
const char* to_string(ExposureOrigin origin);

/// An exposure time that a message, a setting or the parameter has.
struct GivenExposure {
  ExposureOrigin origin = ExposureOrigin::PARAMETER;
  TimeNs exposure_ns = 0;  ///< > 0
};

/// Larger than this, or smaller than its inverse, is the ratio of an estimate to a given exposure that it contradicts.
/// A front end does not notice less (doc/reports/exposure.md).
constexpr double kContradictingRatio = 1.08;

/// What an image is deblurred by.
struct ChosenExposure {
  ExposureOrigin origin = ExposureOrigin::ASSUMED;  ///< ASSUMED: not known, the image stays as it is
  TimeNs exposure_ns = 0;
  double log_stddev = 0;  ///< of exposure_ns where it is from the images
};

/// Why the blur gives no estimate of the exposure. Never NOTHING.
/// @param contrast, noise  of the image, grey levels
ExposureNeed exposure_need(double contrast, const std::optional<double>& noise, const FrameBlur& field);

/// The exposure that an image is processed with until its blur has been examined.
struct ExposurePlan : ChosenExposure {
  TimeNs longest_ns = 0;  ///< longest time expected of the exposure: gyroscope samples are needed up to there
  TimeNs period_ns = 0;   ///< frame period: no exposure is longer; 0: not known
  bool estimate = false;  ///< it is to be estimated from the blur
  /// Once it has been chosen: nothing changes any more, for images that repeat its picture.
  bool decided = false;
  std::optional<GivenExposure> given;
};

/// Images that contradict a given exposure.
struct ExposureConflict {
  GivenExposure given;
  TimeNs images_ns = 0;  ///< what the images say
  bool replaced = false;

  double ratio() const { return static_cast<double>(images_ns) / static_cast<double>(given.exposure_ns); }
};

/// Decides image by image, in the order of their stamps; one that is late gets what is known. Free of messages and
/// clocks. Not thread-safe.
class ExposureChoice {
 public:
  void set_policy(OnExposureConflict policy);

  /// @param given      nothing: not known
  /// @param period_ns  of the camera's frames, > 0: no exposure is longer; nothing: not known
  ExposurePlan plan(const std::optional<GivenExposure>& given, const std::optional<TimeNs>& period_ns) const;

  /// @param estimate         of this image, where the plan asks for one; nothing: not known
  /// @param mean_brightness  of this image, 0 to 255
  ChosenExposure decide(TimeNs stamp_ns, const ExposurePlan& plan, const std::optional<ExposureEstimate>& estimate,
                        double mean_brightness);

  /// Conflict at the newest image; nothing where the estimate agrees with the given value, or there is none.
  const std::optional<ExposureConflict>& conflict() const { return conflict_; }

  /// Forgets all estimates: after a time jump.
  void reset();

 private:
  const ExposureFilter& filter_of(const std::optional<GivenExposure>& given) const;
  /// The estimate instead; nothing: there is none.
  std::optional<TimeNs> estimate_instead(const GivenExposure& given) const;
  /// Whether the images have replaced it.
  bool replaces(const GivenExposure& given) const;
  /// @param has_estimate  of this image
  void compare(TimeNs stamp_ns, const GivenExposure& given, bool has_estimate);
  void forget_conflict();
  /// By what is given and known now.
  ChosenExposure chosen(const ExposurePlan& plan) const;

  OnExposureConflict policy_ = OnExposureConflict::IMAGES;
  std::optional<TimeNs> newest_ns_;  // of the images with an attempt
  ExposureFilter exposures_;         // of images without a message
  ExposureFilter ratios_;            // of images with one: true over given exposure, times kRatioNs
  std::optional<ExposureConflict> conflict_;
  std::optional<GivenExposure> compared_;  // what conflict_ and since_ns_ are about
  std::optional<TimeNs> since_ns_;         // the images have said otherwise than conflict_
  int estimates_ = 0;                      // that have said so
  int in_vain_ = 0;                        // attempts in a row without an estimate
  std::size_t assumption_ = 0;             // the one to try, counted on
};

}  // namespace gyro_deblur
