// Which exposure times of messages and settings can be.
#pragma once

#include <optional>
#include <string>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/time.hpp"
#include "pipeline/exposure_choice.hpp"

namespace gyro_deblur {

/// What an exposure time is of, in messages.
constexpr char kMessageExposure[] = "the exposure message's exposure_time";
constexpr char kSettingExposure[] = "the driver's exposure setting";
constexpr char kParameterExposure[] = "exposure_time";

/// Why an exposure time cannot be one, with the value and what is allowed; nothing where it can be. 0 is not for it to
/// check: drivers mean that they do not know.
/// @param name    one of the above
/// @param period  of the camera's frames
std::optional<std::string> exposure_fault(const std::string& name, TimeNs exposure_ns, const FramePeriod& period);

/// That the blur contradicts an exposure time: both values, what is done, what to do.
std::string conflict_text(const ExposureConflict& conflict);

/// What the images lack for an estimate of the exposure time, e.g. "motion". Never null; empty: nothing.
const char* to_string(ExposureNeed need);

/// Why an exposure time that only the images could give is not known.
std::string unknown_exposure_text(ExposureNeed need);

}  // namespace gyro_deblur
