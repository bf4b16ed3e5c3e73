// An image, and how its points move within its exposure.
#pragma once

#include <mutex>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "features/blur_alignment.hpp"
#include "features/local_map.hpp"
#include "features/nearby_rays.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// What tracking knows of one image.
class BlurredView {
 public:
  /// @param luminance  CV_8UC1, raw; its pixels are copied
  /// @param field      of this image, or null: no residual velocity is known
  BlurredView(const cv::Mat& luminance, const RowExposure& exposure, const FrameBlur* field);

  const cv::Mat& luminance() const { return luminance_; }
  /// The same at half the size. Made when first asked for, by any thread.
  const cv::Mat& half_size() const;
  const RowExposure& exposure() const { return exposure_; }

  /// Residual velocity at a pixel, the mean of those known around it.
  struct Residual {
    Eigen::Vector2d velocity_px_s;
    bool is_known;  ///< false: the velocity is 0
  };
  Residual residual_at(const Eigen::Vector2d& pixel_px) const;

  /// A point that is at `place_px` at the middle of its row's exposure, with its path by rotation and residual
  /// velocity. What is not known of the motion counts as none.
  /// @param ray  direction of the place
  BlurredPoint point_at(const Eigen::Vector2d& place_px, const Eigen::Vector3d& ray, const Camera& camera,
                        const CameraMotion& motion) const;

 private:
  cv::Mat luminance_;
  mutable std::once_flag has_half_size_;
  mutable cv::Mat half_size_;
  RowExposure exposure_;
  double noise_;
  BlockGrid grid_;
  std::vector<Residual> residuals_;  // of the blocks; empty: known nowhere
};

/// Where a point of one image is in the next, and its neighbourhood.
struct PredictedPoint {
  Eigen::Vector2d place_px;
  LocalMap map;                    ///< its second order is that of the rotation alone
  Eigen::Vector2d rotated_px;      ///< place by the rotation alone
  Eigen::Matrix2d rotated_map;     ///< Jacobian by the rotation alone
  bool by_residual;                ///< a residual velocity is known in addition to the rotation
  std::optional<NearbyRays> near;  ///< around rotated_px
};

/// By the rotation between the instants at which the two images show the point, and the mean of both images' residual
/// velocities times the time between. What is not known counts as none.
/// @param rays  around the place
PredictedPoint predict_point(const Eigen::Vector2d& place_px, const NearbyRays& rays, const BlurredView& from,
                             const BlurredView& to, const CameraMotion& motion);

}  // namespace gyro_deblur
