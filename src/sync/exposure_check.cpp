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

NeedRow need_row(ExposureNeed need) {
  switch (need) {
    case ExposureNeed::MOTION:
      return {"motion", "is too short to estimate it: rotate the camera faster, or "};
    case ExposureNeed::TEXTURE:
      return {"texture", "shows too little of it: show a scene with more texture, or "};
    case ExposureNeed::LIGHT:
      return {"light", "is hidden by noise: give the scene more light, or "};
    case ExposureNeed::NOTHING:
      break;
  }
  return {"", "does not show it: "};
}

}  // namespace

std::optional<std::string> exposure_fault(const std::string& name, TimeNs exposure_ns, const FramePeriod& period) {
  // Sony's Pregius sensors expose for 1 us at least, others for longer. The upper end is that of exposure_time.
  constexpr double kShortestS = 1e-6, kLongestS = 1;
  if (name != kParameterExposure) {  // a configuration is checked when it is read
    try {
      require_range(name.c_str(), to_seconds(exposure_ns), kShortestS, kLongestS, "s");
    } catch (const OptionError& error) {
      return std::string(error.what()) + ": is its unit right (exposure_source)?";
    }
  }
  try {
    period.require_plausible_exposure(name.c_str(), exposure_ns);
  } catch (const OptionError& error) {
    return std::string(error.what());
  }
  return std::nullopt;
}

std::string conflict_text(const ExposureConflict& conflict) {
  const GivenExposure& given = conflict.given;
  const bool parameter = given.origin == ExposureOrigin::PARAMETER;
  const std::string name = parameter                                 ? "exposure_time"
                           : given.origin == ExposureOrigin::SETTING ? "the driver's exposure setting"
                                                                     : "the exposure message";
  const std::string text =
      format("blur is %.2f times what %s says: %.3g s by %s, %.3g s by the images. ", conflict.ratio(), name.c_str(),
             to_seconds(given.exposure_ns), name.c_str(), to_seconds(conflict.images_ns));
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
