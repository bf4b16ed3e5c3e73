// How well each number of a calibration is known, in words.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "tools/footage_calibration.hpp"

namespace gyro_deblur {

enum class VerdictState {
  KNOWN,
  GIVEN,  ///< not estimated, or confirmed
  OPEN,   ///< the footage does not determine it
};

/// "known", "given" or "not determined". Never null.
const char* to_string(VerdictState state);

struct Verdict {
  std::string key;    ///< of config/default.yaml
  std::string value;  ///< with its unit and standard deviation; empty: there is none
  VerdictState state = VerdictState::OPEN;
  std::string text;  ///< how well it is known and from what, or why it is not, and what to do
};

/// Of time_offset, readout_time, exposure_time, gyro_bias and R_cam_imu, in this order.
/// @param frames  of the footage, from which `found` was estimated
std::vector<Verdict> verdicts_of(const FootageCalibration& found, std::size_t frames);

}  // namespace gyro_deblur
