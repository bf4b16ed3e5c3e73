// Whether footage determines what was estimated from it.
#pragma once

#include <string>
#include <vector>

#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur {

/// Why the estimate should not be used, with the values, what is allowed, and the remedy; empty: nothing speaks against
/// it. Refused are images that do not move as the gyroscope turned (stabilised ones), an offset at the limit of the
/// search, a readout longer than the frame period, and a rotation that is hardly determined.
/// @param options  that the estimate was made with
/// @param period   of the images
std::vector<std::string> timing_objections(const TimingEstimate& estimate, const TimingOptions& options,
                                           const FramePeriod& period);

}  // namespace gyro_deblur
