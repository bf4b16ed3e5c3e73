// Name, log level and remedy of each reason.
#include "sync/pass_through.hpp"

#include <cstddef>

namespace gyro_deblur {
namespace {

struct Row {
  PassThroughReason reason;
  const char* name;
  LogLevel level;
  const char* remedy;
};

constexpr LogLevel kWarning = LogLevel::WARNING, kError = LogLevel::ERROR;

/// By value.
constexpr Row kRows[] = {
    {PassThroughReason::NONE, "NONE", LogLevel::INFO, ""},
    {PassThroughReason::NO_GYRO, "NO_GYRO", kWarning,
     "check that the IMU publishes, its rate, and time_offset; compare the stamps of image and IMU"},
    {PassThroughReason::NO_EXPOSURE_TIME, "NO_EXPOSURE_TIME", kWarning,
     "set exposure_time, publish an exposure message with the stamp of each image, or move the camera until the "
     "exposure time is estimated from the blur"},
    {PassThroughReason::NO_CALIBRATION, "NO_CALIBRATION", kError,
     "calibrate the camera, and publish camera_info with the stamp and the size of each image or set calibration_file; "
     "if they contradict each other, correct one or set on_calibration_conflict: configured"},
    {PassThroughReason::NO_EXTRINSIC, "NO_EXTRINSIC", kError,
     "set R_cam_imu, publish a static transform between the frames of images and IMU, or rotate the camera about all "
     "axes in front of a static scene until R_cam_imu is estimated; if two of them contradict each other, correct one "
     "or set on_calibration_conflict: configured"},
    {PassThroughReason::UNSUPPORTED_ENCODING, "UNSUPPORTED_ENCODING", kError,
     "set the driver to publish mono8, bgr8, rgb8 or a Bayer encoding"},
    {PassThroughReason::BAD_IMAGE, "BAD_IMAGE", kError,
     "the data of the image does not fit its header: check cable, driver and decoder"},
    {PassThroughReason::BAD_CONFIGURATION, "BAD_CONFIGURATION", kError, "correct the parameter that the message names"},
    {PassThroughReason::OVERLOAD, "OVERLOAD", kWarning,
     "frames arrive faster than they are processed: reduce max_keypoints, use a faster detector (ORB), smaller images "
     "or fewer subscribers"},
    {PassThroughReason::TIME_JUMP, "TIME_JUMP", kError, "expected when a bag loops; otherwise synchronise the clocks"},
    {PassThroughReason::INTERNAL_ERROR, "INTERNAL_ERROR", kError, "see the error in the log"},
    {PassThroughReason::GYRO_SATURATED, "GYRO_SATURATED", kWarning,
     "the camera rotates faster than the gyroscope measures: set a larger range in its driver and in gyro_range"},
    {PassThroughReason::STEREO_PARTNER, "STEREO_PARTNER", kWarning,
     "the other image of the pair is passed through: see its reason, or set stereo_sync_timeout: 0 if the cameras are "
     "no pair"},
    {PassThroughReason::NO_STAMP, "NO_STAMP", kWarning,
     "set the driver to stamp every image with the time of its exposure"},
};

constexpr bool is_in_order() {
  std::size_t value = 0;
  for (const Row& row : kRows) {
    if (static_cast<std::size_t>(row.reason) != value++) return false;
  }
  return true;
}
static_assert(is_in_order());

const Row& row_of(PassThroughReason reason) { return kRows[static_cast<std::size_t>(reason)]; }

}  // namespace

const char* to_string(PassThroughReason reason) { return row_of(reason).name; }

LogLevel level_of(PassThroughReason reason) { return row_of(reason).level; }

const char* remedy(PassThroughReason reason) { return row_of(reason).remedy; }

}  // namespace gyro_deblur
