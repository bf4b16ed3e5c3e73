#include "gyro_deblur/types.hpp"

#include <cmath>

namespace gyro_deblur {

TimeNs to_ns(double seconds) {
  // Whole seconds apart: for stamps since 1970 the product seconds * 1e9 alone would lose up to 128 ns.
  const double whole = std::floor(seconds);
  return static_cast<TimeNs>(whole) * 1'000'000'000 + std::llround((seconds - whole) * 1e9);
}

double to_seconds(TimeNs ns) { return static_cast<double>(ns) / 1e9; }

const char* to_string(BlockStatus status) {
  switch (status) {
    case BlockStatus::SHARP:
      return "SHARP";
    case BlockStatus::DEBLURRED:
      return "DEBLURRED";
    case BlockStatus::REJECTED:
      return "REJECTED";
    case BlockStatus::TOO_LARGE:
      return "TOO_LARGE";
    case BlockStatus::NO_GYRO:
      return "NO_GYRO";
    case BlockStatus::BENT:
      return "BENT";
  }
  return "UNKNOWN";
}

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
  }
  return "UNKNOWN";
}

}  // namespace gyro_deblur
