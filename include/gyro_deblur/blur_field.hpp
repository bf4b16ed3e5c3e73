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
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Blur of one block from the displacement (dx, dy) [px] between start and end of exposure: angle, extent, and the
/// status that the extent alone decides (SHARP, DEBLURRED, TOO_LARGE).
BlockBlur classify_blur(double dx_px, double dy_px, const BlurFieldOptions& options);

/// Largest deviation [px] from uniform motion along the line for which a path counts as uniform and gets the filter of
/// a box (doc/design/blur_model.md). Precondition: extent_px >= 0.
double even_path_px(double extent_px);

/// A path is curved if it deviates from its line by more than curved_path_threshold_px plus this share of the extent,
/// or from uniform speed by more than curved_path_threshold_px plus even_path_px().
constexpr double kStraightPathShare = 0.02;

/// How much more than kStraightPathShare allows a path deviates from its line, of which it covers `along_px`.
/// @param across_px  what it covers across the line
constexpr double excess_deviation_px(double along_px, double across_px) {
  return across_px / 2 - kStraightPathShare * along_px;
}

/// Where there is no time for a 2-D filter, the path is too long for one, or a 2-D filter alone would read masked
/// pixels, paths with at most this excess_deviation_px() get a 1-D filter: it still gains there
/// (doc/reports/experiments_real_world.md). The first two have curved_path_threshold_px instead, if that is larger.
constexpr double kMaxStraightDeviationPx = 1.5;

/// Blur of one block from a path (doc/design/blur_model.md):
///
/// - Uniform speed, to within even_path_px(): classify_blur() of the displacement from the first to the last place.
/// - Non-uniform speed: the line is the one nearest to the places, extent_px the length of it that they cover, and
///   nonuniform_path_px is set.
/// - Curved (kStraightPathShare): curved_path_px is set too, unless it would cover more than kMax2dExtentPx. Without
///   it paths beyond kMaxStraightDeviationPx are TOO_CURVED.
///
/// @param path_px        places of a scene point at kPathInstants, relative to the place at mid-exposure; finite
/// @param straight_only  curved_path_px is never set
BlockBlur classify_path(const std::array<Eigen::Vector2d, kPathInstants>& path_px, const BlurFieldOptions& options,
                        bool straight_only = false);

/// Whether a residual velocity differs significantly from 0 and makes a visible path within `exposure_ns` (> 0). A
/// camera that only rotates is deblurred by its gyroscope alone.
bool is_certain(const ResidualVelocity& residual, TimeNs exposure_ns);

/// Computes blur fields for one camera; keeps the rays of the block centres, which depend only on calibration and grid.
class BlurFieldEstimator {
 public:
  /// Throws OptionError for bad options.
  BlurFieldEstimator(const Camera& camera, const BlurFieldOptions& options);

  /// Paper eq. 2-5 for every block centre. The path is that of the scene point which the centre sees at the middle of
  /// its row's exposure (the paper starts the path at the centre; with a centred PSF that rotates the angle by half the
  /// camera's roll during the exposure), at each place as that place's row is exposed. Blocks whose exposure `motion`
  /// does not cover are NO_GYRO with extent 0; so are those whose centre, or whose path, lies beyond the range of the
  /// lens model.
  /// @param residuals  of the blocks of grid(), or empty. A certain one (is_certain()) is added to the path. A block is
  ///                   SHARP if its extent minus its uncertainty is below min_extent_px. The uncertainty is the blur by
  ///                   one standard deviation of a certain residual velocity, or all blur by an uncertain one that
  ///                   makes min_extent_px or more
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
