// Tracks of a rolling-shutter camera at one instant.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Takes the tracks of one camera from the middle of their rows' exposures to a reference time, by rotation and
/// residual velocity (PointMotion). Remembers where they were, for their velocities. Not thread-safe.
///
/// A track that was left out comes back under another id: VINS-Mono and VINS-Fusion take the observations of an id to
/// be of consecutive messages.
class TrackRectifier {
 public:
  /// @param tracks        of the image, as FeatureTracker gives them
  /// @param field         of the image
  /// @param motion        of the camera; tracks between whose time and the reference time it is not known are left out,
  ///                      and without a gyroscope those of blocks without a residual velocity
  /// @param exposure      of the image
  /// @param reference_ns  camera clock
  /// @return the tracks with places, covariances and velocities at the reference time. The covariance includes that of
  ///         the residual velocity over the time that the track was moved by. A track that the call before did not
  ///         return, or returned for no earlier time, keeps its velocity.
  std::vector<Track> rectify(const std::vector<Track>& tracks, const FrameBlur& field, const Camera& camera,
                             const CameraMotion& motion, const RowExposure& exposure, TimeNs reference_ns);

 private:
  struct State {
    std::int32_t id;                            // under which it is returned
    std::optional<Eigen::Vector2d> normalized;  // at the newest reference time; nothing: it was left out
  };

  /// Of a track that was in the call before, or is new.
  State state_before(std::int32_t tracker_id) const;

  /// Of a track that is left out.
  State left_out(const State& before);

  TimeNs newest_ns_ = 0;                  // of the newest reference time
  std::map<std::int32_t, State> states_;  // by the tracker's id, of the newest call
  std::int32_t next_id_ = kTrackerIds;
};

}  // namespace gyro_deblur
