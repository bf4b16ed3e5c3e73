// Angle and extent of the motion blur of every block (paper sections III-B and III-C).
#pragma once

#include <array>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/kernel_bank.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/types.hpp"

namespace gyro_deblur {

/// Division of an image into blocks of block_size_px; the last column and row are what is left.
class BlockGrid {
 public:
  BlockGrid() = default;
  /// Preconditions: sizes >= 1.
  BlockGrid(int width_px, int height_px, int block_size_px);

  int width_px() const { return width_px_; }
  int height_px() const { return height_px_; }
  int block_size_px() const { return block_size_px_; }
  int cols() const { return cols_; }
  int rows() const { return rows_; }
  int size() const { return cols_ * rows_; }

  /// Blocks are numbered row by row. Precondition: 0 <= index < size().
  cv::Rect rect(int index) const;
  /// Centre of the block [px], pixel centres at integers.
  Eigen::Vector2d center(int index) const;
  /// Index of the block that holds the pixel; coordinates outside the image are clamped to it.
  int index_at(double x_px, double y_px) const;

  bool operator==(const BlockGrid& other) const;

 private:
  int width_px_ = 0, height_px_ = 0, block_size_px_ = 1, cols_ = 0, rows_ = 0;
};

/// Blur of one block along a line.
struct BlockBlur {
  float angle_rad = 0;  ///< axial, [0, pi), x right, y down
  float extent_px = 0;  ///< >= 0; length of the path from start to end of the exposure; uneven: of the line it covers
  BlockStatus status = BlockStatus::SHARP;
  /// Where the path departs from the paper's straight one at even speed: the path along the line.
  std::optional<LinePath> uneven_path_px = std::nullopt;
  /// Halfway between the path's ends, and its mean in time, from where the point is at the middle of the exposure.
  Eigen::Vector2f chord_middle_px = Eigen::Vector2f::Zero();
  Eigen::Vector2f mean_place_px = Eigen::Vector2f::Zero();

  /// From where a scene point is at the middle of the exposure to where the output image shows it [px]. A box puts the
  /// point into the middle of the line that it stands for (to 0.4 px up to 60 px, at the limit of evenness), the kernel
  /// of an uneven path to where the point was; across the line, and where nothing is filtered, blur stays centred on
  /// its mean.
  Eigen::Vector2d shown_offset_px() const;
};

/// The blur of an image; `status` is the only record of what may be deblurred and rectified.
struct BlurField {
  BlockGrid grid;
  std::vector<BlockBlur> blocks;  ///< grid.size(), row by row
  TimeNs exposure_ns = 0;
  TimeNs readout_ns = 0;

  std::size_t count(BlockStatus status) const;
};

/// Angle [rad] of an undirected line, folded into [0, pi). Finite input.
double axial_angle(double dx, double dy);

/// Difference of two axial angles [rad], in [0, pi/2].
double axial_difference(double a_rad, double b_rad);

/// Blur of one block from the displacement (dx, dy) [px] between start and end of exposure: angle, extent, and the
/// status that the extent alone decides (SHARP, DEBLURRED, TOO_LARGE).
BlockBlur classify_blur(double dx_px, double dy_px, const BlurFieldOptions& options);

/// How far [px] a point may be from where an even speed would have it and the speed still count as even. On photographs
/// with noise of 1.5 grey levels a box then restores at most 0.3 dB less than at an even speed, at extents of 10 to 120
/// px. The fast engines know boxes best.
double even_path_px(double extent_px);

/// A path is bent when it leaves its line by more than max_bend_px and this share of the extent. On bows of so much,
/// with the default max_bend_px, a box along the line still gains 1.0 to 1.5 dB at extents of 10 to 120 px.
constexpr double kStraightPathShare = 0.02;

/// Blur of one block from the places [px] of a scene point at kPathInstants, relative to that at the middle: that of
/// the way from the first to the last place (classify_blur) as long as the point runs along it at even speed, less the
/// best shift, to within the limit of evenness. Otherwise the line is the one that lies nearest to the places,
/// extent_px is what they cover of it, and uneven_path_px is set. BENT where they lie more than the limit of a bend to
/// either side of the line.
BlockBlur classify_path(const std::array<Eigen::Vector2d, kPathInstants>& path_px, const BlurFieldOptions& options);

/// Computes blur fields for one camera; keeps the rays of the block centres, which depend only on calibration and grid.
class BlurFieldEstimator {
 public:
  /// Throws OptionError for bad options.
  BlurFieldEstimator(const Camera& camera, const BlurFieldOptions& options);

  /// Paper eq. 2-5 for every block centre, with the exposure of the centre's row. The path is that of the scene point
  /// which the centre sees at the middle of the exposure (the paper starts the path at the centre; with a centred
  /// kernel that turns the angle by half the camera's roll during the exposure). Blocks whose exposure `motion` does
  /// not cover are NO_GYRO with extent 0; so are those whose centre, or whose path, lies beyond the range of the lens
  /// model. Where translation cancels so much of the rotation that what is left may be less than min_extent_px at
  /// the block's own depth, it is left alone (SHARP).
  BlurField estimate(const CameraMotion& motion, const RowExposure& exposure) const;

  const BlockGrid& grid() const { return grid_; }

 private:
  Camera camera_;
  BlurFieldOptions options_;
  BlockGrid grid_;
  std::vector<Eigen::Vector3d> rays_;  // of the block centres
};

/// One blur for the whole image. Preconditions: extent_px >= 0, sizes >= 1.
BlurField uniform_blur_field(int width_px, int height_px, double angle_rad, double extent_px,
                             const BlurFieldOptions& options);

/// Blur field from matrices of the displacement [px] from start to end of exposure (CV_32F or CV_64F, equal sizes, any
/// number of rows and columns that cover the image evenly). Interpolated at the block centres as axial quantities, so
/// that a displacement and its opposite count as the same blur. Blocks that touch a non-finite cell are NO_GYRO.
/// Throws std::invalid_argument for empty or unequal matrices.
BlurField blur_field_from_displacement(int width_px, int height_px, const cv::Mat& dx_px, const cv::Mat& dy_px,
                                       const BlurFieldOptions& options);

}  // namespace gyro_deblur
