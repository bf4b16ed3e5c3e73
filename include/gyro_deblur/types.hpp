// Basic vocabulary shared by every other header: time, gyroscope samples and the verdicts a frame can get.
#pragma once

#include <cstdint>

#include <Eigen/Core>

namespace gyro_deblur {

/// Time in integer nanoseconds. Which clock (camera or IMU) is part of the variable's documentation.
using TimeNs = std::int64_t;

/// Seconds to nanoseconds, rounded to nearest. Precondition: |seconds| < 9.2e9.
TimeNs to_ns(double seconds);
/// Nanoseconds to seconds (exact to about 1e-16 relative).
double to_seconds(TimeNs ns);

/// One gyroscope reading: body rate of the IMU frame [rad/s] at an instant of the IMU clock.
struct GyroSample {
  TimeNs t_ns = 0;
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();
};

/// Closed interval [begin_ns, end_ns] of one clock; empty when begin_ns > end_ns.
struct TimeRange {
  TimeNs begin_ns = 0;
  TimeNs end_ns = -1;

  bool empty() const { return begin_ns > end_ns; }
  bool contains(TimeNs t_ns) const { return begin_ns <= t_ns && t_ns <= end_ns; }
  bool contains(const TimeRange& other) const {
    return !other.empty() && contains(other.begin_ns) && contains(other.end_ns);
  }
};

/// What became of one block of the image. Values equal the constants of gyro_deblur/BlurField.msg.
enum class BlockStatus : std::uint8_t {
  SHARP = 0,      ///< extent below min_extent_px: copied unchanged
  DEBLURRED = 1,  ///< deconvolved (before validation: to be deconvolved)
  REJECTED = 2,   ///< the image contradicts the predicted blur: copied unchanged, keypoints not rectified
  TOO_LARGE = 3,  ///< extent above max_extent_px: copied unchanged
  NO_GYRO = 4,    ///< no usable gyroscope samples for this block's exposure: copied unchanged
  BENT = 5,       ///< the path leaves a straight line by more than max_bend and 2 % of the extent: copied unchanged
};

/// Why a whole frame was passed through unchanged. Values equal the constants of gyro_deblur/BlurField.msg.
enum class PassThroughReason : std::uint8_t {
  NONE = 0,                  ///< processed; the blocks' statuses say what happened where
  NO_GYRO = 1,               ///< no block's exposure is covered by gyroscope samples
  NO_EXPOSURE_TIME = 2,      ///< neither message nor parameter gave one
  NO_CALIBRATION = 3,        ///< camera_info absent, or unusable (zero K, unknown model, other size)
  NO_EXTRINSIC = 4,          ///< neither tf nor parameter gave the rotation between IMU and camera
  UNSUPPORTED_ENCODING = 5,  ///< pixel format that cannot be deblurred
  BAD_IMAGE = 6,             ///< empty, or its buffer does not fit its header
  BAD_CONFIGURATION = 7,     ///< a parameter is out of range
  OVERLOAD = 8,              ///< the frame queue was full
  TIME_JUMP = 9,             ///< the clock was reset while the frame waited
  INTERNAL_ERROR = 10,       ///< an exception while processing; the log has its text
  GYRO_SATURATED = 11,       ///< no block's exposure is free of samples at the gyroscope's limit
};

/// Name of the status, e.g. "DEBLURRED". Never null.
const char* to_string(BlockStatus status);
/// Name of the reason, e.g. "NO_GYRO". Never null.
const char* to_string(PassThroughReason reason);

}  // namespace gyro_deblur
