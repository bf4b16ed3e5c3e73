// Reports images that repeat the picture before.
#include "ros/repetition_watch.hpp"

#include <algorithm>
#include <cstddef>
#include <string>

#include <Eigen/Geometry>

#include "base/format.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

constexpr char kRepeatedPictures[] = "repeated pictures";
/// Fewer repeated images do no harm.
constexpr std::size_t kReported = 3;
constexpr TimeNs kWatchedNs = 5'000'000'000;
/// An unknown bias is smaller than this rate, and noise moves the scene by less than this shift.
constexpr double kLeastRateRadS = 0.1, kLeastShiftPx = 1;
constexpr TimeNs kLongestRotationNs = 1'000'000'000;

/// Whether the image's scene has moved since its picture was exposed, as far as samples reach.
bool has_rotated(const PendingFrame& frame, const GyroReader& gyro, const GyroOptions& options) {
  if (!frame.calibration || frame.lens == Lens::UNKNOWN) return false;
  TimeRange range_cam{std::max(frame.picture_ns(), frame.stamp_ns - kLongestRotationNs), frame.stamp_ns};
  const TimeNs offset_ns = options.time_offset_ns;
  range_cam.end_ns = std::min(range_cam.end_ns, gyro.available().end_ns - offset_ns);
  if (range_cam.begin_ns >= range_cam.end_ns) return false;
  const RotationTrack track(gyro.window({range_cam.begin_ns + offset_ns, range_cam.end_ns + offset_ns}), options,
                            Eigen::Matrix3d::Identity());
  if (!track.covers(range_cam)) return false;
  const double rotated_rad = Eigen::AngleAxisd(track.rotation(range_cam.begin_ns, range_cam.end_ns)).angle();
  return rotated_rad >= kLeastRateRadS * to_seconds(range_cam.end_ns - range_cam.begin_ns) &&
         rotated_rad * frame.calibration->fx_px >= kLeastShiftPx;
}

}  // namespace

void RepetitionWatch::add(const PendingFrame& frame, const GyroReader& gyro, const GyroOptions& options,
                          std::size_t repeated, std::size_t images) {
  const bool reported = proven_ns_.size() >= kReported;
  while (!proven_ns_.empty() &&
         (proven_ns_.front() > frame.stamp_ns || frame.stamp_ns - proven_ns_.front() > kWatchedNs)) {
    proven_ns_.pop_front();
  }
  if (reported && proven_ns_.empty()) problems_.resolve(kRepeatedPictures);
  if (!frame.repeats || !has_rotated(frame, gyro, options)) return;
  proven_ns_.push_back(frame.stamp_ns);
  if (proven_ns_.size() < kReported) return;
  problems_.report(kRepeatedPictures,
                   std::to_string(repeated) + " of " + std::to_string(images) +
                       " images repeat the picture before under a new stamp although the camera rotates, the one of " +
                       seconds_text(frame.stamp_ns) + " s that of " + seconds_text(frame.picture_ns()) +
                       " s: they are deblurred as that picture, and there is no optical flow across them. If the "
                       "camera has stopped or sees nothing, restart or uncover it; else let its driver publish "
                       "every picture once");
}

}  // namespace gyro_deblur
