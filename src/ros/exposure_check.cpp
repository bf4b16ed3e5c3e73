#include "ros/exposure_check.hpp"

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {

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

}  // namespace gyro_deblur
