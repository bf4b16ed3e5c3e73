#include "ros/pass_through.hpp"

namespace gyro_deblur {

const char* to_string(PassThroughReason reason) {
  switch (reason) {
    case PassThroughReason::NONE:
      return "NONE";
    case PassThroughReason::NO_GYRO:
      return "NO_GYRO";
    case PassThroughReason::NO_EXPOSURE_TIME:
      return "NO_EXPOSURE_TIME";
    case PassThroughReason::NO_CALIBRATION:
      return "NO_CALIBRATION";
    case PassThroughReason::NO_EXTRINSIC:
      return "NO_EXTRINSIC";
    case PassThroughReason::UNSUPPORTED_ENCODING:
      return "UNSUPPORTED_ENCODING";
    case PassThroughReason::BAD_IMAGE:
      return "BAD_IMAGE";
    case PassThroughReason::BAD_CONFIGURATION:
      return "BAD_CONFIGURATION";
    case PassThroughReason::OVERLOAD:
      return "OVERLOAD";
    case PassThroughReason::TIME_JUMP:
      return "TIME_JUMP";
    case PassThroughReason::INTERNAL_ERROR:
      return "INTERNAL_ERROR";
    case PassThroughReason::GYRO_SATURATED:
      return "GYRO_SATURATED";
    case PassThroughReason::STEREO_PARTNER:
      return "STEREO_PARTNER";
    case PassThroughReason::NO_STAMP:
      return "NO_STAMP";
  }
  return "UNKNOWN";
}

}  // namespace gyro_deblur
