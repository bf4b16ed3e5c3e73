// Why a frame is passed through unchanged.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// Why a whole frame was passed through unchanged. Values equal the constants of gyro_deblur/BlurField.msg.
enum class PassThroughReason : std::uint8_t {
  NONE = 0,                  ///< processed; the blocks' statuses say what happened where
  NO_GYRO = 1,               ///< no block's exposure is covered by gyroscope samples
  NO_EXPOSURE_TIME = 2,      ///< not given, and not estimated yet
  NO_CALIBRATION = 3,        ///< no usable camera_info (zero K, unknown model, other size), or beyond the lens model
  NO_EXTRINSIC = 4,          ///< rotation between IMU and camera not given, and not estimated yet
  UNSUPPORTED_ENCODING = 5,  ///< pixel format that cannot be deblurred
  BAD_IMAGE = 6,             ///< empty, or its buffer does not fit its header
  BAD_CONFIGURATION = 7,     ///< a parameter is out of range
  OVERLOAD = 8,              ///< newer frames were ready, or the frame queue was full
  TIME_JUMP = 9,             ///< the clock was reset while the frame waited
  INTERNAL_ERROR = 10,       ///< an exception while processing; the log has its text
  GYRO_SATURATED = 11,       ///< no block's exposure is free of samples at the gyroscope's limit
  STEREO_PARTNER = 12,       ///< the other image of a stereo pair stays blurred
  NO_STAMP = 13,             ///< the image's stamp is 0: its driver has not set it
};

/// Name of the reason, e.g. "NO_GYRO". Never null.
const char* to_string(PassThroughReason reason);

/// Level of the log line for such a frame.
LogLevel level_of(PassThroughReason reason);

/// What to do about it. Never null.
const char* remedy(PassThroughReason reason);

/// A frame that has to be passed through, with the reason and one line that has the values involved.
class FrameError : public std::runtime_error {
 public:
  FrameError(PassThroughReason reason, const std::string& text) : std::runtime_error(text), reason_(reason) {}
  PassThroughReason reason() const { return reason_; }

 private:
  PassThroughReason reason_;
};

}  // namespace gyro_deblur
