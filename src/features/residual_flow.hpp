// What the gyroscope does not know of an image's motion (translation over depth, objects that move by themselves, a
// bias), from corners followed from the image before, and the accelerometer.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "features/corner_following.hpp"
#include "features/inertial_change.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Residual velocities of the images of one camera. Not thread-safe.
class ResidualFlow {
 public:
  /// From the next image on corners are those whose window has no masked pixel.
  /// @param mask  empty, or of the camera's size
  void set_mask(const PixelMask& mask);

  /// A corner of the newest image.
  struct Sample {
    Eigen::Vector2d pixel_px;       ///< at the middle of its row's exposure
    Eigen::Vector2d velocity_px_s;  ///< mean since the image before, less that of the rotation
    TimeNs since_ns;                ///< the image before saw it so long ago
  };

  /// Follows the corners of the image before into this one.
  /// @param luminance  CV_8UC1 of the camera's size; its pixels are copied
  /// @param motion     from the image before to this one; corners beyond what it covers are left out
  /// @param grid       of the blocks
  /// @param threads    at most; 0: one for each core
  /// @return of each block of this image, at the middle of its exposure: the mean since the image before, extrapolated
  ///         by what has changed since the one before that and by the accelerometer, see common_changes() and
  ///         InertialChange; nothing where too few corners are near
  ResidualField follow(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                       const RowExposure& exposure, const BlockGrid& grid, int threads = 0);

  /// What follow() found for the newest image; nothing where that was not exposed then, empty for other blocks.
  std::optional<ResidualField> found_for(const RowExposure& exposure, const BlockGrid& grid) const;

  const std::vector<Sample>& samples() const { return samples_; }

  /// Exposure of the newest image: how far back the next call's `motion` should reach. Nothing before the first one.
  std::optional<TimeRange> newest_frame() const;

  /// The newest image was exposed at another time than it was followed by: the next one is followed from there.
  void correct_exposure(const Camera& camera, const RowExposure& exposure);

  /// Forgets the images.
  void reset();

  /// From now on residual velocities are relative to another motion. With `known`, which the motion so far was, none is
  /// known from now on: the velocities so far take it in as it was within the newest image's exposure, and corners are
  /// looked for where they lead. Without they are forgotten.
  void change_motion(const Camera& camera, const BlockGrid& grid, const CameraMotion* known);

 private:
  /// Makes samples_ of the corners of the image before, and finds those of this one.
  /// @return false where there is no image before, or one of another size
  bool follow_and_find_corners(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                               const RowExposure& exposure, const BlockGrid& grid, int threads);
  /// How many corners were looked for, and where they were found.
  struct FollowedPart {
    std::size_t searched = 0;
    std::vector<Sample> samples;
  };
  /// @param part  of corners_
  FollowedPart follow_corners(const std::vector<cv::Point2f>& part, const SearchImage& image, const Camera& camera,
                              const CameraMotion& motion, const RowExposure& exposure, const BlockGrid& grid) const;
  /// What the image before had for the velocity of what a block shows now, as it would be seen now; nothing where that
  /// is not known.
  /// @param mean  of the block, since the image before
  std::optional<Eigen::Vector2d> velocity_before(int block, const ResidualVelocity& mean, const BlockGrid& grid,
                                                 const Camera& camera, const CameraMotion& motion,
                                                 const RowExposure& exposure) const;
  /// The means at the middle of the newest image's exposure, extrapolated by their changes.
  /// @param before_px_s     of each block, the mean before as it would be seen now
  /// @param since_before_s  between the middles of the times that the two are means over
  ResidualField extrapolated(const ResidualField& means, const std::vector<std::optional<Eigen::Vector2d>>& before_px_s,
                             const Camera& camera, const CameraMotion& motion, const RowExposure& exposure,
                             const BlockGrid& grid, double since_before_s);
  /// Since the image before.
  ResidualField mean_velocities(const BlockGrid& grid, int threads) const;

  PixelMask mask_;
  cv::Mat usable_;                    // smaller: 255 where a corner may be; empty: everywhere, or not worked out yet
  SearchImage image_;                 // the newest
  std::vector<cv::Point2f> corners_;  // of it, in its pixels
  std::optional<RowExposure> exposure_;
  std::vector<Sample> samples_;
  ResidualField means_;   // since the image before
  ResidualField newest_;  // they, extrapolated to the newest image
  TimeNs mean_ns_ = 0;    // the middle of the time that they are means over
  using Accelerations = std::vector<std::optional<Eigen::Vector2d>>;
  Accelerations accelerations_;  // of each block, between the last two means [px/s^2]
  InertialChange inertial_;
  bool whole_ = false;  // they are the whole motion
};

}  // namespace gyro_deblur
