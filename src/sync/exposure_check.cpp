// Checks exposure times of messages and parameters.
#include "sync/exposure_check.hpp"

#include "base/format.hpp"
#include "base/require_range.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

struct NeedRow {
  const char *name, *blur;
};

/// In the order of ExposureNeed.
constexpr NeedRow kNeeds[] = {{"", "does not show it: "},
                              {"motion", "is too short to estimate it: rotate the camera faster, or "},
                              {"texture", "shows too little of it: show a scene with more texture, or "},
                              {"light", "is hidden by noise: give the scene more light, or "}};

const NeedRow& need_row(ExposureNeed need) { return kNeeds[static_cast<std::size_t>(need)]; }

}  // namespace

const char* name_of_given(ExposureOrigin origin) {
  return origin == ExposureOrigin::PARAMETER ? "exposure_time"
         : origin == ExposureOrigin::SETTING ? "the driver's exposure setting"
                                             : "the exposure message's exposure_time";
}

std::optional<std::string> exposure_fault(ExposureOrigin origin, TimeNs exposure_ns, const FramePeriod& period) {
  // Sony's Pregius sensors expose for 1 us at least, others for longer. The upper end is that of exposure_time.
  constexpr double kShortestS = 1e-6, kLongestS = 1;
  const char* const name = name_of_given(origin);
  if (origin != ExposureOrigin::PARAMETER) {  // a configuration is checked when it is read
    try {
      require_range(name, to_seconds(exposure_ns), kShortestS, kLongestS, "s");
    } catch (const OptionError& error) {
      return std::string(error.what()) + ": is its unit right (exposure_source)?";
    }
  }
  try {
    period.require_plausible_exposure(name, exposure_ns);
  } catch (const OptionError& error) {
    return std::string(error.what());
  }
  return std::nullopt;
}

std::string conflict_text(const ExposureConflict& conflict) {
  const GivenExposure& given = conflict.given;
  const bool parameter = given.origin == ExposureOrigin::PARAMETER;
  const char* const name =
      given.origin == ExposureOrigin::MESSAGE ? "the exposure message" : name_of_given(given.origin);
  const std::string text =
      format("blur is %.2f times what %s says: %.3g s by %s, %.3g s by the images. ", conflict.ratio(), name,
             to_seconds(given.exposure_ns), name, to_seconds(conflict.images_ns));
  if (!parameter) return text + "The driver's value is used: check exposure_source and its unit";
  return text + (conflict.replaced ? "The images' value is used: correct exposure_time, or leave it empty"
                                   : "exposure_time is used (on_exposure_conflict: configured): correct it, "
                                     "or leave it empty");
}

const char* to_string(ExposureNeed need) { return need_row(need).name; }

std::string unknown_exposure_text(ExposureNeed need) {
  return std::string("the exposure time is not known yet: there is no exposure message, no exposure_time that fits, ") +
         "and the blur " + need_row(need).blur + "set exposure_time";
}

}  // namespace gyro_deblur
