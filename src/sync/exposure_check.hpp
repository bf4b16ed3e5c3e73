// Which exposure times of messages and settings can be.
#pragma once

#include <optional>
#include <string>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/time.hpp"
#include "pipeline/exposure_choice.hpp"

namespace gyro_deblur {

/// Name of an exposure time in messages. Precondition: it is of a message, a setting or the parameter.
const char* name_of_given(ExposureOrigin origin);

/// Why an exposure time cannot be one, with the value and what is allowed; nothing where it can be. 0 is not for it to
/// check: drivers mean that they do not know.
/// @param origin  as for name_of_given()
/// @param period  of the camera's frames
std::optional<std::string> exposure_fault(ExposureOrigin origin, TimeNs exposure_ns, const FramePeriod& period);

/// That the blur contradicts an exposure time: both values, what is done, what to do.
std::string conflict_text(const ExposureConflict& conflict);

/// What the images lack for an estimate of the exposure time, e.g. "motion". Never null; empty: nothing.
const char* to_string(ExposureNeed need);

/// Why an exposure time that only the images could give is not known.
std::string unknown_exposure_text(ExposureNeed need);

}  // namespace gyro_deblur
