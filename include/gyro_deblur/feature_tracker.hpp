// Corners followed from image to image, through blur: predicted by the gyroscope, found by aligning patches that have
// each been blurred by the path of the other.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Integers below are exact in a float, which is what carries ids in sensor_msgs/PointCloud.
constexpr std::int32_t kTrackIds = 1 << 24;
/// A tracker's are below. TrackRectifier gives those above to tracks that come back.
constexpr std::int32_t kTrackerIds = kTrackIds / 2;

/// One corner in the newest image.
struct Track {
  std::int32_t id = 0;                                     ///< the same in every image; [0, kTrackIds)
  int length = 1;                                          ///< images in which it was seen, this one included
  Eigen::Vector2d pixel_px = Eigen::Vector2d::Zero();      ///< where it was at the middle of its row's exposure
  Eigen::Vector2d normalized = Eigen::Vector2d::Zero();    ///< undistorted (x / z, y / z) in the image's frame
  Eigen::Vector2d velocity_1_s = Eigen::Vector2d::Zero();  ///< of `normalized` since the image before; new ones: 0
  /// Of pixel_px, against the scene point that the track began on; 0 in the image in which it began.
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Zero();
};

/// After a longer break nothing is where it was: all tracks are forgotten.
constexpr TimeNs kLongestTrackBreakNs = 1'000'000'000;

class BlurredView;
class CornerDetector;
class TrackSearch;
struct TrackState;

/// Follows corners through the raw images of one camera. Not thread-safe.
///
/// A corner is looked for where rotation and residual velocity take it. Its patch in the image before and its patch in
/// the new image are each blurred by the path of the other, and aligned (features/blur_alignment.hpp). Every ten images
/// the patch of the first of them is aligned as well: that takes out drift, and the patch is replaced. Where blur is
/// short, this patch alone is aligned in each image. A corner is kept when the patches differ by no more than noise
/// explains, and when it agrees with the epipolar geometry of the others, from which rotation (row by row) has been
/// taken out first. Where no residual velocity is known, the corner's last deviation from its prediction starts the
/// search, or else Lucas-Kanade over a pyramid.
class FeatureTracker {
 public:
  /// Throws OptionError.
  explicit FeatureTracker(const TrackerOptions& options);
  ~FeatureTracker();

  /// Throws OptionError and keeps the former options when the new ones are not valid.
  void set_options(const TrackerOptions& options);

  /// @param threads  >= 0: that corners are looked for on, at most; 0: one for each core. 1 at first.
  void set_threads(int threads) { threads_ = threads; }

  /// From the next image on no corner is on a masked pixel, and none is started whose window has one.
  /// @param mask  empty, or of the camera's size
  void set_mask(const PixelMask& mask);

  /// Forgets all tracks; ids go on.
  void reset();

  /// Exposure of the newest image: how far back the next call's `motion` should reach. Nothing before the first image.
  std::optional<TimeRange> newest_frame() const;

  /// Follows the corners into the next image and fills up with new ones.
  /// @param luminance  CV_8UC1 of the camera's size, raw: not deblurred; its pixels are copied
  /// @param motion     from the image before to this one; where it is not known, corners are looked for where they were
  /// @param exposure   of this image; all tracks are forgotten first when it is not after the one before, or more than
  /// kLongestTrackBreakNs later
  /// @param field      of this image: its residual velocities and noise; null: not known
  /// @param repeats    an image before showed the same picture: if the newest one did, with this exposure, its tracks
  /// are returned as they are
  /// @return all corners in this image, longest tracks first
  /// Throws std::invalid_argument when the image, or the mask, does not fit.
  const std::vector<Track>& track(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                  const RowExposure& exposure, const FrameBlur* field = nullptr, bool repeats = false);

 private:
  void follow(const std::shared_ptr<const BlurredView>& view, const Camera& camera, const CameraMotion& motion);
  void add_corners(const std::shared_ptr<const BlurredView>& view, const Camera& camera, const CameraMotion& motion);

  TrackerOptions options_;
  int threads_ = 1;
  PixelMask mask_;
  cv::Mat with_used_window_;  // where corners may start; empty: everywhere, or not worked out yet
  std::int32_t next_id_ = 0;
  std::vector<Track> tracks_;
  std::vector<TrackState> states_;       // of tracks_
  std::unique_ptr<TrackSearch> search_;  // with its buffers
  std::unique_ptr<CornerDetector> detector_;
  std::shared_ptr<const BlurredView> view_;  // the newest image
  CameraCalibration calibration_;
};

}  // namespace gyro_deblur
