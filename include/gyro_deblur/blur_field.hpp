// Angle and extent of the motion blur of every block (paper sections III-B and III-C).
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/path_1d.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Blur of one block from the displacement (dx, dy) [px] between start and end of exposure: angle, extent, and the
/// status that the extent alone decides (SHARP, DEBLURRED, TOO_LARGE).
BlockBlur classify_blur(double dx_px, double dy_px, const BlurFieldOptions& options);

/// How far [px] a point may be from where an even speed would have it and the speed still count as even. On photographs
/// with noise of 1.5 grey levels a box then restores at most 0.3 dB less than at an even speed, at extents of 10 to 120
/// px. The fast engines know boxes best.
double even_path_px(double extent_px);

/// A path is curved when it leaves its line by more than curved_path_threshold_px and this share of the extent: what a
/// line loses by a deviation of so much hardly depends on the extent, see curved_path_threshold_px.
constexpr double kStraightPathShare = 0.02;

/// Where there is no time for a 2-D filter, a straight path does for paths that leave it by so much [px] (or
/// curved_path_threshold_px) and kStraightPathShare at most: there it still gains, from 10 px on
/// (doc/reports/experiments_real_world.md).
constexpr double kMaxStraightDeviationPx = 1.5;

/// Blur of one block from the places [px] of a scene point at kPathInstants, relative to that at the middle: that of
/// the way from the first to the last place (classify_blur) as long as the point runs along it at even speed, less the
/// best shift, to within the limit of evenness. Otherwise the line is the one that lies nearest to the places,
/// extent_px is what they cover of it, and nonuniform_path_px is set. Where they lie more than that limit to
/// either side of the line, curved_path_px is set, and the path is TOO_CURVED where it leads farther than
/// kMax2dExtentPx.
/// @param straight_only  curved_path_px is never set; TOO_CURVED is what leaves its line by more than
/// kMaxStraightDeviationPx instead
BlockBlur classify_path(const std::array<Eigen::Vector2d, kPathInstants>& path_px, const BlurFieldOptions& options,
                        bool straight_only = false);

/// Whether a residual velocity is far enough from none to be one, for a path within `exposure_ns`: a camera that only
/// turns is deblurred by its gyroscope alone.
bool is_certain(const ResidualVelocity& residual, TimeNs exposure_ns);

/// Computes blur fields for one camera; keeps the rays of the block centres, which depend only on calibration and grid.
class BlurFieldEstimator {
 public:
  /// Throws OptionError for bad options.
  BlurFieldEstimator(const Camera& camera, const BlurFieldOptions& options);

  /// Paper eq. 2-5 for every block centre, with the exposure of the centre's row. The path is that of the scene point
  /// which the centre sees at the middle of the exposure (the paper starts the path at the centre; with a centred
  /// kernel that turns the angle by half the camera's roll during the exposure). Blocks whose exposure `motion` does
  /// not cover are NO_GYRO with extent 0; so are those whose centre, or whose path, lies beyond the range of the lens
  /// model.
  /// @param residuals  of the blocks of grid(), or empty: added to the paths where it is certain, see is_certain(). A
  ///                   block is SHARP whose extent may be below min_extent_px: less their deviation, or less what an
  ///                   uncertain one of min_extent_px or more would add
  /// @param straight_only  as of classify_path()
  FrameBlur estimate(const CameraMotion& motion, const RowExposure& exposure, const ResidualField& residuals = {},
                     bool straight_only = false) const;

  const BlockGrid& grid() const { return grid_; }

 private:
  Camera camera_;
  BlurFieldOptions options_;
  BlockGrid grid_;
  std::vector<Eigen::Vector3d> rays_;  // of the block centres
};

/// One blur for the whole image. Preconditions: extent_px >= 0, sizes >= 1.
FrameBlur uniform_blur_field(int width_px, int height_px, double angle_rad, double extent_px,
                             const BlurFieldOptions& options);

/// Blur field from matrices of the displacement [px] from start to end of exposure (CV_32F or CV_64F, equal sizes, any
/// number of rows and columns that cover the image evenly). Interpolated at the block centres as axial quantities, so
/// that a displacement and its opposite count as the same blur. Blocks that touch a non-finite cell are NO_GYRO.
/// Throws std::invalid_argument for empty or unequal matrices.
FrameBlur blur_field_from_displacement(int width_px, int height_px, const cv::Mat& dx_px, const cv::Mat& dy_px,
                                       const BlurFieldOptions& options);

}  // namespace gyro_deblur
