// Where a point of an image is at another instant: the one rule by which keypoints and whole images are rectified
// (paper section III-C).
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Motion of an image's points by rotation and the residual velocities of its blocks.
/// What is said of blocks holds at their centres and is linear between them (beyond the outermost ones it stays what it
/// is there), so that the image of a line does not break. Refers to what it was made of.
class PointMotion {
 public:
  /// @param field  of the whole image, at least one block
  PointMotion(const FrameBlur& field, const Camera& camera, const CameraMotion& motion);

  /// Motion between two instants.
  struct Movement {
    Eigen::Matrix3d rotation;
    double seconds;
  };
  /// Precondition: the motion covers the time between the two, but for an image without gyroscope, whose residual
  /// velocities are all of its motion.
  Movement movement(TimeNs from_ns, TimeNs to_ns) const;

  struct Place {
    Eigen::Vector2d pixel_px;
    /// In the camera's frame, any length; nothing where it is that of the pixel, which takes undistorting it.
    std::optional<Eigen::Vector3d> direction;
  };
  /// Where a scene point is after a movement at whose beginning the image shows it at `shown_px`. Not finite beyond the
  /// range of the lens model.
  Place moved(const Eigen::Vector2d& shown_px, const Movement& movement) const;
  /// The same of a scene point that is at `place_px` itself when the movement begins, wherever the image shows it.
  Place moved_from(const Eigen::Vector2d& place_px, const Movement& movement) const;

 private:
  /// Mean of the blocks around a pixel.
  struct Mean {
    Eigen::Vector2d apparent_offset_px, velocity_px_s;  ///< where there is no residual velocity, it counts as 0
    double share_with_residual;                         ///< [0, 1]
  };
  Mean mean_at(const Eigen::Vector2d& pixel_px) const;
  Place moved_by(const Mean& mean, const Eigen::Vector2d& place_px, const Movement& movement) const;

  const Camera& camera_;
  const CameraMotion& motion_;
  BlockGrid grid_;
  bool images_alone_;
  std::vector<Mean> blocks_;
};

/// Takes points to `reference_ns` from the middle of their row's exposure: from where the scene point was then, which
/// is where the image shows it less BlockBlur::apparent_offset_px().
/// Points in REJECTED blocks are not rectified (paper section III-D), nor those in NO_GYRO blocks, those between whose
/// time and the reference time the motion is not known, and those that leave the range of the lens model; other points
/// are.
/// @param points_px  raw pixels, finite
/// @param field      of the whole image (at least one block)
std::vector<RectifiedPoint> rectify_points(const std::vector<Eigen::Vector2d>& points_px, const FrameBlur& field,
                                           const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, TimeNs reference_ns);

}  // namespace gyro_deblur
